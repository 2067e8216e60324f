"""Peers: other tools on the same windows. Each is imported on use, and skipped if it is not installed."""

from __future__ import annotations


class Absent(Exception):
    """Error of a peer that cannot take part; the message states the reason in one line."""
