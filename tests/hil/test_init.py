"""`hil init` without a file: what is said, or answered, becomes a rig file that `hil check` accepts."""

from __future__ import annotations

import asyncio
import json
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from drivers.rig_file.reader import Rig, load_rig
from drivers.virtual.rig import start_virtual_rig
from hil.cli.rig_commands.check import command as check
from hil.cli.rig_commands.init import command as init
from tests.hil.command_line import hil

DBC = Path(__file__).resolve().parents[2] / "profiles" / "rigs" / "thermocouples.dbc"
ON_MODBUS = (
    "--heater",
    "set=holding:0*0.1,read=input:0:float32:CDAB",
    "--pump",
    "set=40002*0.1,read=30005*0.1",
    "--fan",
    "holding:2*0.1,read=input:5*0.1",
    "--flow",
    "input:2:float32:CDAB",
    "--heartbeat",
    "point=holding:3,counter=input:11,arm=holding:5,watchdog=holding:4*0.1",
)


def made(*options: object, typed: str | None = None) -> Result:
    return CliRunner().invoke(init, [str(option) for option in options], input=typed)


def accepted(path: Path) -> Rig:
    done = CliRunner().invoke(check, [str(path)])
    assert done.exit_code == 0, done.output
    assert "no mistakes found" in done.output
    return load_rig(path)


async def test_what_is_said_is_a_rig_file_that_finds_everything_on_the_rig(tmp_path):
    out = tmp_path / "mine.toml"
    async with await start_virtual_rig(period_s=0.2) as virtual:
        can = ("--dbc", DBC, "--socketcand", f"127.0.0.1:{virtual.can_port}", "--channel", "vcan0")
        done = await asyncio.to_thread(made, *ON_MODBUS, *can, "--port", virtual.modbus_port, "--out", out)
        assert done.exit_code == 0, done.output
        assert "20 points on plc, can; next: hil check" in done.output
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "hil", "check", str(out), "--online", "--json", stdout=asyncio.subprocess.PIPE
        )
        said, _ = await asyncio.wait_for(process.communicate(), 60)
    found = json.loads(said)
    assert (process.returncode, found["faults"]) == (0, [])
    assert {point["name"]: point["value"] for point in found["points"]}["watchdog_timeout"] == 10.0
    rig = accepted(out)
    assert [point.name for point in rig.setpoints] == ["heater_power_set", "pump_speed_set", "fan_speed_set"]
    heater, pump = rig.get("heater_power_set"), rig.get("pump_speed_set")
    assert (heater.limits, heater.safe_value, heater.readback, heater.scale) == (
        (0.0, 1000.0),
        0.0,
        "heater_power",
        0.1,
    )
    assert (pump.table, pump.address, pump.safe_value, pump.safe_order) == ("holding", 1, 100.0, 1)
    assert rig.get("heater_power").role == "heater_power"
    assert {point.alarm for point in rig.point if point.unit == "degC"} == {(-5.0, 75.0)}
    assert rig.watchdog_s == 5.0
    assert [spec.kind for spec in rig.interlock] == ["no_flow"]
    text = out.read_text(encoding="utf-8")
    assert text.count("# guessed") > 10


def test_thermocouples_on_modbus_and_several_of_a_kind(tmp_path):
    out = tmp_path / "rig.toml"
    done = made(
        "--heater",
        "holding:0",
        "--heater",
        "set=holding:1,max=300",
        "--pump",
        "holding:2",
        "--trip-at",
        "60",
        "--thermocouple",
        "T_tank=input:20:int16*0.01",
        "--thermocouple",
        "T_in=30022:int16*0.01",
        "--out",
        out,
        "--period",
        "2",
        "--name",
        "bench 4",
    )
    assert done.exit_code == 0, done.output
    rig = accepted(out)
    assert (rig.name, rig.period_s, rig.abort_after_s) == ("bench 4", 2.0, 10.0)
    assert [point.name for point in rig.setpoints] == ["heater_power", "heater_power_2", "pump_speed"]
    assert rig.get("heater_power_2").limits == (0.0, 300.0)
    assert (rig.get("T_in").table, rig.get("T_in").address, rig.get("T_in").alarm) == ("input", 21, (-5.0, 60.0))
    assert (rig.get("T_tank").role, rig.get("T_in").role) == ("T_tank", None)  # none that hil does not know
    assert "# No [heartbeat]: when this computer dies" in out.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--heater", "foo"], "'foo' is no place of a value; write it like holding:0"),
        (["--heater", "holding:70000"], "addresses go from 0 to 65535"),
        (["--heater", "40000"], "Modicon's numbers from 40001"),
        (["--heater", "holding:0:float31"], "type float31 is not known"),
        (["--heater", "set=holding:0,most=3"], "'most=3' in 'set=holding:0,most=3' is not understood"),
        (["--heater", "read=input:0"], "does not say where the heater is written"),
        (["--heater", "holding:0,max=-5"], "must be above 0"),
        (["--heater", "holding:0", "--pump", "holding:0"], "holding register 0 is heater_power's already"),
        (["--heater", "set=holding:0,max=100000"], "100000 does not fit in uint16"),
        (["--heater", "input:0"], "input registers cannot be written"),
        (["--thermocouple", "input:3"], "write NAME=PLACE"),
        (["--thermocouple", "T_tank=TC_C.T_tank"], "T_tank is on CAN, which needs a DBC"),
        (
            ["--heartbeat", "holding:3,watchdog=holding:4*10"],
            "a watchdog of 0 s would cut the heater between two beats",
        ),
        (["--socketcand", "here", "--dbc", str(DBC)], "is no host:port"),
        (["--from", str(DBC), "--heater", "holding:0"], "--from takes the rig from a file"),
        ([], "describe the rig"),
    ],
)
def test_what_cannot_be_understood_is_one_sentence_and_nothing_is_written(tmp_path, options, words):
    done = made(*options, "--out", tmp_path / "rig.toml")
    said = done.output + str(done.exception)
    assert done.exit_code in (1, 2), said  # 1: ours, which the command turns into a sentence and 2
    assert words in said
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_written_over_unasked(tmp_path):
    out = tmp_path / "rig.toml"
    out.write_text("mine", encoding="utf-8")
    refused = made("--heater", "holding:0", "--out", out)
    assert (refused.exit_code, out.read_text(encoding="utf-8")) == (2, "mine")
    assert "exists already" in refused.output
    assert made("--heater", "holding:0", "--out", out, "--force").exit_code == 0
    assert len(accepted(out).point) == 1


ANSWERS = [
    "my bench",
    "192.168.1.20",
    "1502",
    "3",
    "can0",
    str(DBC),
    "1",
    "holding:x",
    "holding:0*0.1",
    "input:0:float32:CDAB",
    "2000",  # a slip is asked again
    "1",
    "40002*0.1",
    "-",
    "",
    "0",
    "-",
    "y",
    "T_room",
    "input:6:int16*0.01",
    "-",
    "",
    "-",
]


def test_who_says_nothing_is_asked(tmp_path, monkeypatch):
    monkeypatch.setattr("hil.cli.rig_commands.init._somebody_is_there", lambda: True)
    out = tmp_path / "rig.toml"
    done = made("--out", out, typed="\n".join(ANSWERS) + "\n")
    assert done.exit_code == 0, done.output
    assert "'holding:x' is no place of a value" in done.output
    rig = accepted(out)
    plc = rig.bus["plc"]
    assert (rig.name, plc.host, plc.port, plc.device_id) == ("my bench", "192.168.1.20", 1502, 3)  # type: ignore[union-attr]
    assert rig.get("heater_power_set").limits == (0.0, 2000.0)
    assert rig.get("pump_speed").readback is None
    assert len([point for point in rig.point if point.unit == "degC"]) == 10
    assert rig.heartbeat is None


def test_who_gives_up_leaves_nothing_behind(tmp_path, monkeypatch):
    monkeypatch.setattr("hil.cli.rig_commands.init._somebody_is_there", lambda: True)
    done = made("--out", tmp_path / "rig.toml", typed="my bench\n")
    assert done.exit_code == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("option", "given", "said"),
    [
        ("--host", "http://10.0.0.5", "is a web address; give the name or the address alone"),
        ("--host", "10.0.0.5:1502", "write --host 10.0.0.5 --port 1502"),
        ("--host", "10.0.0.300", "is no address: IPv4 has four numbers from 0 to 255"),
        ("--socketcand", "10.0.0.300:29536", "is no address: IPv4 has four numbers from 0 to 255"),
        ("--socketcand", "10.0.0.3:70000", "port 70000 is not from 1 to 65535"),
    ],
)
def test_a_host_that_no_rig_file_takes_is_refused(tmp_path, option, given, said):
    out = tmp_path / "rig.toml"
    done = CliRunner().invoke(init, [option, given, "--heater", "set=holding:0*0.1,max=900", "--out", str(out)])
    assert done.exit_code == 2 and said in " ".join(done.output.split()) and not out.exists()


REGISTERS = """\
name,address,type,order,scale,unit,access,remark
heater_set,40001,uint16,,,W,,
pump_set,40002,uint16,,0.1,%,rw,
heater_power,30001,float32,,,W,r,
flow,30003,float32,CDAB,,L/min,r,
count,30005,uint32,,,,r,
torque,30007,int16,,1,in-lb,r,
T_tank,30010,int16,,0.1,degC,r,
"""


def _guessed(path: Path) -> dict[str, set[str]]:
    """Return the keys that are marked as guessed, by section or point."""
    found: dict[str, set[str]] = {}
    where = ""
    for line in path.read_text(encoding="utf-8").splitlines():
        if line.startswith("["):
            where = line.strip("[]")
        elif line.startswith("name = ") and where != "rig":
            where = line.split('"')[1]
        elif "# guessed" in line and not line.startswith("#"):
            found.setdefault(where, set()).add(line.split(" = ")[0])
    return found


def test_each_assumption_of_an_import_is_marked_and_what_is_given_is_not(tmp_path):
    (tmp_path / "table.csv").write_text(REGISTERS, encoding="utf-8")
    source = ("--from", tmp_path / "table.csv", "--addressing", "modicon")
    assert made(*source, "--out", tmp_path / "rig.toml").exit_code == 0
    points = {
        "heater_set": {"scale", "access"},
        "heater_power": {"order"},
        "count": {"order", "unit"},
        "torque": {"unit"},
    }
    assert _guessed(tmp_path / "rig.toml") == points | {
        "rig": {"period_s"},
        "bus.plc": {"host", "port", "device_id"},
    }
    stated = ("--host", "10.0.0.5", "--port", "1502", "--device-id", "3", "--period", "1", "--order", "ABCD")
    assert made(*source, *stated, "--out", tmp_path / "stated.toml").exit_code == 0
    assert _guessed(tmp_path / "stated.toml") == {
        "heater_set": {"scale", "access"},
        "count": {"unit"},
        "torque": {"unit"},
    }
    assert accepted(tmp_path / "rig.toml").get("heater_power").order == "ABCD"


def test_each_assumption_about_a_place_is_marked(tmp_path):
    places = (
        "--thermocouple",
        "T_a=input:20",
        "--thermocouple",
        "T_b=input:24:float32",
        "--flow",
        "input:2:float32:CDAB",
    )
    assert made(*places, "--out", tmp_path / "rig.toml").exit_code == 0
    marked = _guessed(tmp_path / "rig.toml")
    checks = {"plausible", "alarm", "stale_after_s"}
    assert (marked["T_a"], marked["T_b"], marked["flow"]) == (
        checks | {"type", "scale"},
        checks | {"order"},
        {"plausible"},
    )
    assert (accepted(tmp_path / "rig.toml").get("T_b").order, marked["bus.plc"]) == (
        "ABCD",
        {"host", "port", "device_id"},
    )


def test_a_fresh_import_with_set_points_is_told_what_protection_it_lacks(tmp_path):
    (tmp_path / "table.csv").write_text(REGISTERS, encoding="utf-8")
    assert (
        made("--from", tmp_path / "table.csv", "--addressing", "modicon", "--out", tmp_path / "rig.toml").exit_code == 0
    )
    said = CliRunner().invoke(check, [str(tmp_path / "rig.toml")]).output
    for lack in ("no limits and no safe_value", "no readback", "no plausible range", "there is no [heartbeat]"):
        (note,) = [line for line in said.splitlines() if line.startswith("note: ") and lack in line]
        assert "pump_set" in note or lack == "no plausible range"


TABLE = """name,address,type,scale,unit,access
pump_set,40001,uint16,0.1,%,rw
pump,40002,uint16,0.1,%,r
beat,40003,uint16,1,1,rw
"""


def test_keys_of_an_import_are_set(tmp_path):
    source, out = tmp_path / "registers.csv", tmp_path / "rig.toml"
    source.write_text(TABLE, encoding="utf-8")
    settings = (
        *("pump_set.limits=[0, 100]", "pump_set.safe_value=100.0", "pump_set.readback=pump_speed"),
        *("pump.role=pump_speed", "pump.name=pump_speed", "heartbeat.point=beat", "beat.kind=status"),
    )
    words = [word for text in settings for word in ("--set", text)]
    done = made("--from", source, "--addressing", "modicon", *words, "--out", out)
    assert done.exit_code == 0, done.output
    rig = accepted(out)
    assert rig.get("pump_set").limits == (0.0, 100.0) and rig.get("pump_set").readback == "pump_speed"
    assert rig.get("pump_speed").role == "pump_speed" and rig.heartbeat is not None and rig.heartbeat.point == "beat"


@pytest.mark.parametrize(
    ("setting", "sentence"),
    [
        ("pump_set", "is no POINT.KEY=VALUE"),
        ("pum_set.limits=[0, 1]", "there is no point pum_set; did you mean pump_set?"),
        ("pump_set.limits=[100, 0]", "makes an invalid rig file"),
        ("pump_set.colour=red", "makes an invalid rig file"),
        ("pump_set.type=colour", "makes an invalid rig file"),
        ("heartbeat.point=nothing", "makes an invalid rig file"),
    ],
)
def test_a_wrong_key_of_an_import_writes_nothing(tmp_path, setting, sentence):
    source, out = tmp_path / "registers.csv", tmp_path / "rig.toml"
    source.write_text(TABLE, encoding="utf-8")
    code, said = hil("init", "--from", source, "--addressing", "modicon", "--set", setting, "--out", out)
    assert code == 2 and sentence in said and "Traceback" not in said, said
    assert not out.exists()


def test_keys_are_set_of_an_import_alone(tmp_path):
    code, said = hil("init", "--heater", "holding:0", "--set", "a.b=1", "--out", tmp_path / "rig.toml")
    assert code == 2 and "give its file with --from" in said
