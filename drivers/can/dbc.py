"""DBC files read by cantools: the signals that a file describes, and the messages that points are read from."""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drivers.can.dbc_layout import (
    is_whole,
    layout_faults,
    multiplexed_together,
    multiplexing_faults,
    part_of,
    shared_bits,
)
from drivers.can.dbc_text import DbcText, usable
from drivers.can.imports import without
from drivers.rig_file import MOST_DESCRIPTION, CanBus, IdMatch, Point, by_id, by_j1939, decoded, pgn_of, read_regular
from drivers.signals import ConfigurationError, canonical_unit, known_unit

with without("asammdf"):  # cantools imports python-can
    import cantools.database

logging.getLogger("cantools").addHandler(logging.NullHandler())  # Its warnings come as notes, with their line.
_LONGEST = 8
"""Bytes of a frame of classical CAN."""
_LONGEST_CYCLE_MS = 1e9
"""Longest cycle time that is taken as one, ms: a message that comes once in eleven days is not cyclic."""


@dataclass(frozen=True, slots=True)
class DbcSignal:
    """One signal as a DBC file describes it; `minimum` and `maximum` in `unit`, `cycle_s` in s.

    `match` are the frames of its message, `line` is its line in the file. Its value is raw x `scale` + `offset`, and
    `length` its bits.
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
    line: int = 1
    scale: float = 1.0
    offset: float = 0.0
    length: int = 8
    is_signed: bool = False
    is_float: bool = False


@dataclass(frozen=True, slots=True)
class Wanted:
    """Signal that a point reads, and its range in the DBC, widened by half a step of its scale: cantools decodes
    whatever the bits say.

    Values from `missing_from` to `missing_to` mean that the device has no value; NaN where no value means that.
    """

    name: str
    minimum: float
    maximum: float
    missing_from: float = math.nan
    missing_to: float = math.nan


@dataclass(frozen=True, slots=True)
class Bound:
    """Message and the signals that points read from it, each with its point's index. `length` in bytes, `cycle_s` in s.

    `name` is its name in the rig file, `match` the frames that are this message.
    """

    name: str
    match: IdMatch
    length: int
    cycle_s: float | None
    message: Any
    wanted: list[tuple[int, Wanted]]
    parts: list[Any] = field(default_factory=list)
    """Copies of the message, one for each set of signals that share no bit; empty where no signals share bits."""

    def decode(self, data: bytes) -> dict[str, float] | None:
        """Return the values of the signals that are in this frame, by name; None where it cannot be decoded."""
        found: dict[str, float] = {}
        decoded_any = False
        for part in self.parts or (self.message,):
            try:
                values = part.decode(data, decode_choices=False, scaling=True)
                found |= {name: float(value) for name, value in values.items()}
                decoded_any = True
            except Exception:  # cantools raises DecodeError, but bad DBCs leak others; the part is then not used
                continue
        return found if decoded_any else None


@dataclass(frozen=True, slots=True)
class DbcContents:
    """Signals of a DBC file and the encoding that it was read in.

    `left_out` has line and cause of each item that cannot be used, `notes` has line and text of notes on the others.
    """

    signals: list[DbcSignal]
    encoding: str
    left_out: list[tuple[int, str]]
    notes: list[tuple[int, str]]


def _load_dbc(path: Path, encoding: str | None) -> tuple[Any, DbcText, str]:
    """Return cantools' database of the lines that can be used; raise ConfigurationError."""
    try:
        text, found = decoded(read_regular(path, MOST_DESCRIPTION), encoding)
    except FileNotFoundError:
        raise ConfigurationError(f"{path}: there is no such DBC file; correct the path") from None
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read ({error.strerror or error}); correct the path") from None
    except ValueError as error:
        raise ConfigurationError(f"{path}: {error}") from None
    if path.suffix.lower() != ".dbc":  # cantools reads other formats, too, of which no line is known here
        usable_text, kind = DbcText(text), None
    else:
        usable_text, kind = usable(text), "dbc"
    try:
        return _without_bad_comments(usable_text, kind), usable_text, found
    except RecursionError:
        raise ConfigurationError(f"{path}: is not a DBC file that can be used (it is nested too deeply)") from None
    except Exception as error:  # cantools raises parse errors of several unrelated types
        if usable_text.left_out and not usable_text.messages:
            line, why = usable_text.left_out[0]
            raise ConfigurationError(f"{path}, line {line}: is not a DBC file that can be used ({why})") from None
        raise ConfigurationError(f"{path}{_where(error)}") from error


_MOST_COMMENTS = 50
"""Comments that may be left out of a file, each at the cost of reading it again."""


def _without_bad_comments(text: DbcText, kind: str | None) -> Any:
    """Return cantools' database, without the comments of one line that it cannot read: they change no value."""
    for _ in range(_MOST_COMMENTS):
        try:
            return cantools.database.load_string(text.text, kind, strict=False)
        except Exception as error:
            lines = text.text.split("\n")
            found = re.search(r"line (\d+), column", str(error))
            at = int(found[1]) - 1 if found is not None and kind == "dbc" else -1
            if not 0 <= at < len(lines) or re.match(r"\s*CM_ .*;\s*$", lines[at]) is None:
                raise
            lines[at] = ""
            text.text = "\n".join(lines)
            text.left_out.append((at + 1, "a comment: is none as DBC files have them; correct the line"))
    return cantools.database.load_string(text.text, kind, strict=False)


def _where(error: Exception) -> str:
    """Return the line of a mistake that cantools found, and a sentence."""
    said = " ".join(str(error).split())
    found = re.search(r"line (\d+), column (\d+)", said)
    if found is not None:
        return f", line {found[1]}: is not a DBC file that can be used, from column {found[2]} on; correct the line"
    return f": is not a DBC file that can be used ({said[:120]}); correct it"


def describe_dbc(path: Path, encoding: str | None = None) -> list[DbcSignal]:
    """Return every signal of a DBC file that can be read, in the order of the file; raise ConfigurationError."""
    return read_dbc(path, encoding).signals


def read_dbc(path: Path, encoding: str | None = None) -> DbcContents:
    """Return the signals of a DBC file and the items that cannot be read; raise ConfigurationError.

    Without `encoding` UTF-8 and cp1252 are tried.
    """
    database, text, named = _load_dbc(path, encoding)
    contents = DbcContents([], named, list(text.left_out), list(text.renamed))
    twice = _of_one_frame(database)
    for message in database.messages:
        line = text.messages.get(message.name, 1)
        why = _unreadable(message) or twice.get(message.name)
        if why is not None:
            contents.left_out.append((line, f"message {message.name}: {why}"))
            continue
        faults = layout_faults(message)
        faults = multiplexing_faults(message, text.multiplexing, faults) | faults
        shared = shared_bits(message, faults)
        for signal in message.signals:
            at = text.signals.get((message.name, signal.name), line)
            fault = faults.get(signal.name)
            if fault is not None:
                contents.left_out.append((at, f"{signal.name}: {fault}"))
                continue
            if signal.name in shared:
                contents.notes.append(
                    (at, f"{signal.name} shares bits with {', '.join(shared[signal.name])}; each is read by itself")
                )
            contents.signals.append(_described(message, signal, at))
    contents.left_out.sort()
    return contents


def _described(message: Any, signal: Any, line: int) -> DbcSignal:
    choices = {int(key): str(text) for key, text in (signal.choices or {}).items()}
    return DbcSignal(
        message.name,
        message.frame_id,
        _match_of(message),
        signal.name,
        signal.unit or "",
        signal.minimum,
        signal.maximum,
        choices or None,
        _cycle_s(message),
        bool(signal.multiplexer_ids),
        signal.comment or "",
        line,
        float(signal.scale),
        float(signal.offset),
        signal.length,
        bool(signal.is_signed),
        bool(signal.is_float),
    )


def _cycle_s(message: Any) -> float | None:
    """Return the period of a message in s; None where the DBC gives none, or no number of ms."""
    given = message.cycle_time  # whatever the attribute GenMsgCycleTime holds
    if isinstance(given, bool) or not isinstance(given, int | float) or not 0 < given < _LONGEST_CYCLE_MS:
        return None
    return given / 1000.0


def _unreadable(message: Any) -> str | None:
    """Return why no signal of a message can be read, or None."""
    if message.length > _LONGEST:
        return (
            f"has {message.length} bytes and a frame carries {_LONGEST}: CAN FD and the several packets of J1939's "
            "transport protocol are not read here; leave the point out"
        )
    return None


def _of_one_frame(database: Any) -> dict[str, str]:
    """Return the messages whose frames could be another's, by name, each with the cause and the remedy."""
    found: dict[str, str] = {}
    messages = [(message, _match_of(message)) for message in database.messages]
    for number, (one, match) in enumerate(messages):
        for other, theirs in messages[number + 1 :]:
            if match.overlaps(theirs):
                for name, second in ((one.name, other.name), (other.name, one.name)):
                    found[name] = (
                        f"a frame could be it and {second}; define the frames of each in a [[bus.NAME.message]], and "
                        "add its points"
                    )
    return found


def _parts(path: Path, bound: Bound) -> list[Any]:
    """Return messages that hold the wanted signals and share no bit each; none where one message does."""
    message = bound.message
    if is_whole(message.signals, message):
        return []
    faults = layout_faults(message)
    multiplexed: list[list[Any]] = []
    groups: list[list[Any]] = []
    for name in dict.fromkeys(wanted.name for _, wanted in bound.wanted):
        signal = next(s for s in message.signals if s.name == name)
        if signal.multiplexer_ids:
            if not any(signal in group for group in multiplexed):
                multiplexed.append(multiplexed_together(signal, message, faults))
            continue
        home = next((group for group in groups if is_whole([*group, signal], message)), None)
        if home is None:
            groups.append([signal])
        else:
            home.append(signal)
    for group in (*multiplexed, *groups):
        if not is_whole(group, message):
            raise ConfigurationError(
                f"{path}: signal {group[-1].name} of {message.name} shares bits with its multiplexor or does not fit "
                f"in {message.length} bytes; correct the DBC, or leave the point out"
            )
    return [part_of(group, message) for group in (*multiplexed, *groups)]


def bind(name: str, bus: CanBus, points: Sequence[Point]) -> list[Bound]:
    """Return the messages that points of bus `name` are read from, each with its frames; raise ConfigurationError.

    A point without its message or signal in the DBC is a mistake, and so are two messages that a frame could both be.
    """
    path = bus.dbc
    database, text, _ = _load_dbc(path, bus.dbc_encoding)
    entries = {entry.name: entry for entry in bus.message}
    bound: dict[str, Bound] = {}
    for index, point in enumerate(points):
        called = str(point.message)
        entry = entries.get(called)
        message = _message(path, database, called if entry is None else entry.dbc_message or called, point.name)
        signal = next((s for s in message.signals if s.name == point.signal), None)
        if signal is None:
            bad = next(((line, why) for line, why in text.left_out if why.startswith(f"{point.signal}: ")), None)
            if bad is not None:
                raise ConfigurationError(f"{path}, line {bad[0]}: {bad[1]}; point {point.name} is read from it")
            names = ", ".join(s.name for s in message.signals)
            raise ConfigurationError(
                f"{path}: message {message.name} has no signal {point.signal!r} for {point.name}; it has {names}"
            )
        faults = layout_faults(message)
        fault = (multiplexing_faults(message, text.multiplexing, faults) | faults).get(signal.name)
        if fault is not None:
            at = text.signals.get((message.name, signal.name))
            where = "" if at is None else f", line {at}"
            raise ConfigurationError(f"{path}{where}: signal {signal.name} of point {point.name} {fault}")
        if signal.unit and (known_unit(signal.unit) or canonical_unit(signal.unit)) != point.unit:
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
            cycle_s = _cycle_s(message)
            bound[called] = Bound(called, match, message.length, cycle_s, message, [])
        bound[called].wanted.append((index, _wanted(signal, bound[called].match.pgn is not None)))
    for one in bound.values():
        one.parts.extend(_parts(path, one))
    _refuse_overlaps(name, bus.dbc, database, list(bound.values()))
    return list(bound.values())


def _message(path: Path, database: Any, name: str, point: str) -> Any:
    try:
        message = database.get_message_by_name(name)
    except KeyError:
        names = ", ".join(m.name for m in database.messages)
        raise ConfigurationError(f"{path}: no message {name!r} for point {point}; there is {names}") from None
    why = _unreadable(message)
    if why is not None:
        raise ConfigurationError(f"{path}: message {name} of point {point} {why}")
    return message


def _is_j1939(message: Any) -> bool:
    return bool(message.is_extended_frame and message.protocol == "j1939")


def _match_of(message: Any) -> IdMatch:
    """Return the frames of a message by the DBC."""
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
    """Return the first raw number that means "error" or "not available", as do all above it (SAE J1939-71, 5.1.4).

    None where the signal has no such number: states of less than a byte that the DBC names are states.
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
        f"{path}: a frame could be both {one.name} ({one.match}) and {name} ({match}); define the frames of each in "
        f"the rig file, with a narrower mask or a source, in a [[bus.{bus}.message]]"
    )
