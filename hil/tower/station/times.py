"""Times in ISO 8601, as files of a tower have them."""

from __future__ import annotations

import datetime

FIRST_S, LAST_S = 0.0, 2.0**63 / 1e9
"""Seconds since 1970 from which historians count, and up to which a time stamp in 64-bit nanoseconds reaches."""


def iso(time_s: float) -> str:
    """Return a time as ISO 8601 in UTC, to the second."""
    return datetime.datetime.fromtimestamp(time_s, datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def seconds(text: str) -> float:
    """Return a time in ISO 8601 as seconds since 1970; without an offset it is UTC.

    Raises
    ------
    ValueError
        It is no time, or lies before 1970 or after 2262.
    """
    found = datetime.datetime.fromisoformat(text.strip().replace("Z", "+00:00"))
    time_s = (found if found.tzinfo else found.replace(tzinfo=datetime.UTC)).timestamp()
    if not FIRST_S <= time_s <= LAST_S:
        raise ValueError(f"{text!r} is not between 1970 and 2262")
    return time_s
