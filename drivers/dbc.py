"""DBC files through cantools: the one module that imports it. What a file describes, and what points want of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cantools.database

from drivers.bus_sections import CanBus
from drivers.can_ids import IdMatch, by_id, by_j1939, pgn_of
from drivers.points import ConfigurationError
from drivers.rig_model import Point
from drivers.units import canonical_unit

_LONGEST = 8
"""Bytes of a frame of classical CAN."""


@dataclass(frozen=True, slots=True)
class DbcSignal:
    """One signal as a DBC file describes it; `minimum` and `maximum` in `unit`, `cycle_s` in s.

    `match` are the frames of its message.
    """

    message: str
    frame_id: int
    match: IdMatch
    name: str
    unit: str
    minimum: float | None
    maximum: float | None
    choices: dict[int, str] | None
    cycle_s: float | None
    multiplexed: bool
    comment: str


@dataclass(frozen=True, slots=True)
class Wanted:
    """A signal that a point wants, and the range that the DBC gives it, widened by half a step of its scale.

    From `missing_from` to `missing_to` it says that the device has no value; NaN where no value says so.
    """

    name: str
    minimum: float
    maximum: float
    missing_from: float = math.nan
    missing_to: float = math.nan

    def admits(self, value: float) -> bool:
        """Whether the DBC admits `value`: cantools decodes whatever the bits say."""
        return self.minimum <= value <= self.maximum

    def is_missing(self, value: float) -> bool:
        """Whether `value` is a device's word for none."""
        return self.missing_from <= value <= self.missing_to


@dataclass(frozen=True, slots=True)
class Bound:
    """A message and what points want of it: index of the point with each signal. `length` in bytes, `cycle_s` in s.

    `name` is what the rig file calls it, `match` the frames that are this message.
    """

    name: str
    match: IdMatch
    length: int
    cycle_s: float | None
    message: Any
    wanted: list[tuple[int, Wanted]]

    def decode(self, data: bytes) -> dict[str, float] | None:
        """Values by signal, of those that are in this frame; None where it cannot be decoded."""
        try:
            found = self.message.decode(data, decode_choices=False, scaling=True)
            return {name: float(value) for name, value in found.items()}
        except Exception:  # cantools raises DecodeError, but bad DBCs leak others; a frame is then not used
            return None


def _load_dbc(path: Path, encoding: str) -> Any:
    try:
        return cantools.database.load_file(path, encoding=encoding)
    except FileNotFoundError:
        raise ConfigurationError(f"{path}: there is no such DBC file; correct the path") from None
    except UnicodeDecodeError as error:
        raise ConfigurationError(
            f"{path}: is not {encoding} text ({error.reason}); give its encoding, cp1252 for most older files"
        ) from None
    except Exception as error:  # cantools raises parse errors of several unrelated types
        raise ConfigurationError(f"{path}: is not a DBC file that can be used ({error})") from error


def describe_dbc(path: Path, encoding: str = "utf-8") -> list[DbcSignal]:
    """Every signal of a DBC file, in the order of the file; raises ConfigurationError."""
    found: list[DbcSignal] = []
    for message in _load_dbc(path, encoding).messages:
        for signal in message.signals:
            choices = {int(key): str(text) for key, text in (signal.choices or {}).items()}
            found.append(
                DbcSignal(
                    message.name,
                    message.frame_id,
                    _match_of(message),
                    signal.name,
                    signal.unit or "",
                    signal.minimum,
                    signal.maximum,
                    choices or None,
                    message.cycle_time / 1000.0 if message.cycle_time else None,
                    bool(signal.multiplexer_ids),
                    signal.comment or "",
                )
            )
    return found


def bind(name: str, bus: CanBus, points: Sequence[Point]) -> list[Bound]:
    """Messages that points of bus `name` want, each with its frames; raises ConfigurationError.

    A point without its message or signal in the DBC is a mistake, and so are two messages that a frame could both be.
    """
    path = bus.dbc
    database = _load_dbc(path, bus.dbc_encoding)
    entries = {entry.name: entry for entry in bus.message}
    bound: dict[str, Bound] = {}
    for index, point in enumerate(points):
        called = str(point.message)
        entry = entries.get(called)
        message = _message(path, database, called if entry is None else entry.dbc_message or called, point.name)
        signal = next((s for s in message.signals if s.name == point.signal), None)
        if signal is None:
            names = ", ".join(s.name for s in message.signals)
            raise ConfigurationError(
                f"{path}: message {message.name} has no signal {point.signal!r} for {point.name}; it has {names}"
            )
        if signal.unit and canonical_unit(signal.unit) != point.unit:
            raise ConfigurationError(
                f"{path}: signal {signal.name} is in {signal.unit}, point {point.name} in {point.unit}; correct one"
            )
        if called not in bound:
            match = _match_of(message) if entry is None else entry.match
            if match.pgn is not None and _is_j1939(message) and pgn_of(message.frame_id) != match.pgn:
                raise ConfigurationError(
                    f"{path}: message {message.name} has PGN 0x{pgn_of(message.frame_id):04X} and the rig file gives "
                    f"{called} 0x{match.pgn:04X}; correct one"
                )
            cycle_s = message.cycle_time / 1000.0 if message.cycle_time else None
            bound[called] = Bound(called, match, message.length, cycle_s, message, [])
        bound[called].wanted.append((index, _wanted(signal, bound[called].match.pgn is not None)))
    _refuse_overlaps(name, bus.dbc, database, list(bound.values()))
    return list(bound.values())


def _message(path: Path, database: Any, name: str, point: str) -> Any:
    try:
        message = database.get_message_by_name(name)
    except KeyError:
        names = ", ".join(m.name for m in database.messages)
        raise ConfigurationError(f"{path}: no message {name!r} for point {point}; there is {names}") from None
    if message.length > _LONGEST:
        raise ConfigurationError(
            f"{path}: message {name} of point {point} has {message.length} bytes and a frame carries {_LONGEST}: "
            "CAN FD and the several packets of J1939's transport protocol are not read here; leave the point out"
        )
    return message


def _is_j1939(message: Any) -> bool:
    return bool(message.is_extended_frame and message.protocol == "j1939")


def _match_of(message: Any) -> IdMatch:
    """Frames of a message as the DBC has it."""
    if _is_j1939(message):
        return by_j1939(message.frame_id)
    return by_id(message.frame_id, message.is_extended_frame)


def _wanted(signal: Any, is_j1939: bool) -> Wanted:
    scale, offset = float(signal.scale), float(signal.offset)
    half = abs(scale) / 2
    low = -math.inf if signal.minimum is None else float(signal.minimum) - half
    high = math.inf if signal.maximum is None else float(signal.maximum) + half
    first = _first_indicator(signal) if is_j1939 else None
    if first is None:
        return Wanted(signal.name, low, high)
    ends = first * scale + offset, ((1 << signal.length) - 1) * scale + offset
    return Wanted(signal.name, low, high, min(ends) - half, max(ends) + half)


def _first_indicator(signal: Any) -> int | None:
    """The first raw number that says "error" or "not available", as do all above it (SAE J1939-71, 5.1.4).

    States of less than a byte that the DBC names are states.
    """
    length = signal.length
    if signal.is_signed or signal.is_float or length == 1:
        return None
    if length < 8:
        first = (1 << length) - (2 if length in (2, 4) else 1)
        return None if signal.choices and max(signal.choices) >= first else first
    return int(0xFB << (length - 8))


def _refuse_overlaps(bus: str, path: Path, database: Any, bound: Sequence[Bound]) -> None:
    """Raise ConfigurationError where a frame could be of two messages: of two that are wanted, or of another's id."""
    for number, one in enumerate(bound):
        for other in bound[number + 1 :]:
            if one.match.overlaps(other.match):
                raise _overlap(bus, path, one, other.name, other.match)
    read = {one.message.name for one in bound}
    for message in database.messages:
        for one in bound:
            if message.name not in read and one.match.matches(message.frame_id, message.is_extended_frame):
                raise _overlap(bus, path, one, message.name, _match_of(message))


def _overlap(bus: str, path: Path, one: Bound, name: str, match: IdMatch) -> ConfigurationError:
    return ConfigurationError(
        f"{path}: a frame could be both {one.name} ({one.match}) and {name} ({match}); say which frames are which in "
        f"the rig file, with a narrower mask or a source, in a [[bus.{bus}.message]]"
    )
