"""TOML text of a user as tables, in bounded time and depth."""

from __future__ import annotations

import re
import tomllib
from typing import Any

MOST_PARTS = 50
"""Most parts of a dotted key: a twin or rig file has four, and the time of `tomllib` grows with their square."""
_PART = r"""(?:[A-Za-z0-9_-]++|"[^"\n]*+"|'[^'\n]*+')"""
_LONG_KEY = re.compile(rf"(?<![A-Za-z0-9_.-]){_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{MOST_PARTS},}}")


def parse_toml(text: str) -> dict[str, Any]:
    """Return the tables of a TOML text.

    Raises
    ------
    tomllib.TOMLDecodeError
        It is no TOML.
    ValueError
        A key has more than `MOST_PARTS` parts, a number is too long, or lists are too deep; the message states which.
    """
    if (key := _LONG_KEY.search(text)) is not None:
        line = text.count("\n", 0, key.start()) + 1
        raise ValueError(f"the key in line {line} has more than {MOST_PARTS} parts; correct it")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise
    except (ValueError, RecursionError):
        raise ValueError("it holds a number that is too long or lists that are too deep; correct it") from None


__all__ = ["MOST_PARTS", "parse_toml"]
