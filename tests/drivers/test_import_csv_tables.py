"""Register tables as a whole: lines above the heading, ranges written in one way, units in any spelling."""

from __future__ import annotations

import pytest

from drivers.importers.draft import ImportFileError
from drivers.importers.vendor_table.table import import_csv
from tests.drivers.import_files import BUS, table
from tests.drivers.test_import_csv import drafted


@pytest.mark.parametrize(
    ("scale", "ends", "other", "plausible", "said"),
    [
        ("0.1", "0,1000", "", [0.0, 1000.0], "may be raw counts or values; the range that holds both was taken"),
        ("10/1", "0,150", "", [0.0, 1500.0], "may be raw counts or values; the range that holds both was taken"),
        ("10/1", "0,150", "0,90.5", [0.0, 150.0], None),
        ("0.1", "-4000,12000", "", None, "fit neither as values nor as raw counts; no range was taken"),
        ("0.1", "0,900", "-2000,12000", None, "are raw counts; no range was taken"),
    ],
)
def test_other_lines_show_if_a_range_is_in_raw_counts(tmp_path, scale, ends, other, plausible, said):
    more = f"u,4,input,int16,0.1,degC,r,{other}\n" if other else ""
    text = f"name,address,table,type,scale,unit,access,min,max\nt,3,input,int16,{scale},degC,r,{ends}\n{more}"
    points, notes = drafted(tmp_path, text)
    assert points["t"].get("plausible") == plausible
    assert any(said in note for note in notes) if said else not notes


def test_a_register_that_cannot_be_written_is_left_out_where_its_access_says_so(tmp_path):
    text = "name,address,table,type,access\nt,3,input,int16,rw\nu,4,holding,int16,rw\n"
    points, notes = drafted(tmp_path, text)
    assert list(points) == ["u"]
    assert notes == [
        "line 2: t: input registers cannot be written; use table 'holding', or correct its access 'rw' (left out)"
    ]


def test_lines_above_the_heading_are_left_out_with_a_note(tmp_path):
    text = "Register map,,,\nUnit 1,,,\nname,address,table,type\nt,3,input,int16\n"
    points, notes = drafted(tmp_path, text)
    assert points["t"]["address"] == 3
    assert notes == ["line 3: is taken for the heading; the lines above it were not used"]


@pytest.mark.parametrize(("unit", "symbol"), [("U/min", "rpm"), ("DEG C", "degC"), ("%HR", "%"), ("l/h", "L/h")])
def test_a_unit_of_one_meaning_is_taken_in_any_spelling(tmp_path, unit, symbol):
    points, notes = drafted(tmp_path, f"name,address,table,type,unit\nt,3,input,int16,{unit}\n")
    assert points["t"]["unit"] == symbol and not notes


def made_bus(tmp_path, text):
    draft = import_csv(table(tmp_path, text), "zero", dict(BUS))
    return draft.buses[0].keys, draft.notes


@pytest.mark.parametrize(
    ("codes", "is_declared"),
    [
        (["16", "0x10", "03/16"], True),
        (["10h", "FC 15"], True),
        (["6", "03/06/16"], None),
        (["06, 16"], None),
        (["3", "4"], None),
    ],
)
def test_functions_for_several_alone_are_declared_for_the_device(tmp_path, codes, is_declared):
    lines = "".join(
        f"p{k},{10 + k},{'bool' if '15' in code else 'int16'},{code.replace(',', ' ')}\n"
        for k, code in enumerate(codes)
    )
    keys, notes = made_bus(tmp_path, f"name,address,type,function\n{lines}")
    assert keys.get("write_multiple") is is_declared
    assert not notes


def test_two_kinds_of_writes_on_one_device_are_noted_with_their_lines(tmp_path):
    text = "name,address,function,type\na,1,6,int16\nb,2,16,int16\nc,3,16,int16\nd,4,16,float32\n"
    keys, notes = made_bus(tmp_path, text)
    assert "write_multiple" not in keys
    assert [note.split(";")[0] for note in notes] == ["line 3: is written with another function than line 2"]


def test_names_of_latin_scripts_are_written_in_a_to_z(tmp_path):
    text = "name,address,table,type\nRücklauf,1,input,int16\nØl/Größe,2,input,int16\nDe\u0301bit,3,input,int16\n"
    points, notes = drafted(tmp_path, text)
    assert list(points) == ["Ruecklauf", "Ol_Groesse", "Debit"] and not notes


def test_a_bit_of_a_register_of_type_bool_is_a_bit_of_a_whole_register(tmp_path):
    points, notes = drafted(tmp_path, "name,address,table,type,bit\non,10,holding,bool,0\nalarm,10,holding,bool,3\n")
    assert [(keys["type"], keys["bits"]) for keys in points.values()] == [("uint16", [0, 0]), ("uint16", [3, 3])]
    assert not notes


def test_a_factor_in_a_column_of_remarks_on_the_range_is_refused(tmp_path):
    text = "name,address,table,type,range\nt,3,input,int16,-400...1500 (0.1 °C)\n"
    with pytest.raises(ImportFileError, match=r"'range'.*holds factors of units; give the value of one count"):
        drafted(tmp_path, text)


def test_states_in_the_unit_are_named_as_states(tmp_path):
    _, notes = drafted(
        tmp_path, "name,address,table,type,unit\nt,3,input,int16,degC\nmode,5,holding,uint16,0=off 1=on\n"
    )
    assert len(notes) == 1 and "lists states; leave the unit empty" in notes[0]
