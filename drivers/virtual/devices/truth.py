"""True state of the virtual rig, recorded by the rig itself: a file of fixed-size records.

There is one record a period, and one whenever a write changes the set-point that reaches the heater. Tests of a harness
compare with this file, not with the harness's own record. Times are Unix times of this machine.
"""

from __future__ import annotations

import os
import struct
import time
from pathlib import Path
from typing import NamedTuple

from drivers.virtual.devices.registers import Registers
from drivers.virtual.plant import CHANNELS, SimulatedPlant

_RECORD = struct.Struct(f"<dddH5d{len(CHANNELS)}d")


class Moment(NamedTuple):
    """True state: `heater_W` is the set-point at the heater, `power_W` its power, `status` the PLC's bits."""

    wall_s: float
    rig_s: float
    heater_W: float
    status: int
    power_W: float
    flow_L_per_min: float
    pump_pct: float
    fan_pct: float
    ambient_C: float
    junctions_C: tuple[float, ...]


class TruthLog:
    """Writer of the file; unbuffered, so that it is whole whenever the rig is killed."""

    def __init__(self, path: Path, plant: SimulatedPlant) -> None:
        self._file = path.open("wb", buffering=0)
        self._plant = plant
        self._heater_W = -1.0

    def note(self, registers: Registers, *, period: bool) -> None:
        """Write a record at the end of a `period`, else only where the heater's set-point has changed."""
        heater_W = registers.heater_W
        if not period and heater_W == self._heater_W:
            return
        self._heater_W, plant = heater_W, self._plant
        self._file.write(
            _RECORD.pack(
                time.time(),
                plant.time_s,
                heater_W,
                registers.status,
                plant.heater_power_W,
                plant.flow_L_per_min,
                plant.pump_speed_pct,
                plant.fan_speed_pct,
                plant.ambient_C,
                *plant.junction.tolist(),
            )
        )

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def read_truth(path: Path) -> list[Moment]:
    """Return all whole records of a file, in their order; raise OSError."""
    data = path.read_bytes()
    whole = len(data) - len(data) % _RECORD.size
    return [Moment._make((*fields[:9], fields[9:])) for fields in _RECORD.iter_unpack(data[:whole])]


def last_moment(path: Path) -> Moment | None:
    """Return the last whole record of a file, None where there is none yet; raise OSError.

    Its cost does not grow with the file, as that of `read_truth` does.
    """
    with path.open("rb") as file:
        count = file.seek(0, os.SEEK_END) // _RECORD.size
        if count == 0:
            return None
        file.seek((count - 1) * _RECORD.size)
        fields = _RECORD.unpack(file.read(_RECORD.size))
    return Moment._make((*fields[:9], fields[9:]))
