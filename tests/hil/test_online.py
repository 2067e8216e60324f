"""`hil check --online` as a user types it, on the virtual rig in processes of its own: what is wrong, what comes."""

from __future__ import annotations

import asyncio
import json
import math
import re
import signal
import socket
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from drivers.can.bus import CanReceiver
from drivers.rig.watch import RigWatch
from drivers.rig_file.reader import load_rig
from drivers.signals.points import LinkError, Quality
from drivers.virtual.faults.faulty_link import FaultyLink, can_frames
from drivers.virtual.rig import start_virtual_rig

PROJECT = Path(__file__).resolve().parents[2]
VIRTUAL = PROJECT / "profiles" / "rigs" / "virtual.toml"


def rig_file(place: Path, modbus: int, can: int) -> Path:
    text = VIRTUAL.read_text(encoding="utf-8")
    for old, new in (
        ("port = 5020", f"port = {modbus}"),
        ("port = 29536", f"port = {can}"),
        ('"thermocouples.dbc"', f'"{VIRTUAL.parent}/thermocouples.dbc"'),
        ('"../twins/virtual.toml"', f'"{PROJECT}/profiles/twins/virtual.toml"'),
    ):
        assert old in text
        text = text.replace(old, new)
    path = place / "rig.toml"
    path.write_text(text, encoding="utf-8")
    return path


async def check(path: Path, *options: str, interrupt: bool = False) -> tuple[int, str]:
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "hil",
        "check",
        str(path),
        "--online",
        *options,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.STDOUT,
        cwd=PROJECT,
    )
    try:
        said = b""
        assert process.stdout is not None
        if interrupt:
            said = await asyncio.wait_for(process.stdout.readuntil(b"answer\n"), 60)
            process.send_signal(signal.SIGINT)
        rest, _ = await asyncio.wait_for(process.communicate(), 60)
    finally:
        if process.returncode is None:
            process.kill()
    assert process.returncode is not None
    return process.returncode, (said + rest).decode()


def nobody() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


class Recorder:
    """A relay that keeps the function codes of all requests."""

    def __init__(self, to: int) -> None:
        self.codes: set[int] = set()
        self._to = to

    async def __aenter__(self) -> Recorder:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        self.port = int(self._server.sockets[0].getsockname()[1])
        return self

    async def __aexit__(self, *_: object) -> None:
        self._server.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        back, there = await asyncio.open_connection("127.0.0.1", self._to)
        replies = asyncio.create_task(self._replies(back, writer))
        try:
            while True:
                head = await reader.readexactly(6)
                body = await reader.readexactly(int.from_bytes(head[4:], "big"))
                self.codes.add(body[1])
                there.write(head + body)
        except (OSError, asyncio.IncompleteReadError):
            pass
        finally:
            replies.cancel()
            there.close()
            writer.close()

    async def _replies(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while data := await reader.read(4096):
            writer.write(data)


async def test_a_rig_that_is_well_shows_what_it_holds_and_nothing_is_written(tmp_path):
    async with await start_virtual_rig(period_s=0.2) as virtual, Recorder(virtual.modbus_port) as relay:
        path = rig_file(tmp_path, relay.port, virtual.can_port)
        code, said = await check(path, "--json", "--seconds", "2.5")
        assert code == 0, said
        shown, text = await check(path)
        assert shown == 0, text
    found = json.loads(said)
    assert found["faults"] == []
    points = {point["name"]: point for point in found["points"]}
    assert set(points) == {point.name for point in load_rig(path).point}
    assert {point["quality"] for point in points.values()} == {"good"}
    room = points["T_ambient"]
    assert room["value"] == pytest.approx(int(room["raw"], 16) * 0.01)
    tank = points["T_tank"]
    assert re.fullmatch(r"([0-9A-F]{2} ){7}[0-9A-F]{2}", tank["raw"])
    assert tank["value"] == pytest.approx(int.from_bytes(bytes.fromhex(tank["raw"])[:2], "little") * 0.01)
    assert points["heater_power_set"] | {"age_s": 0} == {
        "name": "heater_power_set",
        "bus": "plc",
        "raw": "0000",
        "value": 0.0,
        "text": "",
        "unit": "W",
        "age_s": 0,
        "quality": "good",
        "limits": [0.0, 1000.0],
        "plausible": None,
        "alarm": None,
    }
    assert all(point["age_s"] < 10.0 for point in points.values())
    assert "all buses answer and all 25 points are good" in text
    assert relay.codes == {3, 4}


async def test_a_bus_that_is_down_is_named_and_the_other_is_shown(tmp_path):
    async with await start_virtual_rig(period_s=0.2) as virtual:
        path = rig_file(tmp_path, virtual.modbus_port, nobody())
        code, said = await check(path)
        as_json, document = await check(path, "--json")
    assert (code, as_json) == (1, 1)
    assert "virtual: 1 of 2 buses answer" in said
    assert re.search(r"plc \(Modbus/TCP 127.0.0.1:\d+, device 1\): answers", said)
    assert re.search(r"thermocouples \(.*\): is down\n.*cannot be opened: .*refused", said)
    assert re.search(r"T_ambient .* 2\d\.\d+ .*good", said)
    assert re.search(r"T_tank .* never came", said)
    assert "rig.toml: 1 fault on the rig" in said
    buses = json.loads(document)["buses"]
    assert (buses["plc"]["open"], buses["thermocouples"]["open"]) == (True, False)


async def test_both_buses_down_are_one_tree(tmp_path):
    code, said = await check(rig_file(tmp_path, nobody(), nobody()))
    assert code == 1
    assert "virtual: 0 of 2 buses answer" in said
    assert said.count("is down") == 2
    assert "2 faults on the rig" in said


async def test_a_sensor_that_is_open_is_told_with_what_came_over_the_wire(tmp_path):
    effects = tmp_path / "open.toml"
    effects.write_text(
        '[[effect]]\nkind = "sensor"\nwhere = "T_pm3_C"\nopen_circuit = true\nonset_s = 0.0\n', encoding="utf-8"
    )
    async with await start_virtual_rig(period_s=0.2, effects=effects) as virtual:
        code, said = await check(rig_file(tmp_path, virtual.modbus_port, virtual.can_port))
    assert code == 1
    assert re.search(r"T_pm3: sensor fault \(raw ([0-9A-F]{2} ){6}FF 7F\)", said)
    assert "1 fault on the rig" in said


async def test_ctrl_c_ends_a_long_look_in_order(tmp_path):
    async with await start_virtual_rig(period_s=0.2) as virtual:
        path = rig_file(tmp_path, virtual.modbus_port, virtual.can_port)
        code, said = await check(path, "--seconds", "600", interrupt=True)
    assert code == 0, said
    assert "all 25 points are good" in said
    assert "Traceback" not in said


async def test_a_bus_that_comes_later_is_shown_then(tmp_path):
    async with await start_virtual_rig(period_s=0.1) as virtual, FaultyLink(virtual.can_port, can_frames) as wire:
        rig = load_rig(rig_file(tmp_path, virtual.modbus_port, wire.port))
        wire.drop()
        async with RigWatch(rig) as watch:
            assert list(watch.faults()) == ["thermocouples"]
            never = [seen for seen in watch.seen() if seen.point.bus == "thermocouples"]
            assert all(math.isinf(seen.age_s) and seen.quality is Quality.LINK_FAULT for seen in never)
            await wire.restore()
            deadline = time.monotonic() + 30.0
            while watch.faults():
                assert time.monotonic() < deadline, watch.faults()
                await asyncio.sleep(0.1)
            assert all(seen.quality is Quality.GOOD for seen in watch.seen())


async def test_what_listens_and_says_nothing_is_no_can_bus(tmp_path):
    """python-can would wait for its greeting for ever."""
    with socket.socket() as mute:
        mute.bind(("127.0.0.1", 0))
        mute.listen()
        rig = load_rig(rig_file(tmp_path, nobody(), mute.getsockname()[1]))
        config: Any = rig.bus["thermocouples"].model_copy(update={"timeout_s": 0.2})
        points = tuple(point for point in rig.point if point.bus == "thermocouples")
        receiver = CanReceiver("thermocouples", config, points, time.monotonic)
        with pytest.raises(LinkError, match="cannot be opened: timed out"):
            await receiver.connect()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([str(PROJECT / "profiles/twins/loop.toml"), "--online"], "connects to the rig of a rig file"),
        ([str(VIRTUAL), "--seconds", "3"], "--seconds belongs to --online"),
    ],
)
def test_what_cannot_be_looked_at_is_said(options, words):
    from click.testing import CliRunner

    from hil.cli.rig_commands.check import command

    result = CliRunner().invoke(command, options)
    assert result.exit_code == 2
    assert words in result.output
