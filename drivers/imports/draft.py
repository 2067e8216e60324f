"""What an import has found, as plain data, and the commented rig file that is written of it."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from drivers.points import ConfigurationError
from drivers.rig_checks import Layout
from drivers.rig_model import Point
from drivers.units import canonical_unit


class ImportFileError(ConfigurationError):
    """A file that cannot be imported; one sentence with file, line and remedy."""

    def __init__(self, path: Path, line: int | None, what: str) -> None:
        super().__init__(f"{path}{'' if line is None else f', line {line}'}: {_plain(what)}")


@dataclass(slots=True)
class DraftPoint:
    """One point as it will be written: the rig file's keys, where it came from, and what is said behind a key."""

    name: str
    line: int
    keys: dict[str, Any]
    comment: str = ""
    remarks: dict[str, str] = field(default_factory=dict)


@dataclass(slots=True)
class DraftBus:
    """One bus of the rig file and its points."""

    name: str
    keys: dict[str, Any]
    points: list[DraftPoint] = field(default_factory=list)


@dataclass(slots=True)
class Draft:
    """A rig file to be. `notes` are what could not be taken over, for the user's eyes and the file's head.

    `head` stands in for what an import writes at the top, `rig` are further keys of `[rig]` with a remark each, and
    `sections` are written as they are, before the points.
    """

    source: Path
    buses: list[DraftBus]
    notes: list[str] = field(default_factory=list)
    head: str = ""
    rig: dict[str, tuple[Any, str]] = field(default_factory=dict)
    sections: list[str] = field(default_factory=list)


def read_text(path: Path) -> str:
    """A text file in UTF-8 (with or without byte order mark); raises ImportFileError."""
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise ImportFileError(path, None, f"cannot be read ({error.strerror}); correct the path") from None
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        raise ImportFileError(path, line, "is not UTF-8 text; save it as CSV UTF-8 or plain UTF-8 text") from None
    if "\0" in text:
        raise ImportFileError(path, text[: text.index("\0")].count("\n") + 1, "holds a zero byte; save it as text")
    return text


def number(path: Path, line: int, what: str, value: Any) -> float:
    """A finite number; raises ImportFileError."""
    try:
        found = float(value)
    except (TypeError, ValueError, OverflowError):
        found = math.nan
    if isinstance(value, bool) or not math.isfinite(found):
        raise ImportFileError(path, line, f"{what} {value!r} is no number; correct it")
    return found


def whole(path: Path, line: int, what: str, value: Any, low: int, high: int) -> int:
    """A whole number from `low` to `high`; raises ImportFileError."""
    found = number(path, line, what, value)
    if found != int(found) or not low <= found <= high:
        raise ImportFileError(path, line, f"{what} {value!r} is no whole number from {low} to {high}; correct it")
    return int(found)


class Collector:
    """Takes points in, one by one, and refuses what no rig file can hold, with the line of the source.

    Names are made fit for a record's column and unique; units that are not known are noted, and written as a comment.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes: list[str] = []
        self._names: dict[str, int] = {}
        self._layout = Layout()
        self._lines: dict[tuple[str, str], int] = {}

    def name(self, wanted: str) -> str:
        """A name that a rig file takes, made of what the source calls a point, and not taken yet."""
        stem = re.sub(r"[^A-Za-z0-9_]+", "_", wanted).strip("_") or "point"
        if not stem[0].isalpha():
            stem = f"p_{stem}"
        count = self._names.get(stem, 0) + 1
        self._names[stem] = count
        if count == 1:
            return stem
        return self.name(f"{stem}_{count}")

    def unit(self, line: int, unit: str) -> tuple[str, str]:
        """The unit's symbol here, and a comment: a unit that is not known becomes '1'."""
        try:
            return canonical_unit(unit.strip()), ""
        except ValueError as error:
            self.notes.append(f"line {line}: {error}; written as '1'")
            return "1", f"unit in {self.path.name}: {unit.strip()}"

    def point(self, bus: str, wanted: str, line: int, keys: dict[str, Any]) -> DraftPoint:
        """A point that `hil check` accepts; raises ImportFileError with the line that is wrong."""
        unit, comment = self.unit(line, str(keys.pop("unit", "") or "1"))
        name = self.name(wanted)
        if name != wanted:
            comment = f"{comment}; " * bool(comment) + f"called {_plain(wanted)!r} in {self.path.name}"
        keys = {"bus": bus, **{key: value for key, value in keys.items() if value is not None}, "unit": unit}
        try:
            point = Point.model_validate({"name": name, **keys})
        except ValidationError as error:
            item = error.errors()[0]
            place = ".".join(str(part) for part in item["loc"])
            what = item["msg"].removeprefix("Value error, ")
            raise ImportFileError(self.path, line, f"{place or name}: {what}; correct the line") from None
        if point.table is not None:
            last = (point.address or 0) + point.width - 1
            if last > 65535:
                raise ImportFileError(self.path, line, f"{name} ends at {last}, beyond 65535; correct address or type")
            clash = self._layout.taken_by(point)
            if clash is not None:
                other = self._lines.get((bus, clash[0]), 0)
                raise ImportFileError(
                    self.path,
                    line,
                    f"{name}: {point.table} {clash[1]} is {clash[0]}'s already (line {other}); correct an address or a "
                    "type, or leave one of the lines out",
                )
            self._lines[(bus, name)] = line
        return DraftPoint(name, line, keys, comment)


def _plain(text: str) -> str:
    """Text on one line without control characters, for a comment."""
    return "".join(letter if letter.isprintable() else " " for letter in text).strip()


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        # JSON's escapes are TOML's, but for the delete character, which JSON leaves as it is
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list | tuple):
        return f"[{', '.join(_toml(item) for item in value)}]"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_toml(str(key))} = {_toml(item)}" for key, item in value.items()) + " }"
    if isinstance(value, float) and not math.isfinite(value):
        return "nan" if math.isnan(value) else "inf" if value > 0 else "-inf"
    return repr(value)


_HEAD = """\
# Rig file made of {source} by `hil init`. Addresses are zero-based, as they are on the wire.
# `hil check` explains it and names every mistake. What an import cannot know, and a rig should have:
#   plausible = [low, high]   what a reading may be; beyond it the value is kept and not believed
#   limits, safe_value, max_rate, readback   of what a profile may drive (access = "rw")
#   role = "heater_power"     what a point is, by which `hil resume` leads the rig back (docs/reference/rig-file.md)
#   [heartbeat]               how rig and harness watch each other
"""


def write(draft: Draft, name: str, *, period_s: float = 1.0) -> str:
    """The rig file's text."""
    lines = [draft.head or _HEAD.format(source=_plain(draft.source.name))]
    if draft.notes:
        lines += ["# To look at:", *(f"#   {_plain(note)}" for note in draft.notes), ""]
    lines += ["[rig]", f"name = {_toml(name)}", f"period_s = {_toml(period_s)}"]
    lines += [_line(key, value, remark) for key, (value, remark) in draft.rig.items()]
    for bus in draft.buses:
        lines += ["", f"[bus.{bus.name}]", *(f"{key} = {_toml(value)}" for key, value in bus.keys.items())]
    for section in draft.sections:
        lines += ["", section]
    for bus in draft.buses:
        lines += ["", f"# {bus.name} " + "-" * (100 - len(bus.name))]
        for point in bus.points:
            lines += ["", "[[point]]", f"name = {_toml(point.name)}"]
            if point.comment:
                lines.append(f"# {_plain(point.comment)}")
            lines += _keys(point)
    return "\n".join(lines) + "\n"


def _line(key: str, value: Any, remark: str) -> str:
    text = f"{key} = {_toml(value)}"
    return f"{text:<24} # {_plain(remark)}" if remark else text


def _keys(point: DraftPoint) -> Iterable[str]:
    keys = point.keys
    for key, value in keys.items():
        yield _line(key, value, point.remarks.get(key, ""))
    if "limits" in keys or keys.get("kind") == "status":
        return
    if keys.get("table") in ("holding", "input", None) and "plausible" not in keys and "labels" not in keys:
        yield "# plausible = [low, high]"
    if keys.get("access") in ("w", "rw"):
        yield "# limits = [low, high]; safe_value; max_rate; readback: needed before a profile may drive this"
