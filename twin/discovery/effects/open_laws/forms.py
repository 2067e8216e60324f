"""Forms of open laws: values that follow an input of a record or the temperature of a node, one for a unit of strength.

A law that follows the temperature of a node is evaluated on measured temperatures.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from twin.discovery.records.grid import Grid
from twin.elements.base import STAMP
from twin.laws import law_values
from twin.network import Array, Network

MOST_LEVELS = 8
"""Distinct levels of a column up to which a threshold is tried between each two; with more, at quartiles."""
LAGS_S = (900.0, 3600.0)
"""Time constants with which an effect may follow its driver, s: those of a volume and of a room."""
LEAST_SPREAD = 1.0e-3
"""Least standard deviation of a driver, as a share of its largest magnitude."""
NAMES = {"heater_power_W": "heater_power", "pump_speed_pct": "pump_speed", "fan_speed_pct": "fan_speed"}


@dataclass(frozen=True)
class Values:
    """Values of one form for a driver, at strength 1.

    Attributes:
        driver: in the vocabulary of the diagnosis. form, parameters: as in `twin.elements.law_forms`, at strength 1.
        column: index of the driving input, or None. scale: largest magnitude of the values.
        says: the driver in words. of: node whose temperature is the driver instead of an input, or "".
    """

    driver: str
    form: str
    parameters: Mapping[str, float]
    column: int | None
    scale: float
    says: str
    of: str = ""

    def at(self, time_s: Array, inputs: Array) -> Array:
        """Return the values (n,) for stamps (n,) s and inputs (n, c)."""
        x = None if self.column is None else inputs[:, self.column]
        return law_values(self.form, "always", self.parameters, x, time_s)


def values_of(network: Network, grid: Grid) -> Iterator[Values]:
    """Yield the forms that an effect may have as a function of the inputs of a record."""
    for j, column in enumerate(network.input_columns):
        x = grid.inputs[:, j]
        spread, largest = float(np.std(x)), float(np.abs(x).max())
        if column.startswith("time_of_day") or column == STAMP or spread <= LEAST_SPREAD * max(largest, 1e-9):
            continue
        stem, _, unit = column.rpartition("_")
        driver = NAMES.get(column, "temperature" if unit == "C" else stem or column)
        spoken = (stem or column).replace("_", " ")
        of = partial(Values, driver, column=j)
        low, high = float(x.min()), float(x.max())
        references = (low, high, float(np.median(x))) if unit == "C" else (0.0,)
        for reference in references:
            scale = float(np.abs(x - reference).max())
            above = f" above {reference:.4g}" if reference else ""
            yield of(
                "linear",
                parameters={"gain": 1.0, "reference": reference},
                scale=scale,
                says=f"in proportion to {spoken}{above}",
            )
        if unit == "pct":
            yield of(
                "power",
                parameters={"size": 1.0, "reference": 0.0, "scale": 100.0, "exponent": 2.0},
                scale=1.0,
                says=f"with the square of {spoken}",
            )
        for lag in LAGS_S:
            reference = references[-1] if unit == "C" else 0.0
            scale = float(np.abs(x - reference).max())
            yield of(
                "memory",
                parameters={"gain": 1.0, "reference": reference, "lag_s": lag},
                scale=scale,
                says=f"following {spoken} within {lag / 60:.0f} min",
            )
        for level in _levels(x):
            yield of(
                "threshold",
                parameters={"size": 1.0, "on": level, "off": level},
                scale=1.0,
                says=f"while {spoken} is above {level:.4g}",
            )


def _levels(x: Array) -> list[float]:
    levels = np.unique(np.round(x, 6))
    if len(levels) <= MOST_LEVELS:
        return [float(v) for v in 0.5 * (levels[1:] + levels[:-1])]
    return [float(v) for v in np.unique(np.quantile(x, (0.25, 0.5, 0.75)))]


def values_of_nodes(network: Network, known: Array) -> Iterator[Values]:
    """Yield the forms that an effect may have as a function of the temperatures that are read."""
    for node in dict.fromkeys(s.node for s in network.sensors):
        x = known[:, network.nodes.index(node)]
        low, middle, high = (float(v) for v in np.quantile(x, (0.25, 0.5, 0.75)))
        if not high - low > LEAST_SPREAD * max(abs(high), 1.0e-9):
            continue
        scale = float(np.abs(x - middle).max())
        at = f"the temperature of {node}"
        linear = {"gain": 1.0, "reference": middle}
        yield Values(
            "temperature", "linear", linear, None, scale, f"in proportion to {at} above {middle:.4g} degC", node
        )
        for level in (low, middle, high):
            switched = {"size": 1.0, "on": level, "off": level}
            yield Values("temperature", "threshold", switched, None, 1.0, f"while {at} is above {level:.4g} degC", node)


def course_of_node(network: Network, values: Values, known: Array) -> Array:
    """Return the values (n,) of a form that follows a node, for temperatures `known` (n, k) of the nodes, degC."""
    x = known[:, network.nodes.index(values.of)]
    # Neither form depends on the length of a sample.
    return law_values(values.form, "always", values.parameters, x, np.arange(float(len(x))))
