"""DBC files through cantools: the one module that imports it. What a file describes, and what points want of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cantools.database

from drivers.points import ConfigurationError
from drivers.rig_model import Point
from drivers.units import canonical_unit


@dataclass(frozen=True, slots=True)
class DbcSignal:
    """One signal as a DBC file describes it; `minimum` and `maximum` in `unit`, `cycle_s` in s."""

    message: str
    frame_id: int
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
    """A signal that a point wants, and the range that the DBC gives it, widened by half a step of its scale."""

    name: str
    minimum: float
    maximum: float

    def admits(self, value: float) -> bool:
        """Whether the DBC admits `value`: cantools decodes whatever the bits say."""
        return self.minimum <= value <= self.maximum


@dataclass(frozen=True, slots=True)
class Bound:
    """A message and what points want of it: index of the point with each signal. `length` in bytes, `cycle_s` in s."""

    name: str
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


def bind(path: Path, encoding: str, points: Sequence[Point]) -> dict[tuple[int, bool], Bound]:
    """Messages by identifier and whether it is an extended one; raises ConfigurationError where a point has none."""
    database = _load_dbc(path, encoding)
    bound: dict[tuple[int, bool], Bound] = {}
    for index, point in enumerate(points):
        try:
            message = database.get_message_by_name(point.message)
        except KeyError:
            names = ", ".join(m.name for m in database.messages)
            raise ConfigurationError(
                f"{path}: no message {point.message!r} for point {point.name}; there is {names}"
            ) from None
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
        cycle_s = message.cycle_time / 1000.0 if message.cycle_time else None
        entry = bound.setdefault(
            (message.frame_id, message.is_extended_frame), Bound(message.name, message.length, cycle_s, message, [])
        )
        half = abs(float(signal.scale)) / 2
        low = -math.inf if signal.minimum is None else float(signal.minimum) - half
        high = math.inf if signal.maximum is None else float(signal.maximum) + half
        entry.wanted.append((index, Wanted(signal.name, low, high)))
    return bound
