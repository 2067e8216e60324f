"""Historians: stores of raw samples of tags, each with its quality, behind one protocol."""

from __future__ import annotations

from drivers.historian.protocol import BAD, GOOD, UNCERTAIN, HistorianError, HistorianStore, Samples
from drivers.historian.stores import open_store

__all__ = ["BAD", "GOOD", "UNCERTAIN", "HistorianError", "HistorianStore", "Samples", "open_store"]
