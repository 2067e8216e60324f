"""Kinds of fault of the campaign: the act on rig, wires or harness, and the required outcome."""

from __future__ import annotations

import asyncio
import os
import random
import signal
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Literal, Protocol

from drivers.virtual.faults import FaultyLink
from drivers.virtual.faults import faulty_replies as replies

Ending = Literal["stops", "rides", "either", "killed"]
"""Endings: the run ends by itself; goes on; one of the two, depending on the length of the fault; the harness is gone.
"""


class FaultTargets(Protocol):
    """Targets of a fault."""

    generator: random.Random
    plc: FaultyLink
    can: FaultyLink

    @property
    def pid(self) -> int: ...

    async def reboot(self, seconds: float) -> None: ...

    def fill_disk(self) -> None: ...

    def kill_child(self, words: str) -> None: ...


Act = Callable[[FaultTargets], Awaitable[None]]

MENDED_AFTER_S = 15.0
"""Time after which a failed sensor, pump or fan is repaired, s: many times as long as the run may take to end."""


@dataclass(frozen=True, slots=True)
class FaultKind:
    """`act` is None where the rig itself has the fault, by `effect`, a TOML table without onset.

    `early`: it may come at any instant, also before anything is moved. `place`: `tmpfs` for a disk of its own,
    `tls` for Modbus over TLS, `twin` with a calibrator, `viewer` with a viewer. `wire` is what it acts on, `plc` or
    `can`, where it acts on one.
    """

    about: str
    ending: Ending
    act: Act | None = None
    effect: str = ""
    early: bool = False
    place: str = ""
    wire: str = ""


def _lasting(change: Callable[[random.Random], replies.Change], wire: str = "plc") -> Act:
    """Change every frame from now on."""

    async def act(stage: FaultTargets) -> None:
        link = stage.plc if wire == "plc" else stage.can
        link.change = change(stage.generator)

    return act


def _brief(change: Callable[[random.Random], replies.Change], wire: str = "plc") -> Act:
    """Change frames for 0.1 to 0.5 s."""

    async def act(stage: FaultTargets) -> None:
        link = stage.plc if wire == "plc" else stage.can
        link.change = change(stage.generator)
        await asyncio.sleep(stage.generator.uniform(0.1, 0.5))
        link.change = None

    return act


async def _drop(stage: FaultTargets) -> None:
    stage.plc.drop()


async def _drop_briefly(stage: FaultTargets) -> None:
    stage.plc.drop()
    await asyncio.sleep(stage.generator.uniform(0.05, 0.3))
    await stage.plc.restore()


async def _half_open(stage: FaultTargets) -> None:
    stage.plc.mute()


async def _server_restart(stage: FaultTargets) -> None:
    """Restart the Modbus server of the gateway; the PLC behind it goes on."""
    stage.plc.drop()
    await asyncio.sleep(stage.generator.uniform(0.3, 4.0))
    await stage.plc.restore()


async def _can_drop(stage: FaultTargets) -> None:
    stage.can.drop()


async def _can_drop_briefly(stage: FaultTargets) -> None:
    stage.can.reset()


async def _can_silent(stage: FaultTargets) -> None:
    stage.can.mute()


async def _bus_off(stage: FaultTargets) -> None:
    stage.can.say(b"< error 20000040 1.000000 >")
    stage.can.mute()


async def _error_frames(stage: FaultTargets) -> None:
    """Insert error frames among good ones: a disturbed bus that still works."""
    for _ in range(stage.generator.randint(3, 12)):
        stage.can.say(f"< error 200000{stage.generator.choice(('04', '08', '80'))} 1.000000 >".encode())
        await asyncio.sleep(stage.generator.uniform(0.0, 0.1))


async def _reboot(stage: FaultTargets) -> None:
    await stage.reboot(round(stage.generator.choice((0.0, stage.generator.uniform(0.05, 3.0))), 3))


async def _disk_full(stage: FaultTargets) -> None:
    stage.fill_disk()


def _sent(number: signal.Signals) -> Act:
    async def act(stage: FaultTargets) -> None:
        os.kill(stage.pid, number)

    return act


async def _calibrator_crash(stage: FaultTargets) -> None:
    stage.kill_child("multiprocessing.spawn")


async def _viewer_killed(stage: FaultTargets) -> None:
    stage.kill_child("hil.review")


_TC = 'kind = "sensor"\nwhere = "{channel}"\n'
_ACTUATOR = 'kind = "actuator"\nwhere = "{}"\ngain = 0.0\n'
KINDS: dict[str, FaultKind] = {
    "link drop": FaultKind("Modbus connection reset, port closed", "stops", _drop, wire="plc"),
    "link drop, brief": FaultKind("the same for 0.05 to 0.3 s", "rides", _drop_briefly, wire="plc"),
    "half-open link": FaultKind("Modbus connections stay open, nothing passes", "stops", _half_open, wire="plc"),
    "late replies": FaultKind(
        "every reply 0.4 to 2 s late",
        "stops",
        _lasting(lambda g: replies.late(g, 1.0, 0.4, 2.0)),
        wire="plc",
    ),
    "late replies, brief": FaultKind(
        "some replies 0.1 to 0.6 s late, for up to 0.5 s",
        "either",
        _brief(lambda g: replies.late(g, 0.3, 0.1, 0.6)),
        wire="plc",
    ),
    "garbled replies": FaultKind(
        "other bits in header, function or count of every reply",
        "stops",
        _lasting(lambda g: replies.garbled_header(g, 1.0)),
        wire="plc",
    ),
    "garbled replies, brief": FaultKind(
        "the same of every other reply for up to 0.5 s",
        "either",
        _brief(lambda g: replies.garbled_header(g, 0.5)),
        wire="plc",
    ),
    "garbled over TLS": FaultKind(
        "other bits anywhere in every TLS record",
        "stops",
        _lasting(lambda g: replies.garbled_anywhere(g, 1.0)),
        place="tls",
        wire="plc",
    ),
    "garbled over TLS, brief": FaultKind(
        "the same of a third of them for up to 0.5 s",
        "either",
        _brief(lambda g: replies.garbled_anywhere(g, 0.34)),
        place="tls",
        wire="plc",
    ),
    "cut-off replies": FaultKind(
        "the end of every reply is missing",
        "stops",
        _lasting(lambda g: replies.cut_off(g, 1.0)),
        wire="plc",
    ),
    "too few registers": FaultKind(
        "well-formed replies with too few registers",
        "stops",
        _lasting(lambda g: replies.too_few_registers(g, 1.0)),
        wire="plc",
    ),
    "wrong function": FaultKind(
        "replies to another function",
        "stops",
        _lasting(lambda g: replies.wrong_function(g, 1.0)),
        wire="plc",
    ),
    "replies in pieces": FaultKind(
        "single bytes: no fault, to be put together",
        "rides",
        _brief(lambda g: replies.split_up(g, 1.0)),
        wire="plc",
    ),
    "server restart": FaultKind("Modbus port gone for 0.3 to 4 s", "either", _server_restart, wire="plc"),
    "CAN link drop": FaultKind("connection to the CAN daemon reset, port closed", "stops", _can_drop, wire="can"),
    "CAN link drop, brief": FaultKind(
        "connection to the CAN daemon reset once",
        "either",
        _can_drop_briefly,
        wire="can",
    ),
    "CAN silent": FaultKind("no frames any more, connection open", "stops", _can_silent, wire="can"),
    "CAN bus-off": FaultKind("error frame of bus-off, then silence", "stops", _bus_off, wire="can"),
    "CAN error frames": FaultKind("error frames among good ones", "rides", _error_frames, wire="can"),
    "CAN text garbled": FaultKind(
        "characters missing in a third of the daemon's lines, for up to 0.5 s",
        "either",
        _brief(lambda g: replies.without_a_digit(g, 0.34), "can"),
        wire="can",
    ),
    "thermocouple stuck": FaultKind("repeats its last value", "stops", effect=_TC + "stuck = true\n"),
    "thermocouple open": FaultKind("reads the code of an open circuit", "stops", effect=_TC + "open_circuit = true\n"),
    "thermocouple jumps": FaultKind(
        "loose contact: 8 to 30 K up or down, there and back",
        "stops",
        effect=_TC + "jump_K = {jump}\nperiod_s = {period}\nduty = 0.9\n",
    ),
    "pump stop": FaultKind("pump stands still whatever it is told", "stops", effect=_ACTUATOR.format("pump_speed")),
    "fan stop": FaultKind("fans stand still whatever they are told", "stops", effect=_ACTUATOR.format("fan_speed")),
    "rig reboot": FaultKind("PLC loses its memory, gone for 0 to 3 s", "stops", _reboot),
    "calibrator crash": FaultKind("kill -9 of the calibrators' process", "rides", _calibrator_crash, place="twin"),
    "viewer killed": FaultKind("kill -9 of the process that feeds Rerun", "rides", _viewer_killed, place="viewer"),
    "disk full": FaultKind("no byte can be written any more", "stops", _disk_full, place="tmpfs"),
    "SIGTERM": FaultKind("at any instant from the start of the command on", "stops", _sent(signal.SIGTERM), early=True),
    "SIGINT": FaultKind("the same", "stops", _sent(signal.SIGINT), early=True),
    "SIGKILL": FaultKind("the same", "killed", _sent(signal.SIGKILL), early=True),
    "loop hangs": FaultKind("SIGSTOP: process there, loop not", "killed", _sent(signal.SIGSTOP)),
}


def effect_text(kind: FaultKind, generator: random.Random, channels: tuple[str, ...], onset_s: float) -> str:
    """Return the effects file of a fault of the rig itself, from `onset_s` of rig time on, for `MENDED_AFTER_S`."""
    values = {
        "channel": generator.choice(channels),
        "jump": f"{generator.choice((-1, 1)) * generator.uniform(8.0, 30.0):.2f}",
        "period": f"{generator.uniform(0.6, 3.0):.2f}",
    }
    return (
        f"[[effect]]\n{kind.effect.format(**values)}onset_s = {onset_s:.1f}\nend_s = {onset_s + MENDED_AFTER_S:.1f}\n"
    )
