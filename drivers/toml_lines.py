"""TOML text of a user: its tables, and the lines that its sections and keys are on."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Sequence
from typing import Any

_KEY = re.compile(r"^\s*(?:\"([^\"]+)\"|([A-Za-z0-9_\-]+))\s*=")


def tables_of(raw: bytes) -> tuple[str, dict[str, Any]]:
    """Text and tables of a TOML file's content; raises ValueError with what is wrong, where, and the remedy."""
    try:
        text = raw.decode("utf-8")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise ValueError(f"is not UTF-8 text (line {line}); save it as UTF-8") from None
    if text.startswith("\ufeff"):
        raise ValueError("begins with a byte order mark (line 1); save it as UTF-8 without one")
    try:
        return text, tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"is not valid TOML: {error}; correct it there") from None


def line_of(text: str, place: Sequence[Any]) -> int:
    """Line (from 1) of a place such as ('point', 3, 'order') in TOML text; the section's line where the key is not."""
    section = str(place[0]) if place else ""
    rest = list(place[1:])
    lines = text.splitlines()
    start = 0
    if rest and isinstance(rest[0], int):
        header, count = f"[[{section}]]", rest.pop(0)
        hits = [n for n, line in enumerate(lines) if line.split("#")[0].strip() == header]
        start = hits[count] if count < len(hits) else 0
    else:
        if rest and section == "bus":
            section = f"bus.{rest.pop(0)}"
        if len(rest) > 1 and isinstance(rest[1], int) and f"[[{section}.{rest[0]}]]" in text:
            return line_of(text, (f"{section}.{rest[0]}", *rest[1:]))
        wanted = {f"[{section}]", f"[[{section}]]"}
        hits = [n for n, line in enumerate(lines) if line.split("#")[0].strip() in wanted]
        if hits:
            start = hits[0]
        else:
            rest = [section]
    keys = {str(item) for item in rest}
    for number in range(start, len(lines)):
        if number > start and lines[number].lstrip().startswith("["):
            if hits or start:
                break
            continue
        match = _KEY.match(lines[number])
        if match and (match[1] or match[2]) in keys:
            return number + 1
    return start + 1
