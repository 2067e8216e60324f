"""Columns of register tables that change a value or its device: used, or refused with the remedy, never just unused."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from drivers.importers.draft import ImportFileError
from drivers.importers.vendor_table.table import import_csv
from drivers.rig_file.reader import load_rig
from hil.cli.rig_commands.init import command as init
from tests.drivers.import_files import BUS, table, written
from tests.drivers.test_import_csv import drafted

DEVICES = "name;address;table;type;{heading}\nBath;4;input;int16;{one}\nLab;4;input;int16;{two}\n"


def rig_of(tmp_path, text):
    draft = import_csv(table(tmp_path, text), "zero", dict(BUS))
    return written(tmp_path, draft), draft.notes


@pytest.mark.parametrize(
    "heading",
    [
        "Unit ID",
        "unit-id",
        "Slave",
        "Slave address",
        "Modbus ID",
        "Geräteadresse",
        "Slave-Adresse",
        "Teilnehmer",
        "Adresse de l'esclave",
        "N° esclave",
        "Device",
        "Station No.",
        "Address (slave)",
    ],
)
def test_each_unit_id_of_a_table_is_a_device_of_its_own(tmp_path, heading):
    rig, notes = rig_of(tmp_path, DEVICES.format(heading=heading, one=2, two="0x0B"))
    assert {point.name: rig.bus[point.bus].device_id for point in rig.point} == {"Bath": 2, "Lab": 11}
    assert len({(bus.host, bus.port) for bus in rig.bus.values()}) == 1
    assert notes == [f"line 1: devices are taken from column {heading!r}: 2 is plc, 11 is plc2"]


def test_a_line_without_its_unit_id_is_left_out_and_its_neighbours_stay(tmp_path):
    text = DEVICES.format(heading="Slave", one=7, two="") + "Hall;9;input;int16;1-3\n"
    rig, notes = rig_of(tmp_path, text)
    assert [(point.name, rig.bus[point.bus].device_id) for point in rig.point] == [("Bath", 7)]
    assert notes[0] == "line 3: Lab: has no unit id; give its number, 0 to 255, one a line (left out)"
    assert "line 4: Hall: unit id '1-3' is no device" in notes[1]


@pytest.mark.parametrize(
    ("heading", "one", "two", "said"),
    [
        (
            "Device",
            "Chiller",
            "Meter",
            "names several devices (Chiller, Meter); add a column unit id, or import",
        ),
        ("Gerätename", "Kühler", "Zähler", "names several devices"),
        ("IP address", "10.0.0.5", "10.0.0.6", "names several places (10.0.0.5, 10.0.0.6); import one file for each"),
        ("Unit", "1", "2", "holds numbers alone; call it unit id if they are devices, or give units"),
    ],
)
def test_a_column_that_parts_the_table_without_unit_ids_is_refused(tmp_path, heading, one, two, said):
    with pytest.raises(ImportFileError) as refusal:
        drafted(tmp_path, DEVICES.format(heading=heading, one=one, two=two))
    assert f"line 1: column '{heading}' {said}" in str(refusal.value)


@pytest.mark.parametrize(
    ("heading", "cell"), [("Device", "Chiller"), ("Group", "3"), ("Factory default", "20"), ("#", "7"), ("Tag", "TI1")]
)
def test_a_column_that_parts_nothing_is_only_named(tmp_path, heading, cell):
    points, notes = drafted(tmp_path, DEVICES.format(heading=heading, one=cell, two=cell).replace("Lab;4", "Lab;5"))
    assert set(points) == {"Bath", "Lab"}
    assert notes == [f"line 1: columns that were not used: {heading}"]


def test_device_id_on_the_command_line_and_a_column_of_unit_ids_are_one_too_many(tmp_path):
    source, out = table(tmp_path, DEVICES.format(heading="Unit id", one=2, two=3)), tmp_path / "rig.toml"
    words = ["--from", str(source), "--addressing", "zero", "--out", str(out)]
    done = CliRunner().invoke(init, [*words, "--device-id", "2"])
    assert isinstance(done.exception, ImportFileError)
    assert "line 1: column 'Unit id' and --device-id both name the device" in str(done.exception)
    assert CliRunner().invoke(init, words).exit_code == 0
    assert sorted(bus.device_id for bus in load_rig(out).bus.values()) == [2, 3]


RANGED = "name;address;table;type;unit;{head}\nP;4;input;{kind};bar;{cells}\nQ;9;input;int16;bar;{empty}\n"


def ranged(tmp_path, head, cells, kind="int16"):
    text = RANGED.format(head=head, cells=cells, kind=kind, empty=";" * head.count(";"))
    points, notes = drafted(tmp_path, text)
    assert "Q" in points
    return points.get("P", {}), notes


@pytest.mark.parametrize(
    "head",
    [
        "Raw Min;Raw Max;Eng Min;Eng Max",
        "Min (raw);Max (raw);Min;Max",
        "Raw Low;Raw High;Scaled Low;Scaled High",
        "Rohwert von;Rohwert bis;Messbereich von;Messbereich bis",
        "Rohwert min;Rohwert max;Min;Max",
        "valeur brute min;valeur brute max;Min;Max",
        "Counts min;Counts max;EU low;EU high",
    ],
)
def test_a_raw_range_and_its_engineering_range_give_scale_and_offset(tmp_path, head):
    point, notes = ranged(tmp_path, head, "4000;20000;0;16")
    assert (point["scale"], point["offset"]) == (0.001, -4.0)
    assert "plausible" not in point
    assert notes == ["line 2: P: taken as raw x 0.001 + -4, by its raw range: 4000 to 20000 is 0 to 16 bar"]


def test_a_range_may_stand_in_one_cell_and_plausible_values_beside_it(tmp_path):
    point, _ = ranged(tmp_path, "Raw range;Engineering range;Min;Max", "0..1000;-10 - 90;-12;95")
    assert (point["scale"], point["offset"], point["plausible"]) == (0.1, -10.0, [-12.0, 95.0])


@pytest.mark.parametrize(
    ("head", "cells", "kind", "said"),
    [
        ("Raw Min;Raw Max", "0;1000", "int16", "has a raw range and no engineering range; add eng min and eng max"),
        ("Eng Min;Eng Max", "0;50", "int16", "has an engineering range and no raw range; add raw min and raw max"),
        ("Raw Min;Raw Max;Min;Max", "0;;0;50", "int16", "its raw range has no max; give both ends"),
        ("Raw Min;Raw Max;Min;Max", "0;0;0;50", "int16", "are the same; correct one"),
        ("Raw Min;Raw Max;Min;Max", "0;65535;0;50", "int16", "raw 65535 is beyond int16 (-32768 to 32767)"),
        ("Raw Min;Raw Max;Min;Max;Scale", "0;1000;0;50;0,1", "int16", "gives raw x 0.05 + 0, and its scale or offset"),
        ("Raw Min;Raw Max;Min;Max;Offset", "0;1000;0;50;2", "int16", "gives raw x 0.05 + 0, and its scale or offset"),
        ("Raw range;Range", "4-20 mA;0..50", "int16", "raw range '4-20 mA' is not understood; write it as 0..1000"),
    ],
)
def test_a_raw_range_that_gives_no_certain_scale_leaves_its_line_out(tmp_path, head, cells, kind, said):
    point, notes = ranged(tmp_path, head, cells, kind)
    assert not point
    assert notes[-1].startswith("line 2: P: ") and said in notes[-1] and notes[-1].endswith("(left out)")


def test_a_scale_beside_a_raw_range_that_says_the_same_is_accepted(tmp_path):
    point, _ = ranged(tmp_path, "Raw Min;Raw Max;Min;Max;Scale", "0;1000;0;100;0,1")
    assert point["scale"] == 0.1


@pytest.mark.parametrize("heading", ["Units/bit", "Value per count", "Wert pro Bit", "unité par bit", "LSB value"])
def test_a_heading_that_names_the_value_of_a_count_is_a_scale_of_one_meaning(tmp_path, heading):
    assert ranged(tmp_path, heading, "0,25")[0]["scale"] == 0.25
    assert ranged(tmp_path, heading, "10")[0]["scale"] == 10.0


def test_counts_per_unit_divide(tmp_path):
    assert ranged(tmp_path, "Counts per unit", "20")[0]["scale"] == 0.05


@pytest.mark.parametrize("heading", ["LSB", "Step size", "Unit (per bit)", "Full scale", "Pas de mesure", "Spanne"])
def test_a_heading_with_a_word_of_several_meanings_is_refused(tmp_path, heading):
    with pytest.raises(ImportFileError, match=r"line 1: column .* has no agreed meaning; rename it scale"):
        ranged(tmp_path, heading, "0,25")


@pytest.mark.parametrize(
    ("cell", "holds"),
    [("0.1", "numbers"), ("0x00F0", "numbers"), ("big endian", "orders of bytes"), ("unsigned", "signs of numbers")],
)
def test_an_unknown_column_whose_cells_may_change_a_value_is_refused(tmp_path, cell, holds):
    with pytest.raises(ImportFileError, match=f"line 1: column 'Zq' is not known and holds {holds}; call it "):
        ranged(tmp_path, "Zq", cell)


def test_an_unknown_column_of_words_is_only_named_and_several_remarks_are_kept(tmp_path):
    point, notes = ranged(tmp_path, "Zq;Description;Remark", "PT100, 4 wires;in the bath;new")
    assert point["doc"] == "in the bath; new"
    assert notes == ["line 1: columns that were not used: Zq"]


@pytest.mark.parametrize(
    ("kind", "heading", "cell", "taken"),
    [
        ("word", "Signed", "yes", "int16"),
        ("DWORD", "Vorzeichen", "nein", "uint32"),
        ("16 bit", "Unsigned", "x", "uint16"),
        ("int16", "signé", "oui", "int16"),
        ("int16", "Signed", "no", "type 'int16' is int16 and the line says unsigned; correct one of them"),
        ("uint16", "Signed/Unsigned", "signed", "type 'uint16' is uint16 and the line says signed"),
        ("int16", "Signed", "perhaps", "signed 'perhaps' is not known"),
    ],
)
def test_a_column_of_signs_makes_the_type_or_contradicts_it(tmp_path, kind, heading, cell, taken):
    point, notes = ranged(tmp_path, heading, cell, kind)
    assert point.get("type", notes[-1] if notes else "") == taken or taken in notes[-1]


@pytest.mark.parametrize(
    ("heading", "cell", "bits"),
    [("Mask", "0x00F0", [4, 7]), ("Bitmaske", "8000h", [15, 15]), ("masque", "0xFFFF", None), ("Mask", "0x0005", ())],
)
def test_a_mask_is_taken_as_its_bits(tmp_path, heading, cell, bits):
    point, notes = ranged(tmp_path, heading, cell, "uint16")
    if bits == ():
        assert "takes bits that do not follow one another" in notes[-1] and not point
    else:
        assert point.get("bits") == bits


def test_codes_for_not_available_and_inverted_values_are_not_overlooked(tmp_path):
    assert ranged(tmp_path, "Invalid value", "0x8000")[0]["invalid"] == [32768.0]
    assert "its value is inverted ('yes'), which is not read here" in ranged(tmp_path, "Inverted", "yes")[1][-1]
    assert ranged(tmp_path, "Inverted", "no")[0]["address"] == 4


@pytest.mark.parametrize(("heading", "stated"), [("Address (0-based)", "zero"), ("Adresse (1-based)", "one")])
def test_a_heading_that_states_the_first_address_is_held_against_the_option(tmp_path, heading, stated):
    source = table(tmp_path, f"name;{heading};table;type\nP;4;input;int16\n")
    assert import_csv(source, stated, BUS).buses[0].points[0].keys["address"] == (4 if stated == "zero" else 3)
    other = "one" if stated == "zero" else "zero"
    with pytest.raises(ImportFileError, match=f"does not count as --addressing {other}; use {stated}"):
        import_csv(source, other, BUS)


def test_functions_may_stand_in_two_columns(tmp_path):
    text = "name;address;type;Function (read);Function (write)\nP;4;int16;3;16\nQ;5;int16;4;\n"
    points, _ = drafted(tmp_path, text)
    assert (points["P"]["table"], points["P"]["access"]) == ("holding", "rw")
    assert points["Q"]["table"] == "input"


@pytest.mark.parametrize(
    "cell",
    [
        "-400..1200 (=-40.0..120.0)",
        "-400 to 1200 = -40 to 120",
        "-400…1200 -> -40…120 bar",
        "-400..1200 [= -40..120 bar]",
    ],
)
def test_a_range_with_the_values_of_its_ends_gives_the_scale(tmp_path, cell):
    point, notes = ranged(tmp_path, "Range", cell)
    assert point["scale"] == 0.1 and not point.get("offset")
    assert notes == ["line 2: P: taken as raw x 0.1 + 0, by its raw range: -400 to 1200 is -40 to 120 bar"]


def test_a_scale_that_contradicts_the_values_of_a_range_leaves_the_line_out(tmp_path):
    point, notes = ranged(tmp_path, "Range;Factor", "-400..1200 (=-40.0..120.0);1")
    assert not point and "gives raw x 0.1 + 0, and its scale or offset raw x 1 + 0" in notes[-1]


PERCENT = "name;address;table;type;unit;range;scale\npump;4;holding;uint16;%;{range};{scale}\nQ;9;input;int16;bar;;\n"


@pytest.mark.parametrize(("cell", "scale"), [("0..27648", ""), ("0..27648", "1"), ("0 to 32767", "")])
def test_a_range_that_no_value_in_the_unit_can_have_leaves_the_line_out(tmp_path, cell, scale):
    points, notes = drafted(tmp_path, PERCENT.format(range=cell, scale=scale))
    assert set(points) == {"Q"}
    assert f"range '{cell}' is beyond" in notes[-1] and "may be a raw range" in notes[-1]


@pytest.mark.parametrize(("cell", "scale"), [("0..100", ""), ("0..27648", "100/27648"), ("0..65535", ""), ("n/a", "")])
def test_a_range_of_values_or_of_the_type_leaves_the_point_as_it_is(tmp_path, cell, scale):
    points, notes = drafted(tmp_path, PERCENT.format(range=cell, scale=scale))
    assert set(points) == {"pump", "Q"}
    assert "line 1: columns that were not used: range" in notes
