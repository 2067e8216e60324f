"""What polling costs, and what `hil check` says of a rig file, offline."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from drivers.modbus.budget import missing_declarations, polling
from drivers.modbus.serial_line import silence_s
from drivers.rig_file.bus_sections import ModbusTcpBus
from drivers.rig_file.model import Point
from drivers.rig_file.reader import load_rig
from drivers.signals.points import ConfigurationError
from hil.cli.rig_commands.check import command

PROJECT = Path(__file__).resolve().parents[2]
VIRTUAL = PROJECT / "profiles" / "rigs" / "virtual.toml"


def registers(count: int) -> list[Point]:
    return [Point(name=f"p{a}", bus="b", unit="1", table="input", address=a) for a in range(count)]


def test_silence_between_frames_is_that_of_the_serial_line_specification():
    assert silence_s(9600) == pytest.approx(4.01e-3, abs=1e-5)
    assert silence_s(19200) == pytest.approx(2.005e-3, abs=1e-6)
    assert silence_s(115200) == 1.75e-3


def test_bytes_and_time_of_a_read_of_ten_registers():
    bus = ModbusTcpBus(transport="modbus_tcp", serial_baud=9600)
    cost = polling("b", bus, registers(10))
    assert cost.bytes_per_tick == (7 + 5) + (7 + 2 + 20)
    # 8 bytes asked, 25 answered, of 11 bits each, and two silences
    assert cost.line_s == pytest.approx(33 * 11 / 9600 + 2 * 3.5 * 11 / 9600)
    assert polling("b", bus.model_copy(update={"serial_baud": None}), registers(10)).line_s is None


def test_the_table_shows_blocks_gaps_and_bytes():
    result = CliRunner().invoke(command, [str(VIRTUAL)])
    assert result.exit_code == 0, result.output
    assert "input 0 to 11" in result.output
    assert "1 read and 45 bytes every 1 s" in result.output
    assert "TC_A every 1 s" in result.output
    assert "no mistakes found" in result.output


def test_the_plan_as_json():
    found = json.loads(CliRunner().invoke(command, [str(VIRTUAL), "--json"]).output)
    (read,) = found["modbus"]["plc"]["reads"]
    assert (read["function"], read["address"], read["count"], read["unused"]) == (4, 0, 12, 1)
    assert found["can_cycle_s"] == {"thermocouples": {"TC_A": 1.0, "TC_B": 1.0, "TC_C": 1.0}}
    assert found["notes"] == []


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "port = 5020\n",
            "port = 5020\nserial_baud = 300\n",
            "take 1.61 s of a line at 300 bit/s and the period is 1 s",
        ),
        ('signal = "T_tank"\n', 'signal = "T_tank"\nstale_after_s = 0.5\n', "T_tank: is stale after 0.5 s and TC_C"),
        ("port = 5020\n", "port = 5020\nhole = [{ table = 'input', first = 5, last = 5 }]\n", "is in the hole 5"),
        ("address = 11\n", "address = 65536\n", "must be at most 65535"),
        ("address = 8\n", "address = 65535\n", "ends at 65536 and the last address is 65535"),
        ("port = 5020\n", "port = 5020\nmax_read = 1\n", "takes 2 registers and one request 1"),
        ("limits = [0.0, 1000.0]", "limits = [0.0, 7000.0]", "7000 W cannot be written"),
    ],
)
def test_what_cannot_work_is_said_with_its_line(tmp_path, old, new, said):
    text = VIRTUAL.read_text(encoding="utf-8")
    assert old in text
    path = tmp_path / "rig.toml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    (tmp_path / "thermocouples.dbc").write_bytes(VIRTUAL.with_name("thermocouples.dbc").read_bytes())
    result = CliRunner().invoke(command, [str(path)])
    assert isinstance(result.exception, ConfigurationError)
    assert said in str(result.exception)
    assert "rig.toml, line " in str(result.exception)


def test_what_a_rig_file_leaves_unsaid_is_noted():
    rig = load_rig(VIRTUAL)
    bare = tuple(point.model_copy(update={"plausible": None, "max_rate": None}) for point in rig.point)
    notes = missing_declarations(rig.model_copy(update={"point": bare}))
    assert any("no plausible range" in note and "flow" in note for note in notes)
    assert any("no max_rate" in note and "heater_power_set" in note for note in notes)


UNLIMITED = """\
[rig]
name = "bench"
[bus.plc]
transport = "modbus_tcp"
[[point]]
name = "pump_set"
bus = "plc"
table = "holding"
address = 0
unit = "%"
access = "rw"
[[point]]
name = "mode"
bus = "plc"
table = "holding"
address = 1
unit = "1"
access = "rw"
kind = "status"
[[point]]
name = "valve_set"
bus = "plc"
table = "holding"
address = 2
unit = "%"
access = "w"
"""
LIMITS = "limits = [0.0, 100.0]\nsafe_value = 0.0\nmax_rate = 5.0\n"


def _notes(path: Path, text: str) -> list[str]:
    path.write_text(text, encoding="utf-8")
    result = CliRunner().invoke(command, [str(path)])
    assert result.exit_code == 0, result.output
    return [line for line in result.output.splitlines() if line.startswith("note: ")]


def test_points_that_may_be_written_and_have_no_limits_are_named_with_all_that_they_lack(tmp_path):
    limits, readback, heartbeat = sorted(_notes(tmp_path / "rig.toml", UNLIMITED), key=lambda note: "[heart" in note)
    assert limits.startswith("note: no limits and no safe_value") and limits.endswith(": pump_set, valve_set")
    assert "give each limits, safe_value and max_rate" in limits
    assert 'give readback = "NAME"' in readback and readback.endswith(": pump_set, valve_set")
    assert "there is no [heartbeat]" in heartbeat and "it keeps pump_set, valve_set when" in heartbeat


def test_points_with_limits_of_states_and_of_the_heartbeat_do_not_lack_any(tmp_path):
    given = UNLIMITED.replace('access = "rw"\n[[', f'access = "rw"\n{LIMITS}[[').replace(
        'access = "w"\n', 'access = "r"\n'
    )
    assert not any("no limits" in note for note in _notes(tmp_path / "rig.toml", given))
    beat = UNLIMITED.replace("[bus.plc]", '[heartbeat]\npoint = "pump_set"\narm = "valve_set"\n[bus.plc]')
    assert not any("no limits" in note for note in _notes(tmp_path / "beat.toml", beat))


def test_a_rig_that_is_only_read_lacks_no_protection(tmp_path):
    text = (
        UNLIMITED.replace('"rw"', '"r"').replace('"w"', '"r"').replace('unit = "%"', 'unit = "%"\nplausible = [0, 100]')
    )
    assert _notes(tmp_path / "rig.toml", text) == []
