"""Signals of a rig in the order of the journal's columns."""

from __future__ import annotations

from drivers.rig import RigConnection
from drivers.rig_file import Rig
from drivers.signals import Signal


def signals_of(rig: Rig) -> tuple[Signal, ...]:
    """Return the signals that are polled, then those that are commanded."""
    return RigConnection(rig, lambda: 0.0).signals + tuple(point.as_signal() for point in rig.setpoints)
