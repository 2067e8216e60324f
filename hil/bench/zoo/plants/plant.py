"""A plant of the zoo: cells, thermometers, columns, and the data sheet that a lumped twin is made from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.bench.zoo.plants.cells import Array, CellNetwork, Drive, Modifier, simulate
from hil.bench.zoo.plants.parts import BuiltPart

ROOM_COLUMN = "T_ambient_C"
FAN_COLUMN = "fan_speed_pct"
WARM_UP_S, WARM_UP_STEP_S = 7200.0, 60.0
ROOM_SIGMA_K = 0.05
"""Noise of the room's thermometer, K."""


@dataclass(frozen=True)
class Thermometer:
    """Thermometer of a plant: its column, cell, time constant in s, and the node of a lumped twin that it is at."""

    column: str
    cell: int
    lag_s: float
    node: str


@dataclass(frozen=True)
class ZooPlant:
    """A random plant.

    Attributes
    ----------
    family, seed
        Where it comes from.
    network, parts
        Cells, and the parts they belong to.
    thermometers, sigma_K
        Thermometers and their noise.
    heat_columns, full_w
        Columns of heater power and their full power in W.
    pumps
        Column of each loop's pump.
    sheet
        Data sheet: nominal values, which differ from the plant's own.
    ballast, ballast_group
        Cell and group of a body that a fault may bring into contact.
    """

    family: str
    seed: int
    network: CellNetwork
    parts: tuple[BuiltPart, ...]
    thermometers: tuple[Thermometer, ...]
    sigma_K: float
    heat_columns: tuple[str, ...]
    full_w: Array
    pumps: tuple[str, ...]
    sheet: Mapping[str, Any]
    ballast: int
    ballast_group: int

    def part(self, name: str) -> BuiltPart:
        """Return a part by its name."""
        return next(b for b in self.parts if b.part.name == name)

    def run(
        self, drive: Drive, period_s: float, modifiers: tuple[Modifier, ...] = (), start: Array | None = None
    ) -> Array:
        """Return the temperatures (n, cells) degC of a record.

        It begins at `start` (cells,) degC, by default after the plant has warmed up for two hours with the first
        inputs and without modifiers; the ballast has the room's temperature.
        """
        if start is None:
            cold = np.full(len(self.network.capacity), float(drive.room[0]))
            warm = max(int(WARM_UP_S / WARM_UP_STEP_S), 2)
            first = Drive(*(np.repeat(np.asarray(x)[:1], warm, axis=0) for x in _fields(drive)))
            start = simulate(self.network, first, WARM_UP_STEP_S, cold).temperature[-1].copy()
            start[self.ballast] = float(drive.room[0])
        return simulate(self.network, drive, period_s, start, modifiers).temperature

    def readings(self, temperature: Array, period_s: float) -> dict[str, Array]:
        """Return what the thermometers show without noise: first-order lags, exact for held temperatures."""
        from scipy.signal import lfilter, lfiltic

        shown: dict[str, Array] = {}
        for t in self.thermometers:
            seen = temperature[:, t.cell]
            a = float(np.exp(-period_s / max(t.lag_s, 1e-9)))
            b, c = [1.0 - a], [1.0, -a]
            shown[t.column] = lfilter(b, c, seen, zi=lfiltic(b, c, [seen[0]]))[0]
        return shown

    def columns(self, drive: Drive) -> dict[str, Array]:
        """Return the input columns that a faultless rig records, without noise."""
        found = {column: drive.heat[:, k].copy() for k, column in enumerate(self.heat_columns)}
        found |= {column: 100.0 * drive.pump[:, k] for k, column in enumerate(self.pumps)}
        found[FAN_COLUMN] = 100.0 * drive.fan
        found[ROOM_COLUMN] = drive.room.copy()
        return found


def _fields(drive: Drive) -> tuple[Array, ...]:
    return (drive.pump, drive.fan, drive.heat, drive.room, drive.humidity, drive.flow_noise, drive.fan_noise)
