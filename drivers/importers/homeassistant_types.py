"""Data types of Home Assistant's Modbus sensors, as keys of a rig file's point."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from drivers.importers.draft import Collector, ImportFileError, number, whole
from drivers.rig_file import shown
from drivers.signals import WIDTH

_TYPES = ("int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64", "string", "custom")
_OLD = {"int": "int", "uint": "uint", "float": "float"}
"""Types without a size, of older configurations: `count` registers hold them."""
_ORDERS = {"none": "ABCD", "byte": "BADC", "word": "CDAB", "word_byte": "DCBA"}
_STRUCTURES = {
    "h": "int16",
    "H": "uint16",
    "i": "int32",
    "I": "uint32",
    "l": "int32",
    "L": "uint32",
    "q": "int64",
    "Q": "uint64",
    "f": "float32",
    "d": "float64",
}
"""Letters of Python's struct module, with standard sizes as after `>` or `!`."""


def typed(path: Path, collector: Collector, name: str, line: int, plain: Callable[..., Any]) -> dict[str, Any]:
    """Return type, order, scale, offset and what a value may be of the sensor whose keys `plain` reads.

    Raises ImportFileError of what a rig file cannot hold.
    """
    kind, count = _kind(path, line, plain)
    order = _order(path, line, plain)
    keys: dict[str, Any] = {"type": kind}
    if kind == "string":
        keys["length"] = whole(path, line, "count", count or 0, 1, 125)
        return keys | {"kind": "status"} | ({"order": order} if order != "ABCD" else {})
    if count is not None and count != WIDTH[kind]:
        raise ImportFileError(path, line, f"{kind} takes {WIDTH[kind]} registers and count is {count}; correct one")
    if order != "ABCD":
        keys["order"] = order
    for key, neutral in (("scale", 1.0), ("offset", 0.0)):
        value = number(path, line, key, plain(key, neutral))
        if value != neutral:
            keys[key] = value
    sentinel = plain("nan_value")
    if sentinel is not None:
        text = str(sentinel)
        given = int(text, 16) if re.fullmatch(r"0[xX][0-9a-fA-F]{1,16}", text) else sentinel
        keys["invalid"] = [number(path, line, "nan_value", given)]
    low, high = plain("min_value"), plain("max_value")
    if low is not None and high is not None:
        keys["plausible"] = [number(path, line, "min_value", low), number(path, line, "max_value", high)]
    elif low is not None or high is not None:
        collector.note(line, f"{name}: min_value or max_value alone is not taken over; give plausible = [low, high]")
    return keys


def _kind(path: Path, line: int, plain: Callable[..., Any]) -> tuple[str, int | None]:
    """Return the rig file's type, and the number of registers that the entry gives."""
    kind, given = plain("data_type", "int16"), plain("count")
    count = None if given is None else whole(path, line, "count", given, 0, 125)
    structure = plain("structure")
    if isinstance(kind, str) and kind in _OLD:
        bits = 16 * (count or (2 if kind == "float" else 1))
        kind = f"{_OLD[kind]}{bits}"
        if kind == "float32" and count is None:
            raise ImportFileError(path, line, "data_type float has no size; write float32 or float64")
    if not isinstance(kind, str) or kind not in _TYPES:
        known = ", ".join(_TYPES)
        raise ImportFileError(path, line, f"data_type {shown(kind)} is not known; use {known}, or leave it out")
    if kind != "custom":
        if structure is not None:
            raise ImportFileError(path, line, f"structure goes with data_type custom, not with {kind}; take one out")
        return kind, count
    found = re.fullmatch(r"[>!](?:1)?([hHiIlLqQfd])", structure) if isinstance(structure, str) else None
    if found is None:
        raise ImportFileError(
            path, line, f"structure {shown(structure)} is not one number of registers; write an entry for each number"
        )
    return _STRUCTURES[found[1]], count


def _order(path: Path, line: int, plain: Callable[..., Any]) -> str:
    swap, reverse = plain("swap", "none"), plain("reverse_order", False)
    order = _ORDERS.get(swap) if isinstance(swap, str) else None
    if order is None:
        raise ImportFileError(path, line, f"swap {shown(swap)} is not known; use {', '.join(_ORDERS)}")
    if not isinstance(reverse, bool) or (reverse and order != "ABCD"):
        raise ImportFileError(path, line, "reverse_order stands for swap: word; take it out and give swap alone")
    return "CDAB" if reverse else order
