"""Laws of the candidates: heat into nodes, or a reading error, at size 1 and the measured temperatures.

Evaluation on measured temperatures makes a law linear in its size and independent of the twin's error; nodes without a
sensor take the twin's temperatures.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from twin.discovery.effects.catalogue import catalogue, extended, sized
from twin.discovery.effects.formulas import Formulas, follow
from twin.discovery.effects.probe import FreeRun
from twin.discovery.records.grid import Grid, filled
from twin.elements.candidates import Candidate
from twin.elements.flow import Flow
from twin.elements.law_reading import LawReading
from twin.network import Array, Network

LEAST_W = 1e-9
"""Largest heat of a law at its typical size, W, below which it acts on nothing in a record: rounding."""
SMOOTH_S = 3600.0
"""Time over which the residual at a sensor is smoothed before it corrects a simulated temperature, s."""
BESIDE_K = 2.5
"""Distance of the level at which a thermometer sticks from temperatures that its place has had, K: effects that the
twin lacks move them. A judgement."""


@dataclass(frozen=True, eq=False)
class CandidateLaw:
    """Candidate at size 1: `heat` (n, k) W into nodes and `reading` (n, m) K onto sensors; None where it has none."""

    candidate: Candidate
    heat: Array | None
    reading: Array | None


def circuit_of(network: Network, candidate: Candidate) -> str:
    """Return the element whose whole flow a candidate changes by a constant share, or "" if it is another effect."""
    if (candidate.kind, candidate.driver) != ("flow", "constant") or len(candidate.changes) != 1:
        return ""
    ((key, _),) = candidate.changes.items()
    element, parameter = key.split(".")
    named = parameter == "factor" and any(e.name == element for e in network.elements if isinstance(e, Flow))
    return element if named else ""


def temperatures(network: Network, grid: Grid, run: FreeRun) -> Array:
    """Return node temperatures (n, k), degC: measured where a sensor is, with gaps closed; simulated elsewhere."""
    from scipy.ndimage import uniform_filter1d

    known = run.temperatures.copy()
    window = max(round(SMOOTH_S / grid.step_s), 1)
    for j, sensor in enumerate(network.sensors):
        k = network.nodes.index(sensor.node)
        off = (grid.measured[:, j] - run.readings[:, j])[:, None]
        slow = uniform_filter1d(filled(off, np.isfinite(off))[:, 0], window, mode="nearest")
        known[:, k] = run.temperatures[:, k] + slow
    return known


class Book:
    """Candidates of a network with their formulas, which are made once for all records.

    Args:
        late_at_once: whether lags and delays may be present from the record's beginning. Only a healthy record shows
            how much of one is model error of mixed volumes; without it a lag is considered only from a later onset.

    Attributes:
        candidates: all but those of `put_in`, other forms of some of them with an initial temperature of their own, and
            those of `events`, which are always transient.
    """

    def __init__(self, network: Network, late_at_once: bool = True) -> None:
        self.network = network
        self._late_at_once = late_at_once
        every = tuple(self._as_told(c) for c in catalogue(network))
        self.candidates = tuple(c for c in every if not c.begins and not c.is_event)
        self.events = tuple(c for c in every if c.is_event)
        self.put_in = tuple(c for c in every if c.begins)
        self._base = Formulas(network)
        self._made: dict[str, Formulas] = {}
        self._steps: dict[int, tuple[Network, float, Network, Formulas]] = {}
        self._held: tuple[Grid, FreeRun, Array, Array] | None = None

    def _as_told(self, candidate: Candidate) -> Candidate:
        return candidate if self._late_at_once or not candidate.lumped else replace(candidate, lumped=math.inf)

    def _formulas(self, candidate: Candidate, changed: Network) -> Formulas:
        """Return the formulas of the network with a candidate; candidates with the same elements share them."""
        # What an element remembers is left out of the text where it is neutral, so it matters which of its parameters
        # are not.
        own = {*candidate.adds, *(name.split(".")[0] for name in candidate.changes)}
        mine = [p.id for p in changed.parameters.values() if p.element in own and p.value not in (0.0, 1.0)]
        before = [
            name for name in mine if name in self.network.ids and self.network.parameters[name].value not in (0.0, 1.0)
        ]
        if not candidate.adds and not candidate.replaces and mine == before:
            return self._base
        key = repr((sorted(candidate.adds.items()), sorted(candidate.replaces.items()), mine))
        if key not in self._made:
            self._made[key] = Formulas(changed)
        return self._made[key]

    def _stepped(self, candidate: Candidate) -> tuple[Network, float, Network, Formulas]:
        """Return the network with a candidate, a step of its size, the network after that step and its formulas."""
        known = self._steps.get(id(candidate))
        if known is not None:
            return known
        bigger = extended(self.network, candidate)
        step = candidate.typical if candidate.typical <= candidate.upper else -candidate.typical
        changed = bigger.with_values(sized(bigger, candidate, step))
        made = bigger, step, changed, self._formulas(candidate, changed)
        if any(candidate is own for own in (*self.candidates, *self.events)):  # which live as long as the book does
            self._steps[id(candidate)] = made
        return made

    def _at(self, grid: Grid, run: FreeRun) -> tuple[Array, Array]:
        """Return temperatures (n, k), degC, that laws are evaluated at, and the network's own heats (n, k), W.

        They are cached, since searches ask for a few laws of one record repeatedly.
        """
        held = self._held
        if held is None or held[0] is not grid or held[1] is not run:
            known = temperatures(self.network, grid, run)
            base = self._base.heats(known, grid.inputs, self.network.values, grid.step_s)
            held = self._held = grid, run, known, base
        return held[2], held[3]

    def heat_of_earlier_input(self, grid: Grid, run: FreeRun, column: int) -> Array:
        """Return the heat (n, k), W, beyond the network's own if an input had its next bin's value in each bin."""
        known, base = self._at(grid, run)
        inputs = grid.inputs.copy()
        inputs[:-1, column] = inputs[1:, column]
        heat: Array = self._base.heats(known, inputs, self.network.values, grid.step_s) - base
        return heat

    def laws(self, grid: Grid, run: FreeRun, only: tuple[Candidate, ...] | None = None) -> list[CandidateLaw]:
        """Return the laws of the candidates that have an effect on this record; `only` of some of them."""
        network = self.network
        known, base = self._at(grid, run)
        found = []
        for candidate in self.candidates if only is None else map(self._as_told, only):
            if _is_of_reading(network, candidate):
                law = CandidateLaw(candidate, None, _reading(network, candidate, grid, run))
            elif candidate.begins:
                law = CandidateLaw(candidate, _put_in(network, candidate, grid, known), None)
            elif candidate.kind == "delay":
                law = CandidateLaw(candidate, _delay(network, self._base, candidate, grid, known, base), None)
            else:
                bigger, step, changed, formulas = self._stepped(candidate)
                heat = formulas.heats(known, grid.inputs, changed.values, grid.step_s)
                heat -= _taken_up(bigger, changed, known, grid.step_s)
                law = CandidateLaw(candidate, (heat - base) / step, None)
            size = law.heat if law.heat is not None else law.reading
            if size is not None and np.isfinite(size).all() and float(np.abs(size).max()) * candidate.typical > LEAST_W:
                found.append(law)
        return found


def _taken_up(network: Network, changed: Network, known: Array, step_s: float) -> Array:
    """Return the heat (n, k), W, that volumes of changed thermal mass store beyond that of the original ones.

    Args:
        known: (n, k) degC, means over bins, so that a rise between two of them happened about the beginning of one.
    """
    at = network.index([f"{node}.capacitance" for node in network.nodes])
    more = changed.values[at] - network.values[at]
    heat = np.zeros_like(known)
    for k in np.flatnonzero(more):
        heat[:, k] = more[k] * np.diff(known[:, k], prepend=known[0, k]) / step_s
    return heat


def _put_in(network: Network, candidate: Candidate, grid: Grid, known: Array) -> Array:
    """Return the heat into a node, for 1 W/K, of a mass put in at the temperature of an input, while it warms up."""
    heat = np.zeros_like(known)
    (table,) = candidate.adds.values()
    k = network.nodes.index(table["node"])
    heat[:, k] = grid.inputs[:, network.input_columns.index(candidate.begins)] - known[:, k]
    return heat


def _reading(network: Network, candidate: Candidate, grid: Grid, run: FreeRun) -> Array:
    """Return the change of the readings (n, m) for a unit of a parameter of one sensor, or of several equal ones."""
    out = np.zeros((len(grid.time), len(network.sensors)))
    for name, weight in candidate.changes.items():
        element, parameter = name.split(".")
        if element not in network.sensor_names:
            sensor, node = _read_by_law(network, candidate, element)
            seen = run.temperatures[:, network.nodes.index(node)] if node else 1.0
            out[:, network.sensor_names.index(sensor)] += weight * seen
            continue
        j = network.sensor_names.index(element)
        seen = run.temperatures[:, network.nodes.index(network.sensors[j].node)]
        if parameter == "bias_K":
            out[:, j] += weight
        elif parameter == "gain":
            out[:, j] += weight * seen
        elif parameter == "lag_s":
            size = candidate.typical
            out[:, j] += weight * (follow(seen, size, grid.step_s) - seen) / size
        elif parameter == "cross_talk":
            other = candidate.replaces[element]["other"] if candidate.replaces else network.sensors[j].other
            out[:, j] += weight * (run.temperatures[:, network.nodes.index(other)] - seen)
    if candidate.adds and not _has_been_there(out):
        out[:] = 0.0
    return out


def _is_of_reading(network: Network, candidate: Candidate) -> bool:
    """Return True for an error of sensors alone; that of an input's thermometer acts wherever the input does."""
    reading = {e.name for e in network.elements if isinstance(e, LawReading)} | set(network.sensor_names)
    reading |= {name for name, table in candidate.adds.items() if table["kind"] == "law_reading"}
    return candidate.kind == "sensor" and {name.split(".")[0] for name in candidate.changes} <= reading


def _read_by_law(network: Network, candidate: Candidate, element: str) -> tuple[str, str]:
    """Return the sensor of a law of a reading, new or of the network, and the node that it follows, or ""."""
    if element in candidate.adds:
        table = candidate.adds[element]
        return str(table["sensor"]), str(table.get("of", ""))
    law = next(e for e in network.elements if isinstance(e, LawReading) and e.name == element)
    return law.sensor, law.of


def _has_been_there(off: Array) -> bool:
    """Return True if thermometers have been at the level at which they stick, or next to it, from `off` (n, m), K."""
    own = off[:, off.any(axis=0)]
    return own.size > 0 and float(own.min()) < BESIDE_K and float(own.max()) > -BESIDE_K


def _delay(network: Network, formulas: Formulas, candidate: Candidate, grid: Grid, known: Array, base: Array) -> Array:
    """Return the heat that a further volume of pipe delays: that of the water that entered one transport delay
    before.
    """
    (name, _), *_ = candidate.changes.items()
    pipe = name.split(".")[0]
    node = candidate.adds[pipe]["to"] if candidate.adds else next(e for e in network.elements if e.name == pipe).to  # type: ignore[attr-defined]
    flow = next(e for e in network.elements if isinstance(e, Flow) and node in e.path)
    before = flow.feeds()[node]
    values = network.parameters
    rate = values[f"{flow.name}.nominal"].value * values[f"{flow.name}.factor"].value / 60.0
    litres = rate * np.maximum(grid.inputs[:, network.input_columns.index(flow.pump)], 0.0) * 0.01
    passed = np.concatenate([[0.0], np.cumsum(litres * grid.step_s)])[:-1]
    if not before and not flow.inlet:
        return np.zeros_like(known)
    size = candidate.typical
    when = np.interp(passed - size, passed + 1e-9 * np.arange(len(passed)), grid.time)
    late, inputs = known.copy(), grid.inputs.copy()
    if before:
        k = network.nodes.index(before)
        late[:, k] = np.interp(when, grid.time, known[:, k])
    else:
        k = network.input_columns.index(flow.inlet)
        inputs[:, k] = np.interp(when, grid.time, inputs[:, k])
    heat = (formulas.heats(late, inputs, network.values, grid.step_s) - base) / size
    if before:
        heat[:, k] = 0.0
    if f"{node}.capacitance" in candidate.changes:
        # Water that passes unmixed is no longer warmed and cooled with the volume.
        n = network.nodes.index(node)
        heat[:, n] -= candidate.changes[f"{node}.capacitance"] * np.gradient(known[:, n], grid.step_s)
    return heat
