"""Mutated CAN frames against the receiver: identifiers, kinds, lengths and data that a module should not send.

What a frame's eight bytes say is a value, right or wrong: the controller's checksum guards them. So a value is wrong
here that is good and not what the bytes of a frame of this very message say, read with `struct`, or not in its range.
"""

from __future__ import annotations

import math
import random
import struct
from pathlib import Path
from typing import Any

import can

from drivers.can import CanReceiver
from drivers.rig_file import CanBus, load_rig
from drivers.signals import Quality

RIG = Path(__file__).resolve().parents[3] / "profiles" / "rigs" / "virtual.toml"
LAYOUT = {0x181: "<4h", 0x281: "<4h", 0x381: "<hHI"}
SCALES = {0x381: (0.01, 1.0, 0.001)}
RANGES = {0x381: ((-40.0, 150.0), (0.0, 511.0), (0.0, 4294967.295))}
KINDS = (
    "none",
    "any data",
    "another identifier",
    "extended identifier",
    "remote",
    "error",
    "shorter",
    "longer",
    "DLC lies",
    "CAN FD",
    "no data",
)
_APART_S = 1000.0


def _mutated(kind: str, pick: random.Random, identifier: int) -> can.Message:
    raws = [pick.randint(-3000, 14000) for _ in range(4)]
    data = struct.pack("<4h", *raws)
    if identifier == 0x381:
        data = struct.pack("<hHI", raws[0], pick.randrange(512), pick.randrange(2**31))
    told: dict[str, Any] = {"is_extended_id": False, "arbitration_id": identifier}
    if kind == "any data":
        data = pick.randbytes(8)
    elif kind == "another identifier":
        while told["arbitration_id"] in LAYOUT:
            told["arbitration_id"] = identifier ^ (1 << pick.randrange(11))
    elif kind == "extended identifier":
        told["is_extended_id"] = True
    elif kind == "remote":
        return can.Message(is_remote_frame=True, dlc=pick.randrange(9), **told)
    elif kind == "error":
        told["arbitration_id"] = pick.choice((identifier, pick.randrange(2**11)))
        return can.Message(is_error_frame=True, dlc=8, data=data, **told)
    elif kind == "shorter":
        data = data[: pick.randrange(1, 8)]
    elif kind == "longer":
        return can.Message(data=data + pick.randbytes(4), dlc=12, is_fd=True, **told)
    elif kind == "DLC lies":
        return can.Message(data=data[: pick.randrange(8)], dlc=8, **told)
    elif kind == "CAN FD":
        return can.Message(data=data + pick.randbytes(pick.choice((4, 8, 12))), dlc=8, is_fd=True, **told)
    elif kind == "no data":
        data = b""
    return can.Message(data=data, **told)


async def mutate_can(count: int, seed: int) -> dict[str, tuple[int, int, int, int]]:
    """Return by kind of mutation: frames, good values, values of a frame that were not good, and wrong ones."""
    pick = random.Random(seed)
    points = tuple(
        point.model_copy(update={"bus": "c", "max_change_per_s": None, "stuck_after_s": None, "plausible": None})
        for point in load_rig(RIG).point
        if point.bus == "thermocouples"
    )
    config = load_rig(RIG).bus["thermocouples"]
    assert isinstance(config, CanBus)
    now = [0.0]
    bus = CanReceiver("c", config, points, lambda: now[0])
    found = {kind: [0, 0, 0, 0] for kind in KINDS}
    for number in range(count):
        kind = KINDS[number % len(KINDS)]
        identifier = pick.choice(tuple(LAYOUT))
        frame = _mutated(kind, pick, identifier)
        now[0] += _APART_S  # Everything before is stale, so that a good value is this frame's.
        bus._take(frame)
        readings = await bus.read()
        tally = found[kind]
        tally[0] += 1
        allowed = _allowed(frame)
        for point, value, quality in zip(points, readings.values, readings.quality, strict=True):
            if quality == Quality.GOOD:
                tally[1] += 1
                rights = allowed.get(point.message, ())
                tally[3] += not any(math.isclose(value, right, abs_tol=1e-9) for right in rights)
            elif point.message in allowed:
                tally[2] += 1
    return {kind: (t[0], t[1], t[2], t[3]) for kind, t in found.items()}


def _allowed(frame: can.Message) -> dict[str | None, list[float]]:
    """Return the allowed readings of this frame's points; nothing if the frame is unusable."""
    layout = LAYOUT.get(frame.arbitration_id)
    odd = frame.is_extended_id or frame.is_remote_frame or frame.is_error_frame
    if layout is None or odd or len(frame.data) != 8 or frame.dlc != 8:
        return {}
    scales = SCALES.get(frame.arbitration_id, (0.01,) * 4)
    ranges = RANGES.get(frame.arbitration_id, ((-40.0, 150.0),) * 4)
    name = {0x181: "TC_A", 0x281: "TC_B", 0x381: "TC_C"}[frame.arbitration_id]
    values = [raw * scale for raw, scale in zip(struct.unpack(layout, bytes(frame.data)), scales, strict=True)]
    return {name: [v for v, (low, high) in zip(values, ranges, strict=True) if low - 1e-9 <= v <= high + 1e-9]}
