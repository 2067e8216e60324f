"""Replies of faulty devices and gateways: changes of one frame at a time, drawn from a generator.

Each is a `Change` of `drivers.virtual.faults.faulty_link`. A `share` of the frames is changed, the others pass.
"""

from __future__ import annotations

import random
import struct
from collections.abc import Callable, Sequence

from drivers.virtual.devices import crc
from drivers.virtual.faults.faulty_link import Change

Pieces = Sequence[tuple[float, bytes]]
_HEADER = 9
"""MBAP header, function code and byte count, which a Modbus/TCP client can check (Messaging guide V1.0b, 3.1.3)."""


def late(generator: random.Random, share: float, least_s: float, most_s: float) -> Change:
    """Delay the reply by `least_s` to `most_s`."""
    return _some(generator, share, lambda frame: [(generator.uniform(least_s, most_s), frame)])


def garbled_header(generator: random.Random, share: float) -> Change:
    """Change bits in one to three bytes of header, function code or byte count."""
    return _some(generator, share, lambda frame: [(0.0, flipped(frame, generator, min(_HEADER, len(frame))))])


def garbled_anywhere(generator: random.Random, share: float) -> Change:
    """Change bits in one to three bytes: beneath TLS, where every byte is authenticated, or in a CAN daemon's text."""
    return _some(generator, share, lambda frame: [(0.0, flipped(frame, generator, len(frame)))])


def cut_off(generator: random.Random, share: float) -> Change:
    """Cut the frame's end off, as a gateway with a full buffer does: the header announces more."""
    return _some(generator, share, lambda frame: [(0.0, frame[: generator.randrange(1, max(len(frame), 2))])])


def too_few_registers(generator: random.Random, share: float) -> Change:
    """Send a well-formed reply to a read, with fewer registers than were requested."""

    def change(frame: bytes) -> Pieces:
        if len(frame) < 11 or frame[7] not in (3, 4, 23):
            return [(0.0, frame)]
        keep = 2 * generator.randrange(0, (len(frame) - 9) // 2)
        pdu = bytes((frame[7], keep)) + frame[9 : 9 + keep]
        return [(0.0, frame[:4] + struct.pack(">H", len(pdu) + 1) + frame[6:7] + pdu)]

    return _some(generator, share, change)


def wrong_function(generator: random.Random, share: float) -> Change:
    """Send the reply to another function: FC 3 for FC 4 and the other way round, FC 6 for FC 16, FC 3 for FC 23."""
    other = {3: 4, 4: 3, 6: 16, 16: 6, 23: 3}
    return _some(
        generator, share, lambda frame: [(0.0, frame[:7] + bytes((other.get(frame[7], frame[7]),)) + frame[8:])]
    )


def split_up(generator: random.Random, share: float) -> Change:
    """Send the frame in single bytes, which is no fault: a client must put it together."""
    return _some(generator, share, lambda frame: [(0.0, frame[k : k + 1]) for k in range(len(frame))])


def without_a_digit(generator: random.Random, share: float) -> Change:
    """Leave some characters of a CAN daemon's line out."""

    def change(frame: bytes) -> Pieces:
        at = generator.randrange(2, max(len(frame) - 2, 3))
        return [(0.0, frame[:at] + frame[at + generator.choice((1, 3)) :])]

    return _some(generator, share, change)


def flipped(frame: bytes, generator: random.Random, within: int) -> bytes:
    """Return `frame` with one to three of its first `within` bytes changed."""
    changed = bytearray(frame)
    for _ in range(generator.randint(1, 3)):
        changed[generator.randrange(within)] ^= generator.randint(1, 255)
    if bytes(changed) == frame:
        changed[0] ^= 0xFF
    return bytes(changed)


def swallowed(generator: random.Random, share: float) -> Change:
    """Send no reply."""
    return _some(generator, share, lambda frame: [])


def twice(generator: random.Random, share: float) -> Change:
    """Send the reply twice."""
    return _some(generator, share, lambda frame: [(0.0, frame), (0.0, frame)])


def one_behind(generator: random.Random, share: float) -> Change:
    """Send the previous reply before this one, as a gateway with a queue does."""
    before: list[bytes] = []

    def change(frame: bytes) -> Pieces:
        pieces = [(0.0, old) for old in before] + [(0.0, frame)]
        before[:] = [frame]
        return pieces

    return _some(generator, share, change)


def refusal(generator: random.Random, share: float, code: int) -> Change:
    """Send exception `code` in place of the reply."""
    return _some(
        generator, share, lambda frame: [(0.0, frame[:4] + b"\0\3" + frame[6:7] + bytes((frame[7] | 0x80, code)))]
    )


def in_rtu(change: Change) -> Change:
    """Return a change of Modbus/TCP frames as one of RTU frames: the CRC is right again afterwards."""

    def changed(frame: bytes) -> Pieces:
        wrapped = b"\0\0\0\0" + struct.pack(">H", len(frame) - 2) + frame[:-2]
        return [(delay_s, piece[6:] + crc(piece[6:])) for delay_s, piece in change(wrapped)]

    return changed


def _some(generator: random.Random, share: float, change: Callable[[bytes], Pieces]) -> Change:
    return lambda frame: change(frame) if generator.random() < share else [(0.0, frame)]
