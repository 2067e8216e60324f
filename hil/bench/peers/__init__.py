"""Other people's tools on the same windows. Each is imported when it is used, and skipped where it is absent."""

from __future__ import annotations


class Absent(Exception):
    """A peer cannot take part here; the message says why in one line."""
