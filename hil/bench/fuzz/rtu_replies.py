"""Mutated RTU replies against the reader of a serial line, in memory.

An RTU frame has a checksum, so its values are mutated, too: up to three bits, or a burst of sixteen, which CRC-16 is
bound to find; of changes beyond that it misses one in 65,536, whoever looks. A late reply of the same device, function
and length is no matter of one frame: `modbus.protocol.reply_offset` is for that, and the contract suite tests it.
"""

from __future__ import annotations

import random
import struct

from drivers.modbus.protocol import RtuGuard, rtu_frame
from drivers.signals import ProtocolError

DEVICE, COUNT = 3, 12
KINDS = (
    "none",
    "in segments",
    "noise of a turning line before",
    "one to three bits",
    "a burst of bits",
    "device",
    "function",
    "byte count",
    "truncated",
    "trailing bytes",
    "twice",
    "the reply of another length before",
    "noise",
)
HARMLESS = ("none", "in segments", "noise of a turning line before", "the reply of another length before")


def mutate_rtu(count: int, seed: int) -> dict[str, tuple[int, int, int, int]]:
    """Return by kind of mutation: replies, used ones, unused ones, and wrong ones that were used."""
    pick = random.Random(seed)
    found = {kind: [0, 0, 0, 0] for kind in KINDS}
    request = struct.pack(">BHH", 4, 0, COUNT)
    for number in range(count):
        kind = KINDS[number % len(KINDS)]
        pdu = struct.pack(f">BB{COUNT}H", 4, 2 * COUNT, *(pick.randrange(65536) for _ in range(COUNT)))
        guard, used = RtuGuard(), []
        try:
            for segment in _mutated(kind, pick, pdu):
                used += guard.feed(segment, DEVICE, request)
        except ProtocolError:
            used = []
        tally = found[kind]
        tally[0] += 1
        tally[1 if used else 2] += 1
        tally[3] += any(reply[:1] == b"\4" and reply != pdu for reply in used)
    return {kind: (t[0], t[1], t[2], t[3]) for kind, t in found.items()}


def _mutated(kind: str, pick: random.Random, pdu: bytes) -> list[bytes]:
    good = rtu_frame(DEVICE, pdu)
    frame = int.from_bytes(good, "big")
    bits = 8 * len(good)
    if kind == "in segments":
        at = sorted(pick.sample(range(1, len(good)), 3))
        return [good[a:b] for a, b in zip([0, *at], [*at, len(good)], strict=True)]
    if kind == "noise of a turning line before":
        return [pick.choice((b"\0", b"\xff", b"\0\0\xff")) + good]
    if kind == "one to three bits":
        for bit in pick.sample(range(bits), pick.randint(1, 3)):
            frame ^= 1 << bit
        return [frame.to_bytes(len(good), "big")]
    if kind == "a burst of bits":
        frame ^= pick.randrange(1, 2**16) << pick.randrange(bits - 16)
        return [frame.to_bytes(len(good), "big")]
    if kind == "device":
        return [rtu_frame(pick.choice([d for d in range(1, 248) if d != DEVICE]), pdu)]
    if kind == "function":
        return [rtu_frame(DEVICE, bytes((pick.choice([f for f in range(1, 128) if f != 4]),)) + pdu[1:])]
    if kind == "byte count":
        return [rtu_frame(DEVICE, pdu[:1] + bytes((pick.choice([n for n in range(256) if n != pdu[1]]),)) + pdu[2:])]
    if kind == "truncated":
        return [good[: pick.randrange(len(good))]]
    if kind == "trailing bytes":
        return [good + pick.randbytes(pick.randint(1, 9))]
    if kind == "twice":
        return [good + good]
    if kind == "the reply of another length before":
        other = pick.choice([n for n in range(1, 40) if n != COUNT])
        return [rtu_frame(DEVICE, struct.pack(f">BB{other}H", 4, 2 * other, *(666 for _ in range(other)))) + good]
    return [pick.randbytes(pick.randint(1, 60))] if kind == "noise" else [good]
