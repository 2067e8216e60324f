"""Rig: all buses of a rig file together.

The names below are the package's interface. Other modules are private to the package.
"""

from drivers.rig.connection import RigConnection, rig_signals
from drivers.rig.watch import BusWatch, PointState, RigWatch

__all__ = [
    "BusWatch",
    "PointState",
    "RigConnection",
    "RigWatch",
    "rig_signals",
]
