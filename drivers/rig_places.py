"""Where in the text of a rig file a mistake is, and the sentence that tells of it."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from drivers.bus_sections import TRANSPORTS
from drivers.interlock_specs import KINDS

_KEY = re.compile(r"^\s*(?:\"([^\"]+)\"|([A-Za-z0-9_\-]+))\s*=")


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


_TAGS = (*TRANSPORTS, *KINDS)
"""Which member of a union was meant: pydantic puts it into the place of a mistake."""
_REMEDY = {
    "missing": "is missing; add it",
    "extra_forbidden": "is not a key of this section; check its spelling",
}


def sentence(path: Path, text: str, item: Any) -> str:
    place = tuple(item["loc"])
    if len(place) > 2 and place[0] in ("bus", "interlock") and place[2] in _TAGS:
        place = (*place[:2], *place[3:])
    what = _REMEDY.get(item["type"], item["msg"].removeprefix("Value error, "))
    if item["type"] == "literal_error":
        what = f"{item['input']!r} is not known; use {item['ctx']['expected']}"
    elif item["type"] == "union_tag_invalid":
        key = item["ctx"]["discriminator"].strip("'")
        what = f"{key} {item['input'].get(key)!r} is not known; use {item['ctx']['expected_tags']}"
    elif item["type"] not in ("missing", "extra_forbidden", "value_error") and not isinstance(item["input"], dict):
        what = f"{what}, got {item['input']!r}"
    key = ".".join(str(part) for part in place if not isinstance(part, int))
    owner = ""
    if len(place) > 1 and place[0] == "point" and isinstance(place[1], int):
        points = tomllib.loads(text).get("point", [])
        name = points[place[1]].get("name") if place[1] < len(points) else None
        key = str(place[2]) if len(place) > 2 else "point"
        owner = f" of point {name or place[1]}"
    return f"{path}, line {line_of(text, place)}: {key}{owner}: {what}"
