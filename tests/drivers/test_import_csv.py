"""`hil init --from registers.csv`: a vendor's table becomes a rig file that `hil check` accepts, or one sentence."""

from __future__ import annotations

import pytest
from click.testing import CliRunner
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from drivers.importers.draft import Collector, Draft, DraftBus, ImportFileError, placeholder_in
from drivers.importers.vendor_table.table import import_csv
from drivers.rig_file.reader import load_rig
from hil.cli.rig_commands.check import command as check
from hil.cli.rig_commands.init import command as init
from tests.drivers.import_files import BUS, CELLS, complaint, table, written

TABLE = """\
# Chiller X200, firmware 2.1
Name;Address;Function code;Data type;Byte order;Scale;Offset;Unit;Access;Length;Bit;Remark;Colour
Supply temperature;30001;4;INT16;;0,1;;°C;R;;;water to the rig;red
Flow;30003;4;FLOAT32;CDAB;;;l/min;R;2;;;
Energy;30005;4;UINT64;;1/100;;kWh;R;;;;
Serial;30010;4;STRING;;;;;R;6;;;
Pump on;30020;4;WORD;;;;;R;;0;;
Pump fault;30020;4;WORD;;;;;R;;4-7;;
Set point;40001;3,6;INT16;;0.1;;°C;;;;;
Remote;00005;1,5;BOOL;;;;;RW;;;;
Door;10001;2;;;;;;;;;;
Torque;30030;4;uint16;;;;in-lb;R;;;;
"""


def test_a_vendors_table_becomes_a_rig_file_that_is_accepted(tmp_path):
    source, out = table(tmp_path, TABLE), tmp_path / "rig.toml"
    done = CliRunner().invoke(
        init, ["--from", str(source), "--addressing", "modicon", "--host", "10.0.0.5", "--out", str(out)]
    )
    assert done.exit_code == 0, (done.output, done.exception)
    assert "columns that were not used: Colour" in done.output
    assert "unit 'in-lb' is not known" in done.output
    rig = load_rig(out)
    by_name = {point.name: point for point in rig.point}
    temperature = by_name["Supply_temperature"]
    assert (temperature.table, temperature.address, temperature.scale) == ("input", 0, 0.1)
    assert (temperature.unit, temperature.doc) == ("degC", "water to the rig")
    assert (by_name["Flow"].address, by_name["Flow"].type, by_name["Flow"].order) == (2, "float32", "CDAB")
    assert (by_name["Energy"].scale, by_name["Energy"].unit) == (0.01, "kWh")
    assert (by_name["Serial"].type, by_name["Serial"].length) == ("string", 6)
    assert (by_name["Pump_on"].bits, by_name["Pump_fault"].bits) == ((0, 0), (4, 7))
    assert (by_name["Set_point"].table, by_name["Set_point"].access) == ("holding", "rw")
    assert (by_name["Remote"].table, by_name["Remote"].address, by_name["Remote"].access) == ("coil", 4, "rw")
    assert by_name["Door"].table == "discrete"
    assert by_name["Torque"].unit == "1"
    text = out.read_text(encoding="utf-8")
    assert "# called 'Supply temperature' in registers.csv" in text
    assert "# unit in registers.csv: in-lb" in text
    checked = CliRunner().invoke(check, [str(out)])
    assert checked.exit_code == 0, (checked.output, checked.exception)
    assert "no mistakes found" in checked.output
    again = CliRunner().invoke(init, ["--from", str(source), "--addressing", "modicon", "--out", str(out)])
    assert again.exit_code == 2
    assert "exists already" in again.output


@pytest.mark.parametrize(
    ("addressing", "given", "address"),
    [
        ("zero", "0", 0),
        ("zero", "0x10", 16),
        ("zero", "0FH", 15),
        ("one", "1", 0),
        ("one", "40001", 40000),
        ("modicon", "40001", 0),
        ("modicon", "49999", 9998),
        ("modicon", "400001", 0),
        ("modicon", "465536", 65535),
    ],
)
def test_addresses_are_taken_as_they_are_stated(tmp_path, addressing, given, address):
    source = table(tmp_path, f"name,address,table,type\nx,{given},holding,uint16\n")
    (point,) = written(tmp_path, import_csv(source, addressing, BUS)).point
    assert (point.table, point.address) == ("holding", address)


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ("30001", "0", 3, "is no Modicon address"),
        ("30001", "20001", 3, "is no Modicon address"),
        ("30001", "30001-2", 3, "write it as 100 or 0x64"),
        ("30001;4", "30001;3", 3, "address 30001 is of table input and the line says holding"),
        ("30001;4", "30001;7", 3, "function 7 reads or writes no table"),
        ("INT16", "INT24", 3, "type 'INT24' is not known; use bool, int16"),
        ("FLOAT32;CDAB", "FLOAT32;ACBD", 4, "order 'ACBD' is not known"),
        ("l/min;R;2", "l/min;R;1", 4, "float32 takes 2 registers and the line says 1"),
        ("30003", "30001", 4, "input 0 is Supply_temperature's already (line 3)"),
        ("0,1", "0,125x", 3, "scale '0,125x' is no number"),
        ("0,1", "1,000", 3, "may be a thousand or a fraction"),
        ("0,1", "0", 3, "loses the value"),
        ("0,1", "nan", 3, "is no number"),
        ("kWh;R", "kWh;X", 5, "access 'X' is not known; use r, w or rw"),
        ("STRING;;;;;R;6", "STRING;;;;;R;", 6, "needs its number of registers"),
        ("4-7", "4-70", 8, "bits"),
        ("4-7", "0-7", 8, "is Pump_on's already (line 7)"),
        ("Flow;", ";", 4, "has no name"),
        ("red", "red;blue", 3, "has 14 cells and the heading 13"),
        ("Scale", "Gain", 2, "column 'gain' has no agreed meaning"),
        ("Address", "Where", 2, "has no column for address"),
        ("Remark", "Name", 2, "two columns for name"),
        ("Torque", '"Torque', 12, "close every quote"),
        ("30030;4;uint16", "30030;4;", 12, "type '' is not known"),
        ("Torque;30030;4;uint16", ";;;;\nLast;365536;4;uint32", 13, "Last ends at 65536, beyond 65535"),
    ],
)
def test_each_mistake_in_a_table_is_one_sentence_with_its_line(tmp_path, old, new, line, said):
    assert old in TABLE
    source = table(tmp_path, TABLE.replace(old, new, 1))
    text = complaint(lambda: import_csv(source, "modicon", BUS))
    assert said in text
    assert f"registers.csv, line {line}: " in text
    assert len(text.splitlines()) == 1


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "has no line with a heading"),
        (b"name,address,type\n", "has a heading and no line below it"),
        (b"name,address,type\n\x81\xff,1,uint16\n", r"is neither utf-8 nor cp1252 text \(line 2\)"),
        (b"name,address,type\nx\0,1,uint16\n", "line 2: holds a zero byte"),
        (b"name,address,type\nx,0,uint16\n", "line 2: x: no table; add a column table or function"),
    ],
)
def test_files_that_are_no_tables(tmp_path, content, said):
    source = tmp_path / "registers.csv"
    source.write_bytes(content)
    with pytest.raises(ImportFileError, match=said):
        import_csv(source, "zero", BUS)


def test_a_table_must_say_what_its_addresses_count_from(tmp_path):
    with pytest.raises(ImportFileError, match="give --addressing zero, one or modicon"):
        import_csv(table(tmp_path, TABLE), None, BUS)


LINES = """\
Point;Register;Table;Format;{heading};Unit;R/W
Bath;10;holding;int16;{cell};{unit};{access}
Lab;12;input;int16;0,5;kPa;R
"""


def taken(tmp_path, heading, cell, unit="°C", access="R/W", lines=LINES):
    """Return scale, unit and access of the first line's point, or its note where it is left out."""
    text = lines.format(heading=heading, cell=cell, unit=unit, access=access)
    draft = import_csv(table(tmp_path, text), "zero", BUS)
    by_name = {point.name: point for point in written(tmp_path, draft).point}
    assert "Lab" in by_name
    if "Bath" in by_name:
        return by_name["Bath"].scale, by_name["Bath"].unit, by_name["Bath"].access
    return draft.notes[0]


@pytest.mark.parametrize(
    ("heading", "cell", "scale"),
    [
        ("Scale Factor", "0.1", 0.1),
        ("Faktor", "0,01", 0.01),
        ("Skalierungsfaktor", "1/10", 0.1),
        ("Facteur d'échelle", "0,2", 0.2),
        ("Multiplikator", "x0,1", 0.1),
        ("Scaling factor", "10/1", 10.0),
        ("scale", "/10", 0.1),
        ("scale", "10^-2", 0.01),
        ("Teiler", "20", 0.05),
        ("Scale", "-", 1.0),
    ],
)
def test_a_factor_is_taken_whatever_its_column_is_called(tmp_path, heading, cell, scale):
    lines = LINES.replace("0,5", "") if heading == "Teiler" else LINES
    found = taken(tmp_path, heading, cell, lines=lines)
    assert found[0] == pytest.approx(scale)
    assert found[1:] == ("degC", "rw")


@pytest.mark.parametrize(
    ("cell", "unit", "said"),
    [
        ("10", "°C", "may mean raw x 10 or raw / 10; write 10/1 or 1/10"),
        ("x100", "°C", "may mean raw x 100"),
        ("-1", "°C", "is a power of ten"),
        ("10E-1", "°C", "may be a power of ten"),
        ("T_SF", "°C", "is no number"),
        ("", "x10 °C", "unit 'x10 °C' holds a factor"),
        ("", "°C*10", "holds a factor"),
        ("", "10 kPa", "holds a factor"),
        ("", "zehntel Grad", "holds a factor"),
        ("0,1", "0.1 °C", "has a scale and a factor in its unit"),
    ],
)
def test_a_factor_of_two_meanings_leaves_its_set_point_out(tmp_path, cell, unit, said):
    note = taken(tmp_path, "Scale", cell, unit)
    assert note.startswith("line 2: Bath: ")
    assert said in note
    assert note.endswith("(left out)")


@pytest.mark.parametrize(
    ("unit", "scale", "symbol"), [("0.1 °C", 0.1, "degC"), ("1/10 %", 0.1, "%"), ("0,01kWh", 0.01, "kWh")]
)
def test_a_unit_may_hold_the_value_of_one_count(tmp_path, unit, scale, symbol):
    assert taken(tmp_path, "Scale", "", unit, "RW") == (scale, symbol, "rw")


def test_a_column_of_powers_of_ten_is_not_taken_for_factors(tmp_path):
    lines = "name;address;table;type;Scale Factor\nA;1;holding;int16;-1\nB;2;holding;int16;1\nC;3;holding;int16;\n"
    draft = import_csv(table(tmp_path, lines), "zero", BUS)
    assert [point.name for point in draft.buses[0].points] == ["C"]
    assert "in a column of whole numbers that may be powers of ten" in draft.notes[1]


@pytest.mark.parametrize("heading", ["Gain", "Resolution", "Auflösung", "Nachkommastellen", "SF", "Scale (raw/100)"])
def test_a_column_that_may_change_a_value_is_refused_unless_it_is_empty(tmp_path, heading):
    text = f"name;address;table;type;{heading}\nA;1;holding;int16;10\n"
    with pytest.raises(
        ImportFileError, match=r"registers.csv, line 1: column .* has no agreed meaning; rename it scale"
    ):
        import_csv(table(tmp_path, text), "zero", BUS)
    assert len(import_csv(table(tmp_path, text.replace(";10", ";")), "zero", BUS).buses[0].points) == 1


@pytest.mark.parametrize("words", ["Set temperature (x10)", "value * 10", "0.1 °C per count", "Sollwert in Zehntel"])
def test_a_factor_in_a_name_or_a_remark_is_not_overlooked(tmp_path, words):
    text = f"name;address;table;type;scale;remark\nA;1;holding;int16;;{words}\nB;2;holding;int16;1;{words}\n"
    draft = import_csv(table(tmp_path, text), "zero", BUS)
    assert [point.name for point in draft.buses[0].points] == ["B"]
    assert "put the factor in a column scale, 1 where there is none" in draft.notes[0]


def test_an_offset_that_is_the_address_again_is_not_added_to_the_value(tmp_path):
    text = "name;address;type;offset\nA;30011;int16;10\nB;30013;int16;-400\n"
    draft = import_csv(table(tmp_path, text), "modicon", BUS)
    (point,) = written(tmp_path, draft).point
    assert (point.name, point.offset) == ("B", -400.0)
    assert "offset 10 is its address" in draft.notes[0]
    assert "taken as raw x 1 + -400" in draft.notes[1]


def test_a_heading_may_hold_line_breaks_and_name_the_base_of_its_addresses(tmp_path):
    text = '"Parameter\nname","Address\n(hex)","Register\ntype","Data\nformat"\nA,1F,input,int16\n'
    source = table(tmp_path, text + "B,FFFFF,input,int16\n")
    draft = import_csv(source, "zero", BUS)
    assert [(point.name, point.keys["address"]) for point in draft.buses[0].points] == [("A", 31)]
    assert draft.notes[0].startswith("line 7: B: address FFFFF is beyond the last one")


def test_a_table_of_older_spreadsheets_is_read_and_its_encoding_named(tmp_path):
    source = tmp_path / "registers.csv"
    source.write_bytes("Bezeichnung;Adresse;Tabelle;Typ;Einheit\nRücklauf;4;input;int16;°C\n".encode("cp1252"))
    draft = import_csv(source, "zero", BUS)
    (point,) = written(tmp_path, draft).point
    assert (point.name, point.unit) == ("Ruecklauf", "degC")
    assert draft.notes == ["it is no UTF-8 text and was read as cp1252; look at its names and units"]


HEADINGS = ["name", "address", "table", "function", "type", "order", "scale", "divisor", "offset", "unit", "access"]
HEADINGS += ["bits", "length", "min", "max", "description"]


@settings(max_examples=150, deadline=None)
@given(data=st.data(), addressing=st.sampled_from(["zero", "one", "modicon"]))
def test_any_table_is_imported_well_or_refused_in_one_sentence(tmp_path_factory, data, addressing):
    heads = data.draw(st.permutations(HEADINGS)) if data.draw(st.booleans()) else HEADINGS
    rows = data.draw(st.lists(st.lists(CELLS, min_size=1, max_size=len(heads)), max_size=4))
    delimiter = data.draw(st.sampled_from([",", ";", "\t"]))
    text = "\n".join([delimiter.join(heads), *(delimiter.join(row) for row in rows)])
    folder = tmp_path_factory.mktemp("fuzz")
    source = folder / "registers.csv"
    source.write_text(text, encoding="utf-8", errors="replace")
    try:
        draft = import_csv(source, addressing, BUS)
    except ImportFileError as error:
        assert "registers.csv" in str(error)
        assert len(str(error).splitlines()) == 1
    else:
        assert len(written(folder, draft).point) == len(draft.buses[0].points)


ROW = ["Flow", "40003", "holding", "3", "uint16", "", "0.1", "", "5", "L/min", "r", "", "", "0", "8", "what"]


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_a_good_table_with_a_few_odd_cells_is_imported_well_or_refused(tmp_path_factory, data):
    rows = [list(ROW), ["T", "40010", *ROW[2:]], ["P", "40020", *ROW[2:]]]
    for _ in range(data.draw(st.integers(1, 3))):
        row = data.draw(st.sampled_from(rows))
        row[data.draw(st.integers(0, len(row) - 1))] = data.draw(CELLS)
    folder = tmp_path_factory.mktemp("fuzz")
    source = folder / "registers.csv"
    text = "\n".join(";".join(row) for row in [HEADINGS, *rows])
    source.write_text(text, encoding="utf-8", errors="replace")
    try:
        draft = import_csv(source, "modicon", BUS)
    except ImportFileError as error:
        assert len(str(error).splitlines()) == 1
    else:
        written(folder, draft)


@given(name=st.text(), doc=st.text(), unit=st.text(max_size=5))
def test_whatever_a_point_is_called_its_file_is_read_again(tmp_path_factory, name, doc, unit):
    assume(not any(placeholder_in(text) for text in (name, doc, unit)))  # those are refused
    path = tmp_path_factory.mktemp("names") / "x\n.csv"
    collector = Collector(path)
    keys = {"table": "input", "address": 1, "unit": unit, "doc": doc}
    points = [collector.point("plc", name, 1, dict(keys)), collector.point("plc", name, 2, keys | {"address": 2})]
    rig = written(path.parent, Draft(path, [DraftBus("plc", BUS, points)], collector.notes))
    assert rig.point[0].doc == doc
    assert rig.point[0].name != rig.point[1].name


def drafted(tmp_path, text: str) -> tuple[dict[str, dict], list[str]]:
    draft = import_csv(table(tmp_path, text), "zero", dict(BUS))
    return {point.name: point.keys for point in draft.buses[0].points}, draft.notes


def test_one_hexadecimal_letter_makes_the_column_of_addresses_hexadecimal(tmp_path):
    points, notes = drafted(tmp_path, "name,address,table,type\na,0012,input,int16\nb,001C,input,int16\n")
    assert [points[name]["address"] for name in "ab"] == [0x12, 0x1C]
    assert notes == ["line 1: addresses hold the letters A to F: all of them were read as hexadecimal"]
    points, notes = drafted(tmp_path, "name,address,table,type\na,0012,input,int16\nb,0020,input,int16\n")
    assert ([points[name]["address"] for name in "ab"], notes) == ([12, 20], [])


@pytest.mark.parametrize("other", ["0x0012", "12"])
def test_a_column_of_addresses_in_two_bases_is_refused(tmp_path, other):
    with pytest.raises(ImportFileError, match=r"line 1: address.* hexadecimal .*write 0x before each"):
        drafted(tmp_path, f"name,address,table,type\na,{other},input,int16\nb,001C,input,int16\n")


@pytest.mark.parametrize("column", ["scale", "offset"])
def test_a_point_beside_decimal_commas_may_be_a_thousand_and_leaves_the_line_out(tmp_path, column):
    text = f"name;address;table;type;{column};unit\na;0;input;int16;0,5;W\nb;1;input;int16;1.000;W\n"
    points, notes = drafted(tmp_path, text)
    assert list(points) == ["a"]
    assert f"line 3: b: {column} '1.000' may be a thousand or a fraction" in notes[-1]


def test_three_digits_behind_a_decimal_point_are_a_fraction_where_no_comma_is(tmp_path):
    points, _ = drafted(tmp_path, "name;address;table;type;scale\na;0;input;int16;0.5\nb;1;input;int16;1.000\n")
    assert "scale" not in points["b"]


@pytest.mark.parametrize(
    ("access", "scale", "ends", "plausible"),
    [
        ("r", "0.01", "-4000,12000", None),
        ("r", "0.1", "-40,120", [-40.0, 120.0]),
        ("rw", "0.1", "0,900", None),
        ("rw", "0.1", "0,90.5", [0.0, 90.5]),
        ("rw", "1", "0,90", [0.0, 90.0]),
    ],
)
def test_a_range_in_raw_counts_is_not_taken_for_one_in_the_unit(tmp_path, access, scale, ends, plausible):
    text = f"name,address,table,type,scale,unit,access,min,max\nt,3,holding,int16,{scale},degC,{access},{ends}\n"
    points, notes = drafted(tmp_path, text)
    assert points["t"].get("plausible") == plausible
    is_open = plausible is None or (access, scale) == ("r", "0.1")
    assert ["raw counts" in note for note in notes] == ([True] if is_open else [])


@pytest.mark.parametrize(
    ("heading", "cell", "order"),
    [
        ("Word swap", "yes", "CDAB"),
        ("Word swapped", "Nein", "ABCD"),
        ("Byte-Swap", "ja", "BADC"),
        ("Swap", "both", "DCBA"),
        ("swap", "yes", None),
        ("Endianness of words", "little", None),
        ("byte swap", "sometimes", None),
    ],
)
def test_a_column_of_swaps_orders_the_bytes_or_leaves_the_point_out(tmp_path, heading, cell, order):
    text = f"name,address,table,type,{heading}\na,0,input,float32,{cell}\nb,4,input,float32,\n"
    points, notes = drafted(tmp_path, text)
    assert points.get("a", {}).get("order") == order
    assert points["b"]["order"] == "ABCD"
    assert [note.endswith("(left out)") for note in notes] == ([True] if order is None else [])


def test_an_address_that_looks_like_a_modicon_number_is_noted_once_a_table(tmp_path):
    text = "name,address,function,type\na,40011,3,uint16\nb,40012,3,uint16\nc,300,4,uint16\n"
    _, notes = drafted(tmp_path, text)
    assert [note.split(";")[0] for note in notes] == [
        "line 2: a: address 40011 in table holding looks like a Modicon number"
    ]


def test_no_point_of_an_import_has_a_column_of_another_or_of_a_record(tmp_path):
    points = (("Time", "s"), ("Quality", "1"), ("T a", "°C"), ("t_A", "°C"), ("T a quality", "1"))
    rows = [f"{name},input,{address},uint16,{unit}" for address, (name, unit) in enumerate(points)]
    source, out = table(tmp_path, "\n".join(["name,table,address,type,unit", *rows, ""])), tmp_path / "rig.toml"
    asked = ["--from", str(source), "--addressing", "zero", "--host", "10.0.0.5", "--out", str(out)]
    done = CliRunner().invoke(init, asked)
    assert done.exit_code == 0, (done.output, done.exception)
    names = [point.name for point in load_rig(out).point]
    assert names == ["Time_value", "Quality_value", "T_a", "t_A_2", "T_a_quality_value"]
