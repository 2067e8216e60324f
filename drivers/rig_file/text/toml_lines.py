"""TOML text of a user: its tables, and the line of each of its keys."""

from __future__ import annotations

import contextlib
import re
import tomllib
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

from drivers.rig_file.text.bounded_toml import parse_toml

_BARE = re.compile(r"[A-Za-z0-9_\-]+")
_BLANK = re.compile(r"[ \t]*")
_BETWEEN = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_SCALAR = re.compile(r"[^,\]}#\n]*")
_STRING = re.compile(
    r'"""(?:[^\\]|\\.)*?"{3,5}|\'\'\'.*?\'{3,5}|"(?:[^"\\\n]|\\.)*"|\'[^\'\n]*\'',
    re.DOTALL,
)

_REMEDIES = (
    (re.compile("[\u201c\u201d\u201e\u00ab\u00bb\u2018\u2019]"), 'write straight quotes, as in name = "rig"'),
    (re.compile(r"Cannot declare \('(\w+)',\) twice"), "write [[{0}]] with two brackets where there are several"),
    (re.compile(r"Cannot overwrite a value"), "a key stands twice in this section; take one of them out"),
    (re.compile(r"=\s*(?:True|TRUE|yes|on|On|Yes)\s*(?:#|$)"), "write true in lower case"),
    (re.compile(r"=\s*(?:False|FALSE|no|off|Off|No)\s*(?:#|$)"), "write false in lower case"),
    (re.compile(r"=\s*-?\d+,\d+\s*(?:#|$)"), "write a decimal point, as in 1.5"),
    (re.compile(r"Unescaped '\\'|Invalid hex value"), "write / in paths, or put the text in single quotes"),
    (re.compile(r"Invalid value[^=]*=\s*[A-Za-z_]"), 'put text in quotes, as in name = "rig"'),
)
"""Mistakes with the remedy: patterns of the error and of the line behind it.

A remedy shows no value: a run's folder may name any file as its rig file.
"""

Place = tuple[str | int, ...]


def tables_of(raw: bytes) -> tuple[str, dict[str, Any]]:
    """Return text and tables of a TOML file's content; raise ValueError with the mistake, its line and the remedy."""
    try:
        text = raw.decode("utf-8")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise ValueError(f"is not UTF-8 text (line {line}); save it as UTF-8") from None
    if text.startswith("\ufeff"):
        raise ValueError("begins with a byte order mark (line 1); save it as UTF-8 without one")
    try:
        return text, parse_toml(text)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"is not valid TOML: {error}; {_remedy_of(text, error)}") from None
    except ValueError as error:
        raise ValueError(f"is not valid TOML: {error}") from None


def _remedy_of(text: str, error: tomllib.TOMLDecodeError) -> str:
    """Return the remedy for a mistake: names outside quotes are letters a to z."""
    place = re.search(r"at line (\d+)", str(error))
    line = text.split("\n")[int(place[1]) - 1] if place is not None else ""
    for pattern, remedy in _REMEDIES:
        if (found := pattern.search(f"{error}: {line}")) is not None:
            return remedy.format(*found.groups())
    odd = re.search(r"\w*[^\x00-\x7f]\w*", re.split(r"[#=\"']", line, maxsplit=1)[0])
    if odd is None:
        return "correct it there"
    return f"put '{odd[0]}' in quotes, or write it with the letters a to z"


def line_of(text: str, place: Sequence[Any]) -> int:
    """Return the line (from 1) of a place such as ('point', 3, 'order') in TOML text.

    A key that is not there has the line of the table that lacks it; a key of `[rig]` may be named without `rig`.
    """
    lines = key_lines(text)
    for start in ((), ("rig",)):
        wanted = (*start, *place)
        for end in range(len(wanted), len(start), -1):
            if wanted[:end] in lines:
                return lines[wanted[:end]]
    return lines.get(("rig",), 1)


@lru_cache(maxsize=8)
def key_lines(text: str) -> dict[Place, int]:
    """Return the line (from 1) of every key, table and list element of valid TOML text, by its place.

    A list element is named by its number: `("point", 2, "name")` is the name of the third `[[point]]`.
    """
    scanner = _Scanner(text)
    with contextlib.suppress(ValueError, RecursionError):  # lines are a help: those found so far are used
        scanner.scan()
    return scanner.lines


class _Scanner:
    """Reader of valid TOML that keeps places and lines only."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.at = 0
        self.lines: dict[Place, int] = {}
        self._counts: dict[Place, int] = {}
        self._known = (0, 1)

    def scan(self) -> None:
        table: Place = ()
        while True:
            self._skip(_BETWEEN)
            if self.at >= len(self.text):
                return
            if self.text.startswith("[", self.at):
                is_list = self.text.startswith("[[", self.at)
                line = self._line()
                self.at += 2 if is_list else 1
                table = self._table(self._key(), is_list, line)
                self._expect("]]" if is_list else "]")
            else:
                self._pair(table)

    def _table(self, key: list[str], is_list: bool, line: int) -> Place:
        """Return the place that a heading opens; the parts of its key may be lists of tables themselves."""
        place: Place = ()
        for number, part in enumerate(key, 1):
            place = (*place, part)
            self.lines.setdefault(place, line)
            if number == len(key) and is_list:
                self._counts[place] = self._counts.get(place, -1) + 1
            if place in self._counts:
                place = (*place, self._counts[place])
                self.lines.setdefault(place, line)
        return place

    def _pair(self, table: Place) -> None:
        line = self._line()
        place = table
        for part in self._key():
            place = (*place, part)
            self.lines.setdefault(place, line)
        self._expect("=")
        self._value(place)

    def _value(self, place: Place) -> None:
        self._skip(_BLANK)
        mark = self.text[self.at : self.at + 1]
        if mark in ('"', "'"):
            self._string()
        elif mark in ("[", "{"):
            self.at += 1
            number = 0
            while not self._closed("]" if mark == "[" else "}"):
                if mark == "[":
                    self.lines.setdefault((*place, number), self._line())
                    self._value((*place, number))
                else:
                    self._pair(place)
                number += 1
                self._skip(_BETWEEN)
                if self.text.startswith(",", self.at):
                    self.at += 1
        else:
            self._skip(_SCALAR)

    def _closed(self, mark: str) -> bool:
        self._skip(_BETWEEN)
        if self.at >= len(self.text):
            raise ValueError("the text ends within a value")
        if self.text.startswith(mark, self.at):
            self.at += 1
            return True
        return False

    def _key(self) -> list[str]:
        parts = []
        while True:
            self._skip(_BLANK)
            if self.text[self.at : self.at + 1] in ('"', "'"):
                parts.append(str(next(iter(tomllib.loads(f"{self._string()} = 0")))))
            else:
                parts.append(self._skip(_BARE))
            self._skip(_BLANK)
            if not parts[-1] or not self.text.startswith(".", self.at):
                return parts
            self.at += 1

    def _string(self) -> str:
        found = self._skip(_STRING)
        if not found:
            raise ValueError("a text does not end")
        return found

    def _expect(self, mark: str) -> None:
        self._skip(_BLANK)
        if not self.text.startswith(mark, self.at):
            raise ValueError(f"{mark} expected")
        self.at += len(mark)

    def _skip(self, pattern: re.Pattern[str]) -> str:
        found = pattern.match(self.text, self.at)
        if found is None:
            return ""
        self.at = found.end()
        return found[0]

    def _line(self) -> int:
        at, line = self._known
        line += self.text.count("\n", at, self.at)
        self._known = self.at, line
        return line
