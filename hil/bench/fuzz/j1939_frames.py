"""Mutated frames of a J1939 message, which is identified by its PGN: senders, priorities, data pages, lengths and data.

Wrong is a value that is good and not what the bytes of a frame of this PGN say, or beyond its range, or of a message
that two send at the time.
"""

from __future__ import annotations

import math
import random
import struct
import tempfile
from pathlib import Path

import can

from drivers.can import CanReceiver
from drivers.rig_file import CanBus, Point
from drivers.signals import Quality

PGN, HEARD, OTHER = 0xFEEE, 0x00, 0x21
KINDS = (
    "none",
    "another priority",
    "any data",
    "another source",
    "two sources",
    "another PGN",
    "data page",
    "standard identifier",
    "remote",
    "error",
    "shorter",
    "DLC lies",
    "no value",
    "no data",
)
HARMLESS = ("none", "another priority")
DBC = """VERSION ""

NS_ :

BS_:

BU_: ECU

BO_ 2566844158 ET1: 8 ECU
 SG_ T_a : 0|16@1+ (0.03125,-273) [-273|1735] "degC" ECU
 SG_ T_b : 16|16@1+ (0.03125,-273) [0|0] "degC" ECU
 SG_ T_c : 32|8@1+ (1,-40) [0|0] "degC" ECU

BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "ExtendedCAN";
BA_ "VFrameFormat" BO_ 2566844158 3;
"""
_APART_S = 1000.0


def _frames(kind: str, pick: random.Random) -> list[can.Message]:
    def frame(data: bytes, source: int = HEARD, priority: int = 6, pgn: int = PGN, **told: bool) -> can.Message:
        return can.Message(arbitration_id=priority << 26 | pgn << 8 | source, data=data, **told)

    data = struct.pack("<HHB3x", pick.randrange(0xFB00), pick.randrange(0xFB00), pick.randrange(0xFB))
    if kind == "another priority":
        return [frame(data, priority=pick.randrange(8))]
    if kind == "any data":
        return [frame(pick.randbytes(8))]
    if kind == "another source":
        return [frame(data, source=OTHER)]
    if kind == "two sources":
        both = [frame(data), frame(bytes(reversed(data)), source=OTHER)]
        return both if pick.random() < 0.5 else both[::-1]
    if kind == "another PGN":
        return [frame(data, pgn=PGN ^ 1 << pick.randrange(16))]
    if kind == "data page":
        return [frame(data, pgn=PGN | pick.randrange(1, 4) << 16)]
    if kind == "standard identifier":
        return [can.Message(arbitration_id=PGN & 0x7FF, data=data, is_extended_id=False)]
    if kind == "remote":
        return [can.Message(arbitration_id=6 << 26 | PGN << 8, is_remote_frame=True, dlc=8)]
    if kind == "error":
        return [frame(data, is_error_frame=True)]
    if kind == "shorter":
        return [frame(data[: pick.randrange(1, 8)])]
    if kind == "DLC lies":
        return [can.Message(arbitration_id=6 << 26 | PGN << 8, data=data[: pick.randrange(8)], dlc=8)]
    if kind == "no value":
        high = [pick.randrange(0xFB00, 0x10000) for _ in range(2)]
        return [frame(struct.pack("<HHB3x", *high, pick.randrange(0xFB, 0x100)))]
    return [frame(b"" if kind == "no data" else data)]


def _allowed(frames: list[can.Message]) -> list[float]:
    """Return the allowed readings of the three signals; nothing for a code of the PGN that is no number, or for two
    senders.
    """
    if len(frames) > 1:
        return [math.nan] * 3
    (frame,) = frames
    odd = not frame.is_extended_id or frame.is_remote_frame or frame.is_error_frame or len(frame.data) != 8
    if odd or frame.arbitration_id & 0x03FFFFFF != PGN << 8 | HEARD:
        return [math.nan] * 3
    *words, byte = struct.unpack_from("<HHB", bytes(frame.data))
    values = [word * 0.03125 - 273.0 if word < 0xFB00 else math.nan for word in words]
    return [*values, byte - 40.0 if byte < 0xFB else math.nan]


async def mutate_j1939(count: int, seed: int) -> dict[str, tuple[int, int, int, int]]:
    """Return by kind of mutation: frames, good values, values that were not good, and wrong ones."""
    pick = random.Random(seed)
    points = tuple(Point(name=n, bus="c", unit="degC", message="ET1", signal=n) for n in ("T_a", "T_b", "T_c"))
    now = [0.0]
    with tempfile.TemporaryDirectory() as folder:
        dbc = Path(folder) / "j1939.dbc"
        dbc.write_text(DBC, encoding="utf-8")
        bus = CanReceiver("c", CanBus(transport="virtual", dbc=dbc), points, lambda: now[0])
    found = {kind: [0, 0, 0, 0] for kind in KINDS}
    bus._take(_frames("none", pick)[0])  # The first sender that is received is the one that is read.
    for number in range(count):
        kind = KINDS[number % len(KINDS)]
        frames = _frames(kind, pick)
        now[0] += _APART_S
        for frame in frames:
            bus._take(frame)
        readings = await bus.read()
        tally = found[kind]
        tally[0] += 1
        for value, quality, right in zip(readings.values, readings.quality, _allowed(frames), strict=True):
            if quality == Quality.GOOD:
                tally[1] += 1
                tally[3] += not math.isclose(value, right, abs_tol=1e-9)
            else:
                tally[2] += 1
    return {kind: (t[0], t[1], t[2], t[3]) for kind, t in found.items()}
