"""JSON text from untrusted sources."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

MOST_DEPTH = 100
"""Most lists and objects within each other: files of this program have six. Readers that descend call themselves."""


def parse_json(text: str | bytes) -> Any:
    """Return the document of a JSON text, in UTF-8 where it is bytes.

    Raises
    ------
    ValueError
        It is no JSON, not UTF-8, nested too deeply, or holds a number of thousands of digits.
    """
    try:
        document = json.loads(text)
    except RecursionError:
        raise ValueError(_TOO_DEEP) from None
    level, depth = [document], 0
    while level := [one for part in level if isinstance(part, dict | list) for one in _parts(part)]:
        depth += 1
        if depth > MOST_DEPTH:
            raise ValueError(_TOO_DEEP)
    return document


_TOO_DEEP = "it is nested too deeply"


def _parts(part: dict[str, Any] | list[Any]) -> Iterable[Any]:
    return part.values() if isinstance(part, dict) else part


__all__ = ["parse_json"]
