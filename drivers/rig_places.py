"""Where in the text of a rig file a mistake is, and the sentence that tells of it."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from drivers.bus_sections import TRANSPORTS
from drivers.interlock_specs import KINDS
from drivers.toml_lines import line_of

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
