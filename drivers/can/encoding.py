"""Frames that carry given values, encoded by a DBC file: the reverse of the receiver, for rigs that are simulated.

Bits are packed here and not by cantools, which refuses messages of which only some signals are described well.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from drivers.can.dbc import Bound, Wanted, bind
from drivers.rig_file import CanBus, IdMatch, Point

_PRIORITY = 6 << 26
"""Default priority of J1939 (SAE J1939-21, 5.2.1)."""
_EVERYONE = 0xFF
_NO_SOURCE = 0xFE


@dataclass(frozen=True, slots=True)
class EncodedFrame:
    """Frame with its identifier (29 bits where `extended`) and its data."""

    identifier: int
    extended: bool
    data: bytes


@dataclass(frozen=True, slots=True)
class _Place:
    """Signal of a point: its layout, the range of what it may say, and the multiplexors that it needs."""

    point: Point
    signal: Any
    wanted: Wanted
    selection: dict[str, int]


class FrameEncoder:
    """Encoder of the messages that points of a CAN bus are read from.

    Parameters
    ----------
    name, bus
        Section of the rig file.
    points
        Points of the bus.

    Raises
    ------
    ConfigurationError
        The DBC file cannot be used, or lacks a message or signal.
    """

    def __init__(self, name: str, bus: CanBus, points: Sequence[Point]) -> None:
        self._clock = bus.uptime
        self._messages: list[tuple[Bound, list[_Place]]] = []
        self._places: dict[str, _Place] = {}
        for bound in bind(name, bus, points):
            by_name = {signal.name: signal for signal in bound.message.signals}
            places = [
                _Place(points[index], by_name[wanted.name], wanted, _selection(by_name, by_name[wanted.name]))
                for index, wanted in bound.wanted
            ]
            places.sort(key=lambda place: -place.signal.length)  # of signals that share bits, the narrow ones count
            self._messages.append((bound, places))
            self._places |= {place.point.name: place for place in places}

    @property
    def fastest_s(self) -> float:
        """Shortest cycle time of the messages by the DBC, s; infinity where none has one."""
        return min((bound.cycle_s for bound, _ in self._messages if bound.cycle_s), default=math.inf)

    def bounds(self, name: str) -> tuple[float, float]:
        """Return the least and the greatest value that point `name` can have, in its unit."""
        place = self._places[name]
        signal, wanted, point = place.signal, place.wanted, place.point
        ends = [raw * signal.scale + signal.offset for raw in _raw_bounds(signal)]
        half = abs(float(signal.scale)) / 2
        low, high = max(min(ends), wanted.minimum + half), min(max(ends), wanted.maximum - half)
        if low < wanted.missing_from <= high:
            high = wanted.missing_from - half
        both = [value * point.scale + point.offset for value in (low, high)]
        return min(both), max(both)

    def resolution(self, name: str) -> float:
        """Return the smallest step of point `name`, in its unit; 0 for a float."""
        place = self._places[name]
        return 0.0 if place.signal.is_float else abs(float(place.signal.scale) * place.point.scale)

    def frames(self, values: Mapping[str, float]) -> list[EncodedFrame]:
        """Return the frames that carry `values`, by point name and in the unit of each point.

        The frame with the bus's `uptime` comes last: whoever has received that time has received all values of it.
        """
        found: list[EncodedFrame] = []
        last: list[EncodedFrame] = []
        for bound, places in self._messages:
            identifier = _identifier(bound)
            selections: list[dict[str, int]] = []
            for place in places:
                if place.selection and place.selection not in selections:
                    selections.append(place.selection)
            for selection in selections or [{}]:
                number, has_clock = 0, False
                for place in places:
                    if place.selection.items() <= selection.items():
                        point = place.point
                        has_clock |= point.name == self._clock
                        physical = (values[point.name] - point.offset) / point.scale
                        number = _put(number, place.signal, _raw(place.signal, physical), bound.length)
                for name, chosen in selection.items():
                    multiplexor = next(s for s in bound.message.signals if s.name == name)
                    number = _put(number, multiplexor, chosen, bound.length)
                data = number.to_bytes(bound.length, "big")
                (last if has_clock else found).append(EncodedFrame(identifier, bound.match.extended, data))
        return found + last


def _selection(by_name: Mapping[str, Any], signal: Any) -> dict[str, int]:
    """Return the values of the multiplexors with which a frame has the signal, by multiplexor."""
    found: dict[str, int] = {}
    while signal.multiplexer_ids:
        found[signal.multiplexer_signal] = int(signal.multiplexer_ids[0])
        signal = by_name[signal.multiplexer_signal]
    return found


def _identifier(bound: Bound) -> int:
    """Return an identifier of the message: the DBC's, else one with default priority, to all, from address 0."""
    match: IdMatch = bound.match
    own = int(bound.message.frame_id)
    if match.matches(own, bool(bound.message.is_extended_frame)) and (match.pgn is None or own & 0xFF != _NO_SOURCE):
        return own
    if match.pgn is None:
        return match.value
    everyone = 0 if match.mask & 0xFF00 else _EVERYONE << 8
    return _PRIORITY | match.value | everyone


def _raw_bounds(signal: Any) -> tuple[float, float]:
    if signal.is_float:
        most = 3.4e38 if signal.length == 32 else 1.7e308
        return -most, most
    if signal.is_signed:
        return -float(1 << (signal.length - 1)), float((1 << (signal.length - 1)) - 1)
    return 0.0, float((1 << signal.length) - 1)


def _raw(signal: Any, physical: float) -> int:
    """Return the bits of a value, as an unsigned number; a value beyond the signal's range becomes its end."""
    value = (physical - float(signal.offset)) / float(signal.scale)
    if signal.is_float:
        kind = {16: "e", 32: "f", 64: "d"}[signal.length]
        return int.from_bytes(struct.pack(f">{kind}", value), "big")
    low, high = _raw_bounds(signal)
    whole = int(min(max(round(value), int(low)), int(high)))
    return whole & ((1 << signal.length) - 1)


def _put(number: int, signal: Any, raw: int, length: int) -> int:
    """Return a frame, as a big-endian number of `length` bytes, with the bits of a signal set."""
    for at in range(signal.length):
        position = _position(signal, at)
        shift = 8 * (length - 1 - position // 8) + position % 8
        number = number & ~(1 << shift) | (raw >> at & 1) << shift
    return number


def _position(signal: Any, at: int) -> int:
    """Return the place of bit `at` (0 the least significant) as a DBC counts: 8 times the byte, plus the bit in it."""
    if signal.byte_order == "little_endian":
        return int(signal.start) + at
    # A big-endian signal begins at its most significant bit and goes down, from one byte to the next.
    sequence = 8 * (int(signal.start) // 8) + 7 - int(signal.start) % 8 + signal.length - 1 - at
    return 8 * (sequence // 8) + 7 - sequence % 8
