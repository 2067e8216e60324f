"""Rig files: the shipped one loads, and each mistake gets a sentence with file, line, key and remedy."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.rig_file.model import Point
from drivers.rig_file.reader import RigFileError, load_rig

PROJECT = Path(__file__).resolve().parents[2]
VIRTUAL = PROJECT / "profiles" / "rigs" / "virtual.toml"


def broken(tmp_path: Path, old: str, new: str, count: int = 1) -> Path:
    text = VIRTUAL.read_text(encoding="utf-8")
    assert old in text
    path = tmp_path / "rig.toml"
    path.write_text(text.replace(old, new, count), encoding="utf-8")
    return path


def complaint(path: Path) -> str:
    with pytest.raises(RigFileError) as caught:
        load_rig(path)
    return str(caught.value)


def test_the_virtual_rig_file_loads():
    rig = load_rig(VIRTUAL)
    assert [p.name for p in rig.setpoints] == ["heater_power_set", "pump_speed_set", "fan_speed_set"]
    assert sum(p.bus == "thermocouples" and p.kind == "measured" for p in rig.point) == 9
    assert rig.bus["thermocouples"].dbc.is_file()


def test_wrong_word_order_names_line_point_and_choices(tmp_path):
    path = broken(tmp_path, 'order = "CDAB"', 'order = "ABDC"')
    text = complaint(path)
    line = next(n for n, row in enumerate(path.read_text().splitlines(), 1) if "ABDC" in row)
    assert f"rig.toml, line {line}: order of point heater_power" in text
    assert "'ABDC' is not known; use 'ABCD', 'CDAB', 'BADC' or 'DCBA'" in text


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('unit = "W"\n', "", ["unit of point heater_power_set", "is missing"]),
        ('unit = "W"\n', 'unit = "Watts"\n', ["'Watts' is not known; did you mean W?"]),
        ("address = 1\n", "address = 0\n", ["pump_speed_set: holding register 0 is heater_power_set's already"]),
        ('name = "flow"', 'name = "pump_speed"', ["a second point is called 'pump_speed'"]),
        ('name = "T_pm2"', 'name = "t_PM1"', ["t_PM1: its column 't_PM1_C' is also that of T_pm1; rename the point"]),
        ('name = "cycle_counter"', 'name = "Segment"', ["Segment: records have a column 'segment' of their own"]),
        (
            'name = "cycle_counter"',
            'name = "plc_status_quality"',
            ["its column 'plc_status_quality' is that of the quality of plc_status"],
        ),
        ("limits = [0.0, 1000.0]", "limits = [1000.0, 0.0]", ["lower bound 1000 must be below"]),
        ("safe_value = 0.0\n", "", ["heater_power_set", "without safe_value"]),
        ("safe_value = 0.0\n", "safe_value = 1500.0\n", ["safe_value 1500 is outside limits"]),
        ("safe_value = 0.0\n", "safe_valeu = 0.0\n", ["safe_valeu of point heater_power_set", "not a key"]),
        ('transport = "modbus_tcp"', 'transport = "modbus_udp"', ["transport 'modbus_udp' is not known"]),
        ('bus = "plc"', 'bus = "plcc"', ["no bus 'plcc'; there is plc, thermocouples"]),
        ("port = 5020", "port = 502000", ["port", "65535", "502000"]),
        ('uptime = "plc_uptime"', 'uptime = "uptime"', ["bus plc: no point 'uptime' on this bus"]),
        ("port = 5020", 'port = 5020\ntransaction = "none"', ["'none' is not known; use 'checked' or 'zero'"]),
        ('"modbus_tcp"', '"modbus_rtu_tcp"\ntransaction = "zero"', ["RTU frames have no transaction; take it out"]),
        ('message = "TC_A"\n', "", ["T_heater: a point on CAN needs message and signal"]),
        ("scale = 0.1", "scale = 0.0", ["a scale of 0 loses the value"]),
        ('readback = "heater_power"', 'readback = "heater"', ["no point 'heater' to read back"]),
        ('point = "heartbeat"', 'point = "beat"', ["heartbeat: no point 'beat'"]),
        ('point = "heartbeat"', 'point = "flow"', ["heartbeat: flow is written to as point; give it access 'rw'"]),
        ('arm = "arm"', 'arm = "flow"', ["heartbeat: flow is written to as arm; give it access 'rw'"]),
        ("[rig]", "[rig", ["is not valid TOML", "line"]),
    ],
)
def test_each_mistake_is_one_sentence_with_place_and_remedy(tmp_path, old, new, words):
    text = complaint(broken(tmp_path, old, new))
    assert "rig.toml" in text
    assert "line" in text
    for word in words:
        assert word in text


def test_all_mistakes_come_together(tmp_path):
    path = broken(tmp_path, 'order = "CDAB"', 'order = "XY"', count=2)
    assert len(complaint(path).splitlines()) == 2


def test_a_missing_file_is_said_plainly(tmp_path):
    assert "there is no such file" in complaint(tmp_path / "none.toml")


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_damaged_files_raise_nothing_but_our_own_error(tmp_path_factory, data):
    lines = VIRTUAL.read_text(encoding="utf-8").splitlines()
    for _ in range(data.draw(st.integers(1, 4))):
        index = data.draw(st.integers(0, len(lines) - 1))
        lines[index] = data.draw(
            st.sampled_from(["", "x", '= "', "[bus]", "bus = 3", "[[point]]", "point = []", "[bus.plc]"])
        )
    path = tmp_path_factory.mktemp("fuzz") / "rig.toml"
    path.write_text("\n".join(lines), encoding="utf-8")
    try:
        load_rig(path)
    except RigFileError as error:
        assert "rig.toml" in str(error)


INTERLOCK = '\n[[interlock]]\nkind = "{kind}"\nlevel = "{level}"\n{rest}\n'


@pytest.mark.parametrize(
    ("kind", "level", "rest", "said"),
    [
        ("limit", "alarm", 'point = "T_tnk"\nhigh = 60.0', "no point 'T_tnk'"),
        ("limit", "alarm", 'point = "T_tank"', "a limit needs low, high or both"),
        ("limit", "warning", 'point = "T_tank"\nlow = 1.0\nhigh = 2.0\ndeadband = 1.0', "no room for the deadband"),
        ("limit", "alarm", 'point = "heater_power_set"\nhigh = 60.0', "read on every tick"),
        ("heater_power", "alarm", 'setpoint = "heater_power"\ntolerance = 60.0', "is not a set-point"),
        ("no_flow", "alarm", 'heater = "heater_power"\nflow = "flow"', "low"),
        ("residual", "alarm", 'sensor = "T_tank"\nhigh = 2.0', "use level = 'warning'"),
        ("residual", "warning", "high = 2.0", "interlock.sensor: is missing; add it"),
        ("leak", "alarm", 'point = "T_tank"', "kind 'leak' is not known"),
        ("limit", "fatal", 'point = "T_tank"\nhigh = 60.0', "'fatal' is not known; use 'warning' or 'alarm'"),
    ],
)
def test_a_wrong_interlock_is_named_with_its_line(tmp_path, kind, level, rest, said):
    shipped = Path(__file__).resolve().parents[2] / "profiles" / "rigs" / "virtual.toml"
    text = shipped.read_text(encoding="utf-8")
    path = tmp_path / "rig.toml"
    path.write_text(text + INTERLOCK.format(kind=kind, level=level, rest=rest), encoding="utf-8")
    with pytest.raises(RigFileError) as caught:
        load_rig(path)
    assert said in str(caught.value)
    line = int(str(caught.value).split("line ")[1].split(":")[0])
    assert line > len(text.splitlines())


def test_the_point_that_the_guide_of_register_tables_shows_is_a_point():
    text = (PROJECT / "docs/how-to/import-a-register-table.md").read_text(encoding="utf-8")
    example = re.search(r'```toml file=pump_state.toml\n(\[\[point\]\]\nname = "pump_state".*?)```', text, re.DOTALL)
    assert example is not None
    (keys,) = tomllib.loads(example[1])["point"]
    point = Point(**keys)
    assert (point.bits, point.label_of, point.sentinels) == ((4, 6), {0: "off", 2: "run"}, {7.0})


SMALL = """\
[rig]
name = "small"

[bus.plc]
transport = "modbus_tcp"

[[point]]
name = "p"
bus = "plc"
table = "input"
address = 1
unit = "1"
"""


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ("[rig]", 'bus = "plc"\n[rig]', 5, "is not valid TOML"),
        ('[bus.plc]\ntransport = "modbus_tcp"', "", 1, "bus: is missing; add it"),
        ('[rig]\nname = "small"\n\n[bus.plc]\ntransport = "modbus_tcp"', 'bus = "plc"', 1, "bus must be a section"),
        ("[bus.plc]\ntransport", "[bus]\nplc", 5, "bus.plc must be a section, [bus.plc], with transport"),
        ("[[point]]", "[point]", 7, "point must be sections with two brackets, [[point]]"),
        ("[[point]]", "[[interlock]]\nkind = 3\n[[point]]", 8, "kind 3 is not known; use"),
        ('name = "small"', 'name = "small"\nheartbeat = 3', 3, "heartbeat: must be a table of keys, got 3"),
        ('name = "small"', "name = 3", 2, "name: must be text in quotes, got 3"),
        ('name = "small"', 'name = "small"\nperiod_s = "fast"', 3, "period_s: must be a number, got 'fast'"),
        ('name = "small"', 'name = "small"\nperiod_s = -1', 3, "period_s: must be above 0, got -1"),
        ("[rig]", 'name = "twice"\n[rig]', 1, "name is there twice, above [rig] and in it"),
        ("address = 1", "address = 1.5", 11, "address of point p: must be a whole number, got 1.5"),
        ("address = 1", "address = 1\nbits = [1, 2, 3]", 12, "bits of point p: must be a list of 2 values, got 3"),
        ("address = 1", "address = 1\nplausible = [1]", 12, "plausible of point p: has too few values"),
        ("address = 1", "address = 1\nlabels = 3", 12, "labels of point p: must be a table of keys, got 3"),
        ("address = 1", "address = 1\ninvalid = 4", 12, "invalid of point p: must be a list in square brackets"),
        (
            'name = "p"',
            'name = "1p"',
            8,
            "name of point 1p: '1p' must be letters a to z, digits and under",
        ),
        ('name = "p"', f'name = "{"p" * 121}"', 8, "has 121 characters, at most 120 are taken; shorten it"),
        ('transport = "modbus_tcp"', 'host = "h"', 4, "bus.plc: transport is missing; add it"),
        ('transport = "modbus_tcp"', 'transport = "modbus_tcp"\nhole = [{}]', 6, "bus.plc.hole.table: is missing"),
    ],
)
def test_a_section_or_a_value_of_the_wrong_kind_is_named_with_its_line(tmp_path, old, new, line, said):
    assert old in SMALL
    path = tmp_path / "rig.toml"
    path.write_text(SMALL.replace(old, new, 1), encoding="utf-8")
    text = complaint(path)
    assert said in text
    assert f"line {line}" in text
    assert "Input should" not in text
