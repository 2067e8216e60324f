"""Sentences for the mistakes that pydantic finds in a rig file: line, key, mistake and remedy."""

from __future__ import annotations

import difflib
import re
import tomllib
from pathlib import Path
from typing import Any

from drivers.rig_file.bus_sections import (
    TRANSPORTS,
    CanBus,
    ModbusRtuBus,
    ModbusRtuTcpBus,
    ModbusTcpBus,
    ModbusTlsBus,
    Section,
)
from drivers.rig_file.interlock_specs import KINDS
from drivers.rig_file.model import Point, Rig
from drivers.rig_file.text import line_of
from drivers.signals import in_ascii

_BUSES: dict[str, type[Section]] = {
    "modbus_tcp": ModbusTcpBus,
    "modbus_tls": ModbusTlsBus,
    "modbus_rtu_tcp": ModbusRtuTcpBus,
    "modbus_rtu": ModbusRtuBus,
    **dict.fromkeys(TRANSPORTS[4:], CanBus),
}
_TAGS = (*TRANSPORTS, *KINDS)
"""Tags of union members: pydantic puts the tag into the place of a mistake."""
_REMEDY = {
    "missing": "is missing; add it",
    "extra_forbidden": "is not a key of this section; check its spelling",
}
_NEEDED = {
    "string": "must be text in quotes",
    "float": "must be a number",
    "decimal": "must be a number",
    "int": "must be a whole number",
    "bool": "must be true or false",
    "tuple": "must be a list in square brackets",
    "list": "must be a list in square brackets",
    "dict": "must be a table of keys",
    "mapping": "must be a table of keys",
    "model": "must be a table of keys",
    "path": "must be the path of a file, as text in quotes",
    "finite": "must be a finite number",
}
"""By the first word of pydantic's error type: `int_parsing` and `int_from_float` are both of an `int`."""
_BOUND = {
    "greater_than": ("gt", "must be above"),
    "greater_than_equal": ("ge", "must be at least"),
    "less_than": ("lt", "must be below"),
    "less_than_equal": ("le", "must be at most"),
}
_LONGEST_SHOWN = 60
"""Characters of a wrong value that a message shows."""


def sentence(path: Path, text: str, item: Any) -> str:
    """Return the sentence of one of pydantic's errors, `item`, in the rig file at `path` with content `text`."""
    place = tuple(item["loc"])
    if len(place) > 2 and place[0] in ("bus", "interlock") and place[2] in _TAGS:
        place = (*place[:2], *place[3:])
    what = mistake(item)
    if item["type"] == "extra_forbidden":
        what = _unknown_key(tuple(item["loc"]))
    if item["type"] == "missing" and len(place) > 2 and isinstance(place[-1], int):
        what = "has too few values; give all of them"
    names = [str(part) for part in place if not isinstance(part, int)]
    if item["type"].startswith("union_tag"):
        place = (*place, item["ctx"]["discriminator"].strip("'"))
    key, owner = ".".join(names), ""
    if len(place) > 1 and place[0] == "point" and isinstance(place[1], int):
        points = tomllib.loads(text).get("point", [])
        name = points[place[1]].get("name") if place[1] < len(points) else None
        key = ".".join(names[1:]) or "point"
        owner = f" of point {name if isinstance(name, str) and name else place[1]}"
    return " ".join(f"{path}, line {line_of(text, place)}: {key}{owner}: {what}".split("\n"))


def _unknown_key(place: tuple[Any, ...]) -> str:
    """Return the mistake of a key that its section has not: one of another transport, a misspelt one, or any other."""
    key, keys = str(place[-1]), set(Point.model_fields) if place[0] == "point" else set(Rig.model_fields)
    if place[0] == "bus" and len(place) == 4:
        tag = str(place[2])
        keys = set(_BUSES[tag].model_fields)
        others = [name for name, section in _BUSES.items() if key in section.model_fields]
        if others:
            return f"is no key of transport {tag!r}, but of {', '.join(others)}; correct the transport, or take it out"
    elif len(place) != (3 if place[0] == "point" else 1):
        keys = set()
    close = difflib.get_close_matches(key, sorted(keys), 1, 0.75)
    return f"is not a key of this section; did you mean {close[0]}?" if close else _REMEDY["extra_forbidden"]


def mistake(item: Any) -> str:
    """Return the mistake of an error's value, and the remedy."""
    kind, given = str(item["type"]), item["input"]
    context = item.get("ctx", {})
    if kind in _REMEDY:
        return _REMEDY[kind]
    if kind == "value_error":
        return str(item["msg"]).removeprefix("Value error, ")
    if kind == "literal_error":
        return f"{shown(given)} is not known; use {context['expected']}"
    if kind == "union_tag_not_found":
        return f"{context['discriminator']} is missing; add it".replace("'", "")
    if kind == "union_tag_invalid":
        key = context["discriminator"].strip("'")
        return f"{key} {shown(given.get(key))} is not known; use {context['expected_tags']}"
    if kind in _BOUND:
        key, words = _BOUND[kind]
        return f"{words} {context[key]:g}, got {shown(given)}; correct it"
    if kind == "string_pattern_mismatch":
        letters = "letters a to z, digits and underscores" + (
            ", starting with a letter" if "A-Z" in context["pattern"] else ""
        )
        return f"{shown(given)} must be {letters}; rename it{_proposed(given)}"
    if kind == "string_too_long":
        return f"{shown(given)} has {len(given)} characters, at most {context['max_length']} are taken; shorten it"
    if kind in ("too_short", "too_long", "missing_argument"):
        least, most = context.get("min_length"), context.get("max_length")
        count = least if least is not None else most
        values = f"{count} value" + ("s" if count != 1 else "")
        bound = "at least " if kind == "too_short" else ""
        return f"must be a list of {bound}{values}, got {context.get('actual_length', shown(given))}; correct it"
    if kind in ("tuple_type", "list_type") and isinstance(given, dict) and item["loc"]:
        return f"is one table; begin each with [[{item['loc'][-1]}]]"
    needed = _NEEDED.get(kind.split("_")[0])
    if needed is None:
        return f"cannot be {shown(given)}; look the key up in docs/reference"
    return f"{needed}, got {shown(given)}; correct it"


def _proposed(given: Any) -> str:
    """Return a name in the letters a to z in place of one with others, as the end of a sentence, or ""."""
    if not isinstance(given, str) or given.isascii():
        return ""
    name = re.sub(r"[^A-Za-z0-9_]+", "_", in_ascii(given)).strip("_")
    return f", for example to {name}" if name[:1].isalpha() else ""


def shown(value: Any) -> str:
    """Return a wrong value as a message shows it, cut where it is long."""
    if isinstance(value, dict):
        return "a table"
    try:
        text = repr(value)
    except ValueError:  # Python writes no whole number of thousands of digits
        return "a number that is too long"
    return text if len(text) <= _LONGEST_SHOWN else text[: _LONGEST_SHOWN - 3] + "..."
