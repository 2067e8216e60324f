"""What `hil check` says of a rig file that is allowed and most likely not meant."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

from drivers.rig_file.reader import load_rig
from drivers.signals.roles import ROLES
from hil.cli.rig_commands.check import command
from hil.rig.notices import notices, unguarded
from hil.run.restore.thermal_restore import restore_obstacle
from hil.run.session.request import RunRequest, prepare
from tests.hil.test_resume import hil, killed

VIRTUAL = Path(__file__).resolve().parents[2] / "profiles" / "rigs" / "virtual.toml"
HOT = ("safe_value = 0.0", "safe_value = 50.0")
NO_ROLES = (r'role = "\w+"\n', "")
LOAD = "time_s,heater_power_W,pump_speed_pct,fan_speed_pct\n0,700,100,70\n9000,700,100,70\n"


def rig_file(folder: Path, *changes: tuple[str, str]) -> Path:
    """The virtual rig's file with each first text, a regular expression, made the second."""
    text = VIRTUAL.read_text(encoding="utf-8")
    for old, new in changes:
        assert re.search(old, text), old
        text = re.sub(old, new, text)
    path = folder / "rig.toml"
    path.write_text(text, encoding="utf-8")
    shutil.copy(VIRTUAL.with_name("thermocouples.dbc"), folder)
    return path


def told(path: Path) -> list[str]:
    """The notices, which are among the notes that `hil check` prints, and which do not refuse the file."""
    found = notices(load_rig(path), path)
    result = CliRunner().invoke(command, [str(path)])
    assert result.exit_code == 0, result.output
    assert all(f"note: {sentence}\n" in result.output for sentence in found)
    assert set(found) <= set(json.loads(CliRunner().invoke(command, [str(path), "--json"]).output)["notes"])
    return found


def test_the_shipped_rig_gives_no_cause(tmp_path):
    assert told(rig_file(tmp_path)) == []


def test_a_heater_that_stays_on_is_told_with_its_line(tmp_path):
    path = rig_file(tmp_path, HOT)
    line = path.read_text(encoding="utf-8").splitlines().index("safe_value = 50.0") + 1
    assert told(path) == [
        f"{path}, line {line}: safe_value of heater_power_set is 50 W, so that it stays on when a run is paused, trips "
        "or ends; set safe_value = 0"
    ]


def test_what_is_set_in_watts_without_a_role_may_be_a_heater(tmp_path):
    (sentence,) = told(rig_file(tmp_path, HOT, ('role = "heater_power"\n', "")))
    assert "a heater would stay on" in sentence and sentence.endswith("set safe_value = 0 if it heats")


def test_a_fan_that_is_set_in_watts_is_no_heater(tmp_path):
    path = rig_file(tmp_path, HOT, ('role = "heater_power"', 'role = "fan_speed"'))
    assert told(path) == []


@pytest.mark.parametrize(
    ("known", "role", "meant"),
    [
        ("heater_power", "heater", "heater_power"),
        ("fan_speed", "Fan", "fan_speed"),
        ("T_ambient", "t_ambient", "T_ambient"),
        ("T_radiator", "radiator", "T_radiator"),
    ],
)
def test_a_role_that_nothing_knows_is_told_with_the_nearest_and_all(tmp_path, known, role, meant):
    path = rig_file(tmp_path, (f'role = "{known}"', f'role = "{role}"'))
    line = path.read_text(encoding="utf-8").splitlines().index(f'role = "{role}"') + 1
    assert told(path) == [
        f"{path}, line {line}: role '{role}' of {known} is none that hil knows; did you mean "
        f"'{meant}'? The known ones are {', '.join(ROLES)}; take role out if none fits: roles serve `hil resume`, the "
        "report and `hil review` alone, and a twin finds its columns by name"
    ]


def test_a_rig_that_resume_cannot_restore_is_named(tmp_path):
    path = rig_file(tmp_path, NO_ROLES, HOT)
    rig = load_rig(path)
    stays_on, cannot = told(path)
    assert "stay on" in stays_on
    assert cannot == f"{path}: {restore_obstacle(rig, rig.setpoints)}"
    assert "none of heater_power_set, pump_speed_set, fan_speed_set has the role heater_power or fan_speed" in cannot
    assert "`hil resume` keeps the profile's load and waits" in cannot


NO_HEARTBEAT = (r"(?s)\[heartbeat\].*?\n\n", "")
NO_ALARMS = (r"(?m)^alarm = .*\n", "")
AN_ALARM = (r"\Z", '\n[[interlock]]\nkind = "limit"\nlevel = "alarm"\npoint = "T_tank"\nhigh = 70.0\n')


def test_a_rig_without_a_watchdog_is_told_before_a_run_moves_it(tmp_path):
    path = rig_file(tmp_path, NO_HEARTBEAT)
    (sentence,) = told(path)
    assert "it keeps heater_power_set, pump_speed_set, fan_speed_set when this machine loses power" in sentence
    (tmp_path / "load.csv").write_text(LOAD, encoding="utf-8")
    assert sentence in prepare(RunRequest(tmp_path / "load.csv", path, None, tmp_path, use_twin=False)).notes


def test_a_rig_without_any_alarm_is_told(tmp_path):
    (sentence,) = told(rig_file(tmp_path, NO_ALARMS))
    assert "nothing trips the run when the rig gets too hot" in sentence


def test_an_interlock_that_trips_is_an_alarm(tmp_path):
    assert told(rig_file(tmp_path, NO_ALARMS, AN_ALARM)) == []


def test_a_rig_that_is_only_read_needs_neither(tmp_path):
    text = rig_file(tmp_path, NO_HEARTBEAT, NO_ALARMS).read_text(encoding="utf-8")
    read_only = "[[point]]".join(part for part in text.split("[[point]]") if "limits = " not in part)
    (tmp_path / "read.toml").write_text(read_only.split("[[interlock]]")[0], encoding="utf-8")
    assert unguarded(load_rig(tmp_path / "read.toml"), tmp_path) == []


def test_one_set_point_that_leads_is_enough(tmp_path):
    assert told(rig_file(tmp_path, NO_ROLES)) == []  # in W, and safe at 0
    rig = load_rig(rig_file(tmp_path))
    pump = [point for point in rig.setpoints if point.name == "pump_speed_set"]
    assert restore_obstacle(rig, pump) is not None  # a profile that moves the pump alone
    assert restore_obstacle(rig, rig.setpoints[2:]) is None  # the fan


def test_a_rig_without_a_temperature_has_nowhere_to_be_led_back_to(tmp_path):
    path = rig_file(tmp_path, NO_ROLES, HOT, ('unit = "degC"', r'unit = "degC"\nkind = "status"'))
    (sentence,) = told(path)
    assert "stay on" in sentence


def test_resume_says_so_before_it_moves_anything(tmp_path):
    rig = rig_file(tmp_path, NO_ROLES, HOT)
    (tmp_path / "load.csv").write_text(LOAD, encoding="utf-8")
    folder = killed(tmp_path, 60, "--rig", rig, "--virtual", "--lockstep", "--no-twin")
    done = hil("resume", folder, "--no-viewer", "--timeout", 0, "--band", 0.001)
    loaded = load_rig(rig)
    sentence = restore_obstacle(loaded, loaded.setpoints)
    assert sentence is not None
    assert done.stderr.index(sentence) < done.stderr.index("restoring")


def test_addresses_that_look_like_numbers_of_a_manual_are_told_once_a_table(tmp_path):
    head = '[rig]\nname = "one"\n[bus.plc]\ntransport = "modbus_tcp"\n'
    point = '[[point]]\nname = "{0}"\nbus = "plc"\nunit = "W"\ntable = "{1}"\naddress = {2}\n'
    path = tmp_path / "rig.toml"
    points = [("P1", "holding", 40007), ("P2", "holding", 40008), ("P3", "input", 40009), ("P4", "holding", 7)]
    path.write_text(head + "".join(point.format(*each) for each in points), encoding="utf-8")
    (sentence,) = told(path)
    assert sentence.startswith(f"{path}, line 10: addresses of P1, P2 in table holding of bus plc look like numbers of")
    assert "where 40001 is the first one; addresses here count from zero, so subtract 40001" in sentence
