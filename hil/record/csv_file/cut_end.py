"""End of a text file that was cut off inside its last number, as by a copy of a file that is still written."""

from __future__ import annotations

import re
from typing import Any, Literal

from hil.record.values import trimmed

_NUMBER = re.compile(r"[+-]?\d*(?:[.,](?P<decimals>\d*))?(?:[eE][+-]?(?P<power>\d*))?", re.ASCII)
LEAST_ROWS = 9
"""Fewest other cells that show how a column is written: a writer that leaves zeros out varies within ten cells."""


def ends_cut(cells: Any) -> Literal["cut", "doubtful", ""]:
    """Return "cut" for a last cell with fewer decimals, or digits of its power, than all others of its column have.

    "doubtful" is a last whole number with fewer digits than all others, which may be right. `cells` (n,) are text, as
    the file has them; the caller has seen that no line end follows the last.
    """
    text = trimmed(cells)
    if text is None or len(text) < 2 or not text[-1].is_valid:
        return ""
    last = _NUMBER.fullmatch(text[-1].as_py())
    others = [cell for cell in text[:-1].to_pylist() if cell]
    found = [_NUMBER.fullmatch(cell) for cell in others]
    if last is None or len(others) < LEAST_ROWS or any(match is None for match in found):
        return ""
    for part in ("decimals", "power"):
        lengths = {len(match[part] or "") for match in found if match is not None}
        if len(lengths) == 1 and len(last[part] or "") < max(lengths):
            return "cut"
    whole = not any(match["decimals"] for match in found if match is not None) and not last["decimals"]
    return "doubtful" if whole and len(text[-1].as_py()) < min(map(len, others)) else ""
