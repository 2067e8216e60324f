"""`hil init`: what users have already becomes a rig file that `hil check` accepts, or one sentence with its line."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.imports.draft import Collector, Draft, DraftBus, ImportFileError, write
from drivers.imports.homeassistant import Placed, draft_of, import_homeassistant
from drivers.imports.telegraf import import_telegraf
from drivers.imports.vendor_csv import import_csv
from drivers.points import ConfigurationError
from drivers.rigfile import Rig, load_rig
from hil.commands.check import command as check
from hil.commands.init import command as init

PROJECT = Path(__file__).resolve().parents[2]
DBC = PROJECT / "profiles" / "rigs" / "thermocouples.dbc"
BUS = {"transport": "modbus_tcp", "host": "10.0.0.5", "port": 502, "device_id": 3}

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


def written(tmp_path: Path, draft: Draft) -> Rig:
    path = tmp_path / "made.toml"
    path.write_text(write(draft, "made"), encoding="utf-8")
    return load_rig(path)


def table(tmp_path: Path, text: str, name: str = "registers.csv") -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


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
    assert "is there already" in again.output


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
        ("0,1", "0", 3, "a scale of 0 loses the value"),
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
    with pytest.raises(ImportFileError) as caught:
        import_csv(source, "modicon", BUS)
    text = str(caught.value)
    assert said in text
    assert f"registers.csv, line {line}: " in text
    assert len(text.splitlines()) == 1


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "has no line with a heading"),
        (b"name,address,type\n", "has a heading and no line below it"),
        (b"name,address,type\n\xff\xfe,1,uint16\n", "line 2: is not UTF-8 text"),
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


TELEGRAF = """\
[[inputs.modbus]]
  name = "Device"
  slave_id = 1
  controller = "tcp://localhost:1502"
  configuration_type = "register"
  discrete_inputs = [ { name = "start", address = [0] } ]
  coils = [ { name = "motor1_run", address = [0] } ]
  holding_registers = [
    { name = "power_factor", byte_order = "AB", data_type = "FIXED", scale=0.01, address = [8] },
    { name = "energy", byte_order = "ABCD", data_type = "FLOAT32", scale=0.001, address = [5,6] },
  ]
  input_registers = [ { name = "tank_level", byte_order = "AB", data_type = "INT16", scale=1.0, address = [0] } ]

[[inputs.modbus]]
  controller = "tcp://localhost:1502"
  configuration_type = "request"
  [[inputs.modbus.request]]
    slave_id = 2
    byte_order = "CDAB"
    register = "input"
    fields = [
      { address = 4, name = "flow", type = "FLOAT32" },
      { address = 6, name = "spare", type = "INT16", omit = true },
      { address = 7, name = "state", type = "BIT", bit = 3 },
      { address = 10, name = "serial", type = "STRING", length = 4 },
    ]
"""


def test_telegrafs_own_styles_become_buses_and_points(tmp_path):
    source = table(tmp_path, TELEGRAF.replace('"FIXED"', '"UINT16"'), "telegraf.toml")
    rig = written(tmp_path, import_telegraf(source))
    assert [(bus.host, bus.port, bus.device_id) for bus in rig.bus.values()] == [
        ("localhost", 1502, 1),
        ("localhost", 1502, 2),
    ]
    by_name = {point.name: point for point in rig.point}
    assert set(by_name) == {"start", "motor1_run", "power_factor", "energy", "tank_level", "flow", "state", "serial"}
    assert (by_name["energy"].table, by_name["energy"].address, by_name["energy"].scale) == ("holding", 5, 0.001)
    assert (by_name["flow"].bus, by_name["flow"].order, by_name["flow"].address) == ("plc2", "CDAB", 4)
    assert by_name["state"].bits == (3, 3)
    assert by_name["serial"].length == 4


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ("", "", 9, "type 'FIXED' of power_factor has no counterpart here"),
        ('"FIXED"', '"UINT16"\n', 9, "is not valid TOML"),
        ("tcp://localhost:1502", "file:///dev/ttyUSB0", 4, "is not Modbus/TCP"),
        ("address = [5,6]", "address = [5,7]", 10, "do not follow one another"),
        ("address = [5,6]", "address = [5]", 10, "takes 2 addresses, and has 1"),
        ('register = "input"', 'register = "inputs"', 20, "register 'inputs' is not known"),
        ('"CDAB"', '"CADB"', 22, "byte_order 'CADB' of flow is not known"),
        ("slave_id = 2", "slave_id = 300", 22, "slave_id 300 is no whole number from 0 to 255"),
    ],
)
def test_each_mistake_in_a_telegraf_file_is_named(tmp_path, old, new, line, said):
    text = TELEGRAF if not old else TELEGRAF.replace(old, new, 1)
    if old and "FIXED" not in old:
        text = text.replace('"FIXED"', '"UINT16"')
    with pytest.raises(ImportFileError) as caught:
        import_telegraf(table(tmp_path, text, "telegraf.toml"))
    assert said in str(caught.value)
    assert f"line {line}" in str(caught.value)


def placed(value: object, line: int = 1) -> Placed:
    """What the YAML reader makes of a value; every entry is a line further down."""
    if isinstance(value, dict):
        return Placed({key: placed(item, line + n) for n, (key, item) in enumerate(value.items())}, line)
    if isinstance(value, list):
        return Placed([placed(item, line + n) for n, item in enumerate(value)], line)
    return Placed(value, line)


def hub(*sensors: dict, **more: object) -> dict:
    return {
        "modbus": [{"name": "hub", "type": "tcp", "host": "10.0.0.9", "port": 5020, "sensors": list(sensors)} | more]
    }


def test_a_home_assistant_hub_becomes_points(tmp_path):
    document = hub(
        {"name": "Flow", "address": 2, "input_type": "input", "data_type": "float32", "swap": "word", "slave": 2}
        | {"unit_of_measurement": "L/min", "min_value": 0, "max_value": 8},
        {"name": "Supply", "address": 4, "scale": 0.1, "offset": -40, "nan_value": "0x8000"},
        binary_sensors=[{"name": "Pump", "address": 7, "input_type": "discrete_input"}],
        switches=[{"name": "Remote", "address": 9, "write_type": "coil"}],
        climates=[{"name": "c"}],
    )
    draft = draft_of(Path("ha.yaml"), placed(document))
    rig = written(tmp_path, draft)
    by_name = {point.name: point for point in rig.point}
    assert rig.bus["plc"].device_id == 2 and rig.bus["plc2"].device_id == 1
    assert (by_name["Flow"].order, by_name["Flow"].plausible, by_name["Flow"].unit) == ("CDAB", (0.0, 8.0), "L/min")
    assert (by_name["Supply"].type, by_name["Supply"].offset, by_name["Supply"].invalid) == ("int16", -40.0, (32768.0,))
    assert -32768.0 in by_name["Supply"].sentinels
    assert (by_name["Pump"].table, by_name["Remote"].access) == ("discrete", "rw")
    assert draft.notes == ["climates were left out: a rig has points only"]


@pytest.mark.parametrize(
    ("document", "said"),
    [
        ({}, "has no modbus: section"),
        (hub(type="serial"), "rig files know Modbus/TCP only yet"),
        (hub(), "without sensors or switches"),
        (hub({"address": 1}), "has no name"),
        (hub({"name": "x"}), "address of x None is no number"),
        (hub({"name": "x", "address": 70000}), "is no whole number from 0 to 65535"),
        (hub({"name": "x", "address": 1, "data_type": "custom"}), "data_type 'custom' of x is not known"),
        (hub({"name": "x", "address": 1, "swap": "all"}), "swap 'all' of x is not known"),
        (hub({"name": "x", "address": 1, "scale": "ten"}), "scale of x 'ten' is no number"),
        (hub({"name": "x", "address": 1}, host=None), "a hub has no host"),
        (hub({"name": "x", "address": 1}, {"name": "y", "address": 1}), "is x's already"),
    ],
)
def test_each_mistake_in_a_home_assistant_file_is_named(document, said):
    with pytest.raises(ImportFileError) as caught:
        draft_of(Path("ha.yaml"), placed(document))
    assert said in str(caught.value)
    assert "ha.yaml, line " in str(caught.value)


HOME = """\
modbus:
  - name: hub
    type: tcp
    host: !secret chiller
    port: 502
    sensors:
      - name: Flow
        address: 0x10
        slave: 1
        data_type: float32
"""


def test_yaml_is_read_with_its_lines_where_a_reader_is_installed(tmp_path):
    source = table(tmp_path, HOME, "ha.yaml")
    try:
        import yaml  # noqa: F401
    except ImportError:
        with pytest.raises(ImportFileError, match="takes PyYAML to read; install it"):
            import_homeassistant(source)
        return
    (point,) = written(tmp_path, import_homeassistant(source)).point
    assert (point.name, point.address, point.type) == ("Flow", 16, "float32")
    with pytest.raises(ImportFileError, match=r"ha.yaml, line 7: address of Flow"):
        import_homeassistant(table(tmp_path, HOME.replace("0x10", "ten"), "ha.yaml"))
    with pytest.raises(ImportFileError, match=r"ha.yaml, line \d+: is not valid YAML"):
        import_homeassistant(table(tmp_path, HOME.replace("host: ", "host: [", 1), "ha.yaml"))


def test_a_dbc_becomes_points_with_plausible_ranges_and_time_outs(tmp_path):
    copy, out = tmp_path / "tc.dbc", tmp_path / "rig.toml"
    copy.write_bytes(DBC.read_bytes())
    done = CliRunner().invoke(init, ["--from", str(copy), "--channel", "vcan0", "--out", str(out)])
    assert done.exit_code == 0, (done.output, done.exception)
    rig = load_rig(out)
    tank = rig.get("T_tank")
    assert (tank.message, tank.plausible, tank.stale_after_s, tank.unit) == ("TC_C", (-40.0, 150.0), 3.0, "degC")
    assert rig.bus["can"].dbc == copy
    assert CliRunner().invoke(check, [str(out)]).exit_code == 0


def test_a_dbc_that_is_none_is_said_plainly(tmp_path):
    done = CliRunner().invoke(
        init, ["--from", str(table(tmp_path, "BO_ x", "x.dbc")), "--out", str(tmp_path / "r.toml")]
    )
    assert isinstance(done.exception, ConfigurationError)
    assert "x.dbc: is not a DBC file" in str(done.exception)
    assert not (tmp_path / "r.toml").exists()


# Anything at all -----------------------------------------------------------------------------------------------------

CELLS = st.one_of(
    st.sampled_from(
        ["40001", "30001", "3", "0x10", "uint16", "float32", "CDAB", "0.1", "1/0", "rw", "°C", "4-7", "-", ""]
    ),
    st.text(max_size=8),
    st.integers(-10, 10**9).map(str),
    st.floats().map(str),
)
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


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_any_telegraf_file_is_imported_well_or_refused(tmp_path_factory, data):
    lines = TELEGRAF.replace('"FIXED"', '"UINT16"').splitlines()
    odd = st.sampled_from(
        ["", "x", '= "', "[[inputs.modbus]]", "address = -1", "slave_id = 1e9", "fields = 3", "request = {}"]
    )
    for _ in range(data.draw(st.integers(1, 4))):
        index = data.draw(st.integers(0, len(lines) - 1))
        words = lines[index].split("=")
        lines[index] = data.draw(odd) if data.draw(st.booleans()) else words[0] + "= " + data.draw(CELLS)
    folder = tmp_path_factory.mktemp("fuzz")
    source = folder / "telegraf.toml"
    source.write_text("\n".join(lines), encoding="utf-8", errors="replace")
    try:
        draft = import_telegraf(source)
    except ImportFileError as error:
        assert "telegraf.toml" in str(error)
    else:
        written(folder, draft)


VALUES = st.one_of(
    st.none(), st.booleans(), st.integers(-5, 70000), st.floats(), st.text(max_size=5), st.just([1]), st.just({})
)


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_any_home_assistant_entry_is_imported_well_or_refused(tmp_path_factory, data):
    keys = ["name", "address", "input_type", "data_type", "scale", "offset", "swap", "count", "slave", "nan_value"]
    keys += ["min_value", "max_value", "unit_of_measurement"]
    entry = {"name": "x", "address": 1}
    entry |= data.draw(st.dictionaries(st.sampled_from(keys), VALUES, max_size=4))
    more = data.draw(
        st.dictionaries(st.sampled_from(["host", "port", "type", "switches", "binary_sensors"]), VALUES, max_size=2)
    )
    try:
        draft = draft_of(Path("ha.yaml"), placed(hub(entry, **more)))
    except ImportFileError as error:
        assert "ha.yaml" in str(error)
    else:
        written(tmp_path_factory.mktemp("fuzz"), draft)


@given(name=st.text(), doc=st.text(), unit=st.text(max_size=5))
def test_whatever_a_point_is_called_its_file_is_read_again(tmp_path_factory, name, doc, unit):
    path = tmp_path_factory.mktemp("names") / "x\n.csv"
    collector = Collector(path)
    keys = {"table": "input", "address": 1, "unit": unit, "doc": doc}
    points = [collector.point("plc", name, 1, dict(keys)), collector.point("plc", name, 2, keys | {"address": 2})]
    rig = written(path.parent, Draft(path, [DraftBus("plc", BUS, points)], collector.notes))
    assert rig.point[0].doc == doc
    assert rig.point[0].name != rig.point[1].name
