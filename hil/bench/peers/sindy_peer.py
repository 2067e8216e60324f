"""Discrepancy model of pysindy on the same data: the heat that a twin does not account for, node by node.

What the readings ask for, C dT/dt less the heat that the twin's own elements bring at the temperatures that were
measured, is regressed sparsely on a constant, time, the temperature's distance to the room and the inputs
(Kaheman et al., arXiv 1909.08574). Terms count from the largest contribution that the healthy record shows.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pysindy

from twin import Array, Network
from twin.discovery.effects.formulas import Formulas
from twin.discovery.effects.laws import temperatures
from twin.discovery.effects.probe import FreeRun
from twin.discovery.records.grid import Grid

MEAN_S = 300.0
THRESHOLD_W = 2.0
_KINDS = {
    "constant": "heat_source",
    "elapsed_time": "heat_source",
    "temperature_difference": "heat_loss",
    "heater_power": "heat_source",
    "pump_speed": "heat_source",
    "fan_speed": "heat_source",
}


def contributions(network: Network, grid: Grid, run: FreeRun) -> list[dict[str, Any]]:
    """Return terms by falling contribution, W: `kind`, `where`, `driver`, and `z`, which is the contribution itself."""
    every = max(round(MEAN_S / grid.step_s), 1)
    known = temperatures(network, grid, run)
    heat = Formulas(network).heats(known, grid.inputs, network.values, grid.step_s)
    count = len(known) // every

    def means(values: Array) -> Array:
        return values[: count * every].reshape(count, every, -1).mean(axis=1)

    warm, bring, inputs = means(known), means(heat), means(grid.inputs)
    rate = np.gradient(warm, MEAN_S, axis=0)
    names = [*network.input_columns]
    room = inputs[:, names.index("T_ambient_C")]
    found = []
    for k, node in enumerate(network.nodes):
        capacity = network.parameters[f"{node}.capacitance"].value
        missing = (capacity * rate[:, k] - bring[:, k])[:, None]
        features = np.column_stack(
            [
                np.linspace(0.0, 1.0, count),
                warm[:, k] - room,
                *(inputs[:, names.index(c)] for c in ("heater_power_W", "pump_speed_pct", "fan_speed_pct")),
            ]
        )
        spread = features.std(axis=0)
        scaled = (features - features.mean(axis=0)) / np.where(spread > 0.0, spread, 1.0)
        model = pysindy.SINDy(
            optimizer=pysindy.STLSQ(threshold=THRESHOLD_W, alpha=1e-3),
            feature_library=pysindy.PolynomialLibrary(degree=1),
        )
        # The state is not to be predicted from itself alone: its own heat is the target, the rest are inputs.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # An empty result is an answer, too.
            model.fit(scaled[:, :1], t=MEAN_S, x_dot=missing, u=scaled[:, 1:])
        drivers = ("constant", "elapsed_time", "temperature_difference", "heater_power", "pump_speed", "fan_speed")
        for driver, size in zip(drivers, model.coefficients()[0], strict=True):
            found.append({"kind": _KINDS[driver], "where": node, "driver": driver, "z": abs(float(size))})
    return sorted(found, key=lambda row: -row["z"])
