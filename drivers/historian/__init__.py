"""Historians: stores of raw samples of tags, each with its quality, behind one protocol."""

from __future__ import annotations

from drivers.historian.protocol import (
    BAD,
    GOOD,
    UNCERTAIN,
    HistorianAwayError,
    HistorianError,
    HistorianFailedError,
    HistorianStore,
    Samples,
)
from drivers.historian.server import index_by_time, without_password
from drivers.historian.stores import open_store
from drivers.historian.write_errors import why_unwritten

__all__ = [
    "BAD",
    "GOOD",
    "UNCERTAIN",
    "HistorianAwayError",
    "HistorianError",
    "HistorianFailedError",
    "HistorianStore",
    "Samples",
    "index_by_time",
    "open_store",
    "why_unwritten",
    "without_password",
]
