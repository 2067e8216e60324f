"""Historians: stores of raw samples of tags, each with its quality, behind one protocol."""

from __future__ import annotations

from drivers.historian.protocol import HistorianError, HistorianStore, Samples
from drivers.historian.stores import open_store

__all__ = ["HistorianError", "HistorianStore", "Samples", "open_store"]
