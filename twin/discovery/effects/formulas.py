"""Formulas of a network evaluated over arrays: heat into each node, W, and readings at given temperatures.

The source text of the kernels is evaluated by numpy at known (mostly measured) temperatures. This gives the power that
an effect adds to each node at each moment, without a simulation.
"""

from __future__ import annotations

import numpy as np

from twin.first_order_lag import recursion
from twin.kernel import define_functions, evaluate_formula
from twin.network import Array, Network
from twin.network.assembly import NetworkEquations
from twin.network.reference_source import python_source

ARRAYS = {"exp": np.exp, "log": np.log, "max": np.maximum, "min": np.minimum}
"""Array functions that replace those of numbers."""


class Formulas:
    """Evaluation of one network on arrays over n samples."""

    def __init__(self, network: Network) -> None:
        self.network = network
        # Whatever counts as neutral for the kernels must be in the text, since sizes are what is asked for.
        self._rhs = define_functions(python_source(network), f"<heats of {network.name}>", ARRAYS)["rhs"]
        self._capacity = network.index([f"{node}.capacitance" for node in network.nodes])
        remembering = tuple(
            p.id for p in network.parameters.values() if p.status != "fixed" or p.value not in (0.0, 1.0)
        )
        self.system = NetworkEquations(network, remembering)
        names = {name for name, f in self.system.parts if f.states}
        self._states = sum(len(f.states) for name, f in self.system.parts if name in names)

    def heats(self, temperatures: Array, inputs: Array, parameters: Array, step_s: float) -> Array:
        """Return the heat into each node (n, k), W; states of elements follow the temperatures.

        Args:
            temperatures: (n, k) degC. inputs: (n, c). parameters: (p,). step_s: between samples.
        """
        columns = list(temperatures.T)
        u = [self._driven(j, inputs[:, j], parameters, step_s) for j in range(inputs.shape[1])]
        if self._states:
            columns += self._remembered(columns, u, parameters, step_s)
        rates = self._rhs(columns, u, parameters)
        k = len(self.network.nodes)
        n = len(temperatures)
        capacity = parameters[self._capacity]
        return np.stack([np.broadcast_to(r, n) * c for r, c in zip(rates[:k], capacity, strict=True)], axis=1)

    def _driven(self, column: int, values: Array, parameters: Array, step_s: float) -> Array:
        """Return an input column after the dead time and the lag of its actuator; the gain is in the formulas."""
        for _, drive in self.system.drives:
            if self.network.input_columns.index(drive.column) != column:
                continue
            p = {f"p{k}": v for k, v in enumerate(parameters)}
            if drive.dead_time:
                late = min(round(evaluate_formula(drive.dead_time, p) / step_s), len(values))
                values = np.concatenate([np.full(late, values[0]), values[: len(values) - late]])
            if drive.lag:
                values = follow(values, evaluate_formula(drive.lag, p), step_s)
        return values

    def _remembered(self, columns: list[Array], u: list[Array], parameters: Array, step_s: float) -> list[Array]:
        """Return the trajectories of elements' own states, each a first-order lag of the temperatures."""
        n, k = len(columns[0]), len(columns)
        zero = [np.zeros(n)] * self._states
        one = [np.ones(n)] * self._states
        at0 = self._rhs(columns + zero, u, parameters)[k:]
        at1 = self._rhs(columns + one, u, parameters)[k:]
        found = []
        for a, b in zip(at0, at1, strict=True):
            speed = np.broadcast_to(np.maximum(np.asarray(a) - np.asarray(b), 0.0), n)
            target = np.where(speed > 0.0, np.broadcast_to(a, n) / np.maximum(speed, 1e-300), 0.0)
            found.append(_follow_varying(target, speed, step_s))
        return found


def follow(values: Array, constant_s: float, step_s: float) -> Array:
    """Return a first-order lag of `constant_s`, at steady state in the first sample; values are linear between
    samples.
    """
    if constant_s <= 0.0:
        return values
    kept = np.exp(-step_s / constant_s)
    # Exact for a straight line: how much of the step's end is in the answer, and how much of its beginning.
    new = 1.0 - (1.0 - kept) * constant_s / step_s
    old = 1.0 - kept - new
    terms = new * values
    terms[1:] += old * values[:-1]
    terms[0] = values[0]
    return recursion(terms, kept)


def _follow_varying(target: Array, speed: Array, step_s: float) -> Array:
    if np.ptp(speed) <= 1e-12 * max(float(speed.max()), 1e-300):
        return follow(target, 1.0 / speed[0], step_s) if speed[0] > 0.0 else np.full_like(target, target[0])
    out = np.empty_like(target)
    kept, state = np.exp(-speed * step_s), float(target[0])
    for i, (goal, stay) in enumerate(zip(target.tolist(), kept.tolist(), strict=True)):
        state = goal + (state - goal) * stay
        out[i] = state
    return out
