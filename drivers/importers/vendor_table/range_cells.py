"""Ranges in one cell of a register table, `0..1000`, and raw ranges with the values of their ends behind them."""

from __future__ import annotations

import re

_END = r"[-+]?\d+(?:[.,]\d+)?(?:[eE][-+]?\d+)?"
_ENDS = re.compile(rf"[\[(]?\s*({_END})\s*(?:\.\.+|…|to|bis|à|-|–|—|;|~|/)\s*({_END})\s*[\])]?")
_PAIR = re.compile(r"(?P<raw>[^=→≙>]+?)\s*[(\[]?\s*(?:=|≙|→|->)\s*(?P<value>[^=→≙>]*\d)\s*[^\d]*")


def ends_in(cell: str) -> tuple[str, str] | None:
    """Return the two ends of a range in one cell, as written; None for any other text."""
    found = _ENDS.fullmatch(cell.strip())
    return None if found is None else (found[1], found[2])


def pair_in(cell: str) -> tuple[tuple[str, str], tuple[str, str]] | None:
    """Return the ends of a raw range and their values, as written, of a cell such as `-400..1200 (=-40.0..120.0)`.

    None for any other text.
    """
    found = _PAIR.fullmatch(cell.strip())
    if found is None:
        return None
    raw, value = ends_in(found["raw"].rstrip("-")), ends_in(found["value"])
    return None if raw is None or value is None else (raw, value)
