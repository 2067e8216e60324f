"""Twin as the plant behind served devices: its kernel, with the served set-points as inputs and the noise of its
sensors."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from drivers.rig_file import Rig
from drivers.signals import ConfigurationError, DriverError
from drivers.virtual.described import ConstantPlant
from twin import Array, Kernel, Network, TwinFileError, load, steady_state


class TwinPlant:
    """Plant that is a twin. What the twin does not know of the rig is as in `ConstantPlant`.

    An input of the twin is the set-point whose column, or whose read-back's column, it is; else it keeps its nominal
    value. The plant begins at rest with the first set-points.

    Parameters
    ----------
    rig, file
        The rig and its file.
    twin
        Twin file.
    seed
        Seed of the noise.

    Raises
    ------
    ConfigurationError
        No sensor of the twin is a point of the rig, or a point cannot be served.
    TwinFileError
        The twin file cannot be used.
    """

    def __init__(self, rig: Rig, file: Path, twin: Path, seed: int = 0) -> None:
        self.network: Network = load(twin)
        self._rest = ConstantPlant(rig, file, seed)
        self._random = np.random.default_rng(seed)
        self._kernel = Kernel(self.network, ())
        columns = {point.as_signal().column: point.name for point in rig.point if point.is_polled}
        self._driver = _drivers(rig, self.network)
        self._sensors = [
            (j, columns[column], float(self.network.sigma[j]) * np.sqrt(len(measured)))
            for j, measured in enumerate(self.network.sensor_columns.values())
            for column in measured
            if column in columns
        ]
        if not self._sensors:
            known = ", ".join(column for measured in self.network.sensor_columns.values() for column in measured)
            raise ConfigurationError(
                f"{twin}: no sensor of the twin ({known}) is a point of {rig.name}; give the points these names, or "
                "name another twin"
            )
        nominal = dict(zip(self.network.input_columns, self.network.nominal_inputs.tolist(), strict=True))
        for column, value in nominal.items():
            if column in columns and columns[column] in self._rest.at_rest:
                self._rest.at_rest[columns[column]] = value
        self._nominal = nominal
        self._state: Array | None = None
        self._time_s = 0.0

    @property
    def driven(self) -> tuple[str, ...]:
        """Names of the points that the twin simulates."""
        return tuple(name for _, name, _ in self._sensors)

    @property
    def constant(self) -> dict[str, float]:
        """Values of the points that neither the twin nor a set-point drives, by name."""
        driven = set(self.driven)
        return {name: value for name, value in self._rest.at_rest.items() if name not in driven}

    def step(self, outputs: Mapping[str, float], seconds: float) -> Mapping[str, float]:
        """Return the values of all polled numbers; raise DriverError where the twin does not stay finite."""
        found = dict(self._rest.step(outputs, seconds))
        inputs = np.array(
            [
                outputs[self._driver[column]] if column in self._driver else value
                for column, value in self._nominal.items()
            ]
        )
        if self._state is None:
            self._state = _start(self.network, inputs)
        time = np.array([self._time_s, self._time_s + seconds])
        readings, ends = self._kernel.trace(self.network.values, self._state, time, np.vstack([inputs, inputs]))
        last = readings[0, -1]
        if not np.isfinite(last).all():
            raise DriverError(
                f"twin {self.network.name!r} does not stay finite with {dict(outputs)}; correct its parameters"
            )
        self._state, self._time_s = ends[0], self._time_s + seconds
        for j, name, sigma in self._sensors:
            found[name] = float(last[j]) + sigma * float(self._random.standard_normal())
        return found


def _drivers(rig: Rig, network: Network) -> dict[str, str]:
    """Return the set-point that drives each input of the twin, by column; inputs without one are left out."""
    column_of = {point.name: point.as_signal().column for point in rig.point}
    found: dict[str, str] = {}
    for point in rig.setpoints:
        for name in (point.name, point.readback):
            if name is not None and column_of[name] in network.recorded_inputs:
                found[column_of[name]] = point.name
    return found


def _start(network: Network, inputs: Array) -> Array:
    """Return the temperatures at rest with `inputs`, else those of the room."""
    try:
        return steady_state(network, inputs)
    except TwinFileError:  # heat has no way out of it, for example
        return network.initial_state(np.full(len(network.instruments), np.nan))
