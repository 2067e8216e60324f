"""Draft of a rig file: the points of an import as plain data, and the commented file written of them."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from drivers.rig_file import (
    LONGEST_NAME,
    MOST_DESCRIPTION,
    QUALITY_SUFFIX,
    RESERVED_COLUMNS,
    Layout,
    Point,
    decoded,
    mistake,
    read_regular,
    shown,
    unwritable,
)
from drivers.signals import ConfigurationError, canonical_unit, in_ascii, known_unit

_BY_ONE, _BY_MANY = frozenset((5, 6)), frozenset((15, 16))
"""Modbus functions that write one value, and those that write several."""


class ImportFileError(ConfigurationError):
    """Error of a file that cannot be imported; one sentence with file, line and remedy."""

    def __init__(self, path: Path, line: int | None, what: str) -> None:
        super().__init__(f"{path}{'' if line is None else f', line {line}'}: {_plain(what)}")
        self.line = line
        self.what = _plain(what)


@dataclass(slots=True)
class DraftPoint:
    """Point as it will be written: keys of the rig file, line in the source, and remarks behind keys."""

    name: str
    line: int
    keys: dict[str, Any]
    comment: str = ""
    remarks: dict[str, str] = field(default_factory=dict)


@dataclass(slots=True)
class DraftBus:
    """Bus of the rig file and its points. `remarks` are written behind keys."""

    name: str
    keys: dict[str, Any]
    points: list[DraftPoint] = field(default_factory=list)
    remarks: dict[str, str] = field(default_factory=dict)
    _by_many: list[int] = field(default_factory=list)
    _by_one: list[int] = field(default_factory=list)

    def written_with(self, line: int, codes: Collection[int], collector: Collector) -> None:
        """Declare functions that write a single register or bit in the source's `line`, and note a contradiction.

        A device whose values are all written with functions 15 and 16 alone gets `write_multiple`.
        """
        one, many = not _BY_ONE.isdisjoint(codes), not _BY_MANY.isdisjoint(codes)
        if one == many:
            return
        (self._by_one if one else self._by_many).append(line)
        if self._by_many and self._by_one:
            first = self._by_many[0] if one else self._by_one[0]
            said = "see which functions the device has, and give the bus write_multiple = true where it lacks 5 and 6"
            if len(self._by_one if one else self._by_many) == 1:
                collector.note(line, f"is written with another function than line {first}; {said}")
            self.keys.pop("write_multiple", None)
        elif self._by_many:
            self.keys["write_multiple"] = True


@dataclass(slots=True)
class Draft:
    """Rig file before it is written. `notes` are items that were left out or changed, for user and file head.

    `head` replaces the default text at the top, `rig` are further keys of `[rig]` with a remark each, `period_remark`
    is written behind the period, and `sections` are written as they are, before the points.
    """

    source: Path
    buses: list[DraftBus]
    notes: list[str] = field(default_factory=list)
    head: str = ""
    rig: dict[str, tuple[Any, str]] = field(default_factory=dict)
    sections: list[str] = field(default_factory=list)
    period_remark: str = ""


def read_text(path: Path) -> str:
    """Return a text file in UTF-8 (with or without byte order mark); raise ImportFileError."""
    raw = read_bytes(path)
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        raise ImportFileError(path, line, "is not UTF-8 text; save it as CSV UTF-8 or plain UTF-8 text") from None
    return without_zeros(path, text)


def read_bytes(path: Path) -> bytes:
    """Return a file's content; raise ImportFileError."""
    try:
        return read_regular(path, MOST_DESCRIPTION)
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise ImportFileError(path, None, f"cannot be read ({why}); correct the path") from None


def read_any_text(path: Path, encoding: str | None, notes: list[str]) -> str:
    """Return a text file of any usual encoding, which `notes` name where it is not UTF-8; raise ImportFileError."""
    raw = read_bytes(path)
    try:
        text, found = decoded(raw, encoding)
    except ValueError as error:
        raise ImportFileError(path, None, str(error)) from None
    if found != "utf-8" and encoding in (None, "utf-8"):
        notes.append(f"it is no UTF-8 text and was read as {found}; look at its names and units")
    return without_zeros(path, text)


def without_zeros(path: Path, text: str) -> str:
    """Return a text that holds no zero character; raise ImportFileError with the line of one."""
    if "\0" in text:
        raise ImportFileError(path, text[: text.index("\0")].count("\n") + 1, "holds a zero byte; save it as text")
    return text


def number(path: Path, line: int, what: str, value: Any) -> float:
    """Return `value` as a finite number; raise ImportFileError."""
    if isinstance(value, str) and (placeholder := placeholder_in(value)) is not None:
        raise ImportFileError(path, line, f"{what} is {placeholder}; write the number that it stands for")
    try:
        found = float(value)
    except (TypeError, ValueError, OverflowError):
        found = math.nan
    if isinstance(value, bool) or not math.isfinite(found):
        raise ImportFileError(path, line, f"{what} {shown(value)} is no number; correct it")
    return found


def whole(path: Path, line: int, what: str, value: Any, low: int, high: int) -> int:
    """Return `value` as a whole number from `low` to `high`; raise ImportFileError."""
    found = number(path, line, what, value)
    if found != int(found) or not low <= found <= high:
        raise ImportFileError(path, line, f"{what} {shown(value)} is no whole number from {low} to {high}; correct it")
    return int(found)


_PLACEHOLDER = re.compile(r"\$\{[^}]*\}|\$[A-Za-z_]\w*|@\{[^}]*\}|\{\{.*?\}\}")
"""Placeholders that another program fills in: `$VAR` and `${VAR}` of a shell, `@{store:key}` of a secret store, and
`{{ template }}`."""


def placeholder_in(text: str) -> str | None:
    """Return the first placeholder in a text, or None."""
    found = _PLACEHOLDER.search(text)
    return None if found is None else found[0]


_RESERVED = frozenset(column.removesuffix("_s") for column in RESERVED_COLUMNS)
"""Names whose columns records have of their own, in the unit s or without one."""


class Collector:
    """Points of an import, taken in one by one; a point that no rig file can hold is left out with a note.

    Names are made fit for a record's column and unique; units that are not known are noted, and written as a comment.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes: list[str] = []
        self.left_out: list[ImportFileError] = []
        self._names: dict[str, int] = {}
        self._layout = Layout()
        self._lines: dict[tuple[str, str], int] = {}

    def note(self, line: int, what: str) -> None:
        """Note a fact that the user must see, with its line in the source."""
        self.notes.append(f"line {line}: {_plain(what)}")

    @contextmanager
    def item(self, line: int, name: object) -> Iterator[None]:
        """Leave an item out, with a note, where an ImportFileError is raised while it is taken in."""
        try:
            yield
        except ImportFileError as error:
            said = error.what if re.match(rf"{re.escape(str(name))}[: ]", error.what) else f"{name}: {error.what}"
            left = ImportFileError(self.path, error.line or line, f"{said} (left out)")
            self.left_out.append(left)
            self.notes.append(f"line {left.line}: {left.what}")

    def nothing(self, line: int | None, what: str) -> ImportFileError:
        """Return the error of an import without any point: the first item that was left out, or else `what`."""
        if not self.left_out:
            return ImportFileError(self.path, line, what)
        first = self.left_out[0]
        rest = f"; {len(self.left_out) - 1} more are left out" if len(self.left_out) > 1 else ""
        return ImportFileError(self.path, first.line, f"{first.what}{rest}; there is nothing to import")

    def name(self, wanted: str) -> str:
        """Return a valid, unused name of a rig file's point, made of its name in the source.

        Capital letters distinguish no columns, and no column may be one that records have of their own.
        """
        stem = re.sub(r"[^A-Za-z0-9_]+", "_", in_ascii(wanted)).strip("_") or "point"
        if not stem[0].isalpha():
            stem = f"p_{stem}"
        stem = stem[: LONGEST_NAME - len("_9999")].rstrip("_")  # with room for the number of an equal name
        if stem.lower() in _RESERVED or stem.lower().endswith(QUALITY_SUFFIX):
            stem = f"{stem}_value"
        count = self._names.get(stem.lower(), 0) + 1
        self._names[stem.lower()] = count
        if count == 1:
            return stem
        return self.name(f"{stem}_{count}")

    def unit(self, line: int, unit: str) -> tuple[str, str]:
        """Return the unit's symbol here and a comment; a unit that is not known becomes '1'."""
        known = known_unit(unit)
        if known is not None:
            return known, ""
        try:
            return canonical_unit(unit.strip()), ""
        except ValueError as error:
            self.notes.append(f"line {line}: {error}; written as '1'")
            return "1", f"unit in {self.path.name}: {unit.strip()}"

    def point(
        self, bus: str, wanted: str, line: int, keys: dict[str, Any], guessed: Mapping[str, str] | None = None
    ) -> DraftPoint:
        """Return a point that `hil check` accepts; raise ImportFileError with the line of the mistake.

        Parameters
        ----------
        bus, wanted
            Name of its bus, and its name in the source.
        line
            Line of the source.
        keys
            Keys of the rig file; those that are None are not written.
        guessed
            Reason for the value of each key that the source does not state; it is written behind that key.
        """
        placeholder = placeholder_in(wanted)
        if placeholder is not None:
            raise ImportFileError(self.path, line, f"its name holds {placeholder}; write what that stands for")
        names = dict(self._names)
        try:
            point = self._point(bus, wanted, line, keys)
        except ImportFileError:
            self._names = names
            raise
        point.remarks |= {key: f"guessed: {why}" for key, why in (guessed or {}).items() if key in point.keys}
        return point

    def _point(self, bus: str, wanted: str, line: int, keys: dict[str, Any]) -> DraftPoint:
        stated = str(keys.pop("unit", "") or "").strip()
        given = stated or "1"
        name = self.name(wanted)
        comment = f"called {_plain(wanted)!r} in {self.path.name}" if name != wanted else ""
        keys = {"bus": bus, **{key: value for key, value in keys.items() if value is not None}}
        try:
            point = Point.model_validate({"name": name, **keys, "unit": "1"})
        except ValidationError as error:
            item = error.errors()[0]
            place = ".".join(str(part) for part in item["loc"])
            raise ImportFileError(self.path, line, f"{place or name}: {mistake(item)}; correct the line") from None
        if point.table is not None:
            last = (point.address or 0) + point.width - 1
            if last > 65535:
                raise ImportFileError(self.path, line, f"{name} ends at {last}, beyond 65535; correct address or type")
            if (why := unwritable(point)) is not None:
                raise ImportFileError(self.path, line, f"{name}: {why}, or correct its access {point.access!r}")
            clash = self._layout.clash(point)
            if clash is not None:
                other = self._lines.get((bus, clash[0]), 0)
                raise ImportFileError(
                    self.path,
                    line,
                    f"{name}: {point.table} {clash[1]} is {clash[0]}'s already (line {other}); correct an address or a "
                    "type, or leave one of the lines out",
                )
            self._layout.taken_by(point)
            self._lines[(bus, name)] = line
        unit, about = self.unit(line, given)
        drafted = DraftPoint(name, line, keys | {"unit": unit}, "; ".join(filter(None, (about, comment))))
        if about:
            drafted.remarks["unit"] = "guessed: the unit is not known here"
        elif not stated and point.kind == "measured" and point.labels is None and point.type != "bool":
            drafted.remarks["unit"] = "guessed: no unit is given"
        return drafted


def _plain(text: str) -> str:
    """Return a text on one line without control characters, for a comment."""
    return "".join(letter if letter.isprintable() else " " for letter in text).strip()


def toml_text(value: Any) -> str:
    """Return a value as text of a TOML file."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        # JSON's escapes are TOML's, but for the delete character, which JSON leaves as it is
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list | tuple):
        return f"[{', '.join(toml_text(item) for item in value)}]"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{toml_text(str(key))} = {toml_text(item)}" for key, item in value.items()) + " }"
    if isinstance(value, float) and not math.isfinite(value):
        return "nan" if math.isnan(value) else "inf" if value > 0 else "-inf"
    return repr(value)


_HEAD = """\
# Rig file made of {source} by `hil init`. Addresses are zero-based, as they are on the wire.
# `hil check` explains it and names every mistake. Check every line that is marked "guessed": the source does not state
# its value. An import does not know these keys, and a rig should have them:
#   plausible = [low, high]   range of good readings; a value beyond it is recorded as out of range
#   limits, safe_value, max_rate, readback   for points that a profile may drive (access = "rw")
#   role = "heater_power"     function of a point, which the thermal restore of `hil resume` needs
#   [heartbeat]               mutual supervision of rig and harness (docs/reference/rig-file.md)
"""


def rig_file_text(draft: Draft, name: str, *, period_s: float = 1.0) -> str:
    """Return the rig file's text; `period_s` is its period in s."""
    lines = [draft.head or _HEAD.format(source=_plain(draft.source.name))]
    if draft.notes:
        lines += ["# To check:", *(f"#   {_plain(note)}" for note in draft.notes), ""]
    lines += ["[rig]", f"name = {toml_text(name)}", _line("period_s", period_s, draft.period_remark)]
    lines += [_line(key, value, remark) for key, (value, remark) in draft.rig.items()]
    for bus in draft.buses:
        lines += ["", f"[bus.{bus.name}]"]
        lines += [_line(key, value, bus.remarks.get(key, "")) for key, value in bus.keys.items()]
    for section in draft.sections:
        lines += ["", section]
    for bus in draft.buses:
        lines += ["", f"# {bus.name} " + "-" * (100 - len(bus.name))]
        for point in bus.points:
            lines += ["", "[[point]]", f"name = {toml_text(point.name)}"]
            if point.comment:
                lines.append(f"# {_plain(point.comment)}")
            lines += _keys(point)
    return "\n".join(lines) + "\n"


def _line(key: str, value: Any, remark: str) -> str:
    text = f"{key} = {toml_text(value)}"
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
