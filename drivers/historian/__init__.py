"""Historians: stores of raw samples of tags, each with its quality, behind one protocol."""

from __future__ import annotations

from drivers.historian.protocol import BAD, GOOD, UNCERTAIN, HistorianError, HistorianStore, Samples
from drivers.historian.server import index_by_time, without_password
from drivers.historian.stores import open_store

__all__ = [
    "BAD",
    "GOOD",
    "UNCERTAIN",
    "HistorianError",
    "HistorianStore",
    "Samples",
    "index_by_time",
    "open_store",
    "without_password",
]
