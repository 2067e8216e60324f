"""Probe of a twin: response of the readings to heat into any node at any time.

One kernel serves every hypothesis: the network with a heat source of any time course in every node and a reading of
every node. The heat of an effect (`formulas`) then gives its signature, so no kernel is compiled for a candidate before
it is fitted, and most candidates share one then (`shared_kernels`).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from twin.commissioning import INITIAL_SD_K
from twin.discovery.effects.shared_kernels import SharedKernels
from twin.discovery.records.grid import Grid, centred, filled
from twin.elements import Parameter
from twin.elements.base import Status
from twin.elements.heat_source import HeatSource
from twin.elements.sensor import Sensor
from twin.gauss_newton import FitData, GaussianPrior, Scaling, fit_initial_state
from twin.kernel import Kernel
from twin.network import Array, InputSpec, Network
from twin.segments import restarted_states, separate_columns, simulate_segments

FIRST_BINS = 6
"""Bins of a segment, a minute, whose readings give the first guess of its initial state."""
SETTLE_BINS = 90
"""Bins of a segment, a quarter of an hour, to whose readings its initial state is fitted."""
KEPT = 4
"""Results in the cache."""
_STEP = 1.0e-4
_STATE_STEP = 1.0e-2
_PROBE_W = 10.0
"""Steps of the lane differences: of z, of the state, K, and of heat, W. The response to heat is linear or nearly so."""
_LEAST_WAY = 1.0e-9
"""Least share of the greatest difference of a state that is kept."""


@dataclass(frozen=True)
class FreeRun:
    """Free run: `readings` (n, m) of the network's sensors at the mean times of the samples of the bins, and
    `temperatures` (n, k) of its nodes, as means over the bins; degC.
    """

    readings: Array
    temperatures: Array


class Probe:
    """Kernel of a network with a heat injection at every node.

    Args:
        tunables: parameters that a calibration may change, whose sensitivities are computed.
    """

    def __init__(self, network: Network, tunables: tuple[str, ...]) -> None:
        self.network = network
        self.scaling = Scaling.of(network, tunables)
        self.kernels = SharedKernels(network, tunables)
        self.columns = tuple(f"probe_{node}_W" for node in network.nodes)
        self.probed, self._gains, self._reads = _with_probes(network, self.columns)
        self._kernel = Kernel(self.probed, (*tunables, *self._gains))
        self._tunable = self.probed.index(tunables)
        self._gain = self.probed.index(self._gains)
        self.m, self.k, self.q = len(network.sensors), len(network.nodes), len(tunables)
        self._made: list[tuple[Grid, tuple[Hashable, ...], Array]] = []

    def values(self, values: Array | None = None) -> Array:
        """Return the full parameter vector of the probed network for values (p,) of the network."""
        full = self.probed.values.copy()
        if values is not None:
            full[self.probed.index(self.network.ids)] = values
        full[self._gain] = 1.0
        return full

    def _inputs(self, grid: Grid, injected: Array | None) -> Array:
        extra = np.zeros((len(grid.time), self.k)) if injected is None else injected
        return np.ascontiguousarray(np.hstack([grid.inputs, extra]))

    def first_state(self, grid: Grid, values: Array | None = None) -> Array:
        """Return the temperatures (s * k,), degC, at the beginning of each segment, fitted to its first quarter of an
        hour.
        """
        probed, inputs = self.probed_state(grid).reshape(-1, self.k), self._inputs(grid, None)
        sigma = np.concatenate([grid.sigma, np.ones(len(self.probed.sensors) - self.m)])
        found = []
        for state, segment in zip(probed, grid.segments, strict=True):
            rows = slice(segment.start, min(segment.start + SETTLE_BINS, segment.stop))
            measured = np.full((rows.stop - rows.start, len(sigma)), np.nan)
            measured[:, : self.m] = grid.measured[rows]
            good = np.isfinite(measured)
            weight = np.where(good, 1.0 / sigma, 0.0)
            data = FitData(grid.time[rows], inputs[rows], np.where(good, measured, 0.0), weight)
            found.append(fit_initial_state(self._kernel, self.values(values), state, data, 1.0)[: self.k])
        return np.concatenate(found)

    def probed_state(self, grid: Grid) -> Array:
        """Return node temperatures (s * k,), degC, from the first readings of each segment."""
        firsts = [slice(r.start, min(r.start + FIRST_BINS, r.stop)) for r in grid.segments]
        return np.concatenate([self.network.initial_state(grid.measured[rows]) for rows in firsts])

    def run(self, grid: Grid, state: Array, values: Array | None = None, injected: Array | None = None) -> FreeRun:
        """Simulate freely from `state` (s * k,), with heat `injected` (n, k) W on top of the network's own."""
        readings = self._traced(self.values(values)[None, :], state[None, :], grid, self._inputs(grid, injected))
        read, temperatures = readings[0, :, : self.m], readings[0][:, self._reads]
        return FreeRun(centred(read, grid.centre), centred(temperatures))

    def _traced(self, rows: Array, states: Array, grid: Grid, inputs: Array) -> Array:
        """Return the readings (P, n, m) with parameters `rows` (P, p), from `states` (P, s * k)."""
        return simulate_segments(self._kernel, rows, states, grid.time, inputs, grid.begins)

    def responses(self, grid: Grid, state: Array, injected: Array, values: Array | None = None) -> Array:
        """Return the change of the readings (n, m, j), K, for j courses of heat `injected` (n, k, j) W."""
        base = self.run(grid, state, values).readings
        found = [self.run(grid, state, values, injected[:, :, j]).readings - base for j in range(injected.shape[2])]
        return np.stack(found, axis=2) if found else np.empty((*base.shape, 0))

    def _kept(self, what: tuple[Hashable, ...], grid: Grid, make: Callable[[], Array]) -> Array:
        """Return a cached result for the same grid, or compute it: several score tests use one grid."""
        for other, known, made in self._made:
            if other is grid and known == what:
                return made
        made = make()
        self._made = [*self._made[1 - KEPT :], (grid, what, made)]
        return made

    def sensitivities(self, grid: Grid, state: Array, values: Array | None = None) -> Array:
        """Return d reading / d (tunables in z, initial temperatures of the segments): (n, m, q + s * k)."""
        what = ("sensitivities", state.tobytes(), None if values is None else values.tobytes())
        return self._kept(what, grid, lambda: self._sensitivities(grid, state, values))

    def _sensitivities(self, grid: Grid, state: Array, values: Array | None) -> Array:
        """Return the derivatives of `sensitivities`: lane differences by `_STEP` in z and `_STATE_STEP`, K."""
        centre = self.values(values)
        count = 1 + self.q + self.k
        rows, states = np.tile(centre, (count, 1)), np.tile(state, (count, 1)).reshape(count, -1, self.k)
        z = self.scaling.to_z(centre[self._tunable])
        upper = self.scaling.to_z(self.scaling.upper)
        steps = np.where(z + _STEP > upper, -_STEP, _STEP)
        for i in range(self.q):
            moved = z.copy()
            moved[i] += steps[i]
            rows[1 + i, self._tunable] = self.scaling.to_values(moved)
        states[1 + self.q :] += _STATE_STEP * np.eye(self.k)[:, None, :]
        readings = self._traced(rows, states.reshape(count, -1), grid, self._inputs(grid, None))
        scale = np.concatenate([steps, np.full(self.k, _STATE_STEP)])
        change: Array = (readings[1:, :, : self.m] - readings[0, :, : self.m]) / scale[:, None, None]
        slopes = np.moveaxis(change, 0, 2)
        states = separate_columns(slopes[..., self.q :], grid.begins)
        return centred(np.concatenate([slopes[..., : self.q], states], axis=2), grid.centre)

    def blocks(self, grid: Grid, state: Array, edges: np.ndarray, values: Array | None = None) -> Array:
        """Return the mean readings in each of b blocks for 1 W into one node during one block: (b, m, b, k) K/W.

        Args:
            edges: (b + 1,) bins at which blocks begin, the last one past the end.
        """
        what = ("blocks", state.tobytes(), edges.tobytes(), None if values is None else values.tobytes())
        return self._kept(what, grid, lambda: self._blocks(grid, state, edges, values))

    def _blocks(self, grid: Grid, state: Array, edges: np.ndarray, values: Array | None) -> Array:
        """Return the responses of `blocks`, from one pass over the record.

        Each block simulates its own heat; heat of earlier blocks goes on as a few basis states (`_RemainingHeat`).
        """
        count = len(edges) - 1
        found = np.zeros((count, self.m, count, self.k))
        inputs = self._inputs(grid, np.full((len(grid.time), self.k), _PROBE_W))
        centre = self.values(values)
        centre[self._gain] = 0.0
        gained = np.tile(centre, (self.k, 1))
        gained[:, self._gain] += np.eye(self.k)
        left = _RemainingHeat(state[: self.k])
        for b, (first, last) in enumerate(zip(edges[:-1], edges[1:], strict=True)):
            until = min(last + 1, len(grid.time))
            # Row 0 is the undisturbed run, the k after it are this block's, the rest what earlier blocks left behind.
            begun = np.vstack([np.repeat(left.base, 1 + self.k, axis=0), left.rows])
            rows = np.vstack([centre[None, :], gained, np.repeat(centre[None, :], len(left.rows), axis=0)])
            readings, states = self._carried(rows, begun, state, grid, inputs, slice(first, until), last)
            mean = readings[:, : last - first, : self.m].mean(axis=1)
            own, before = mean[1 : 1 + self.k] - mean[0], left.of(mean[1 + self.k :] - mean[0])
            found[b, :, b] = own.T / _PROBE_W
            found[b, :, :b] = before.reshape(b, self.k, self.m).transpose(2, 0, 1) / _PROBE_W
            left = left.after(states, self.k)
        return found

    def _carried(
        self, rows: Array, begun: Array, state: Array, grid: Grid, inputs: Array, part: slice, last: int
    ) -> tuple[Array, Array]:
        """Return the readings (P, n, m) over a part of the grid and the full states at its end.

        Each run restarts where a segment begins, before bin `last`.
        """
        at, states, readings = part.start, begun, []
        for i, first in enumerate(grid.begins):
            if i == 0 or not part.start <= first < last:
                continue
            if first > at:
                own, states = self._kernel.trace(rows, states, grid.time[at : first + 1], inputs[at : first + 1])
                readings.append(own[:, :-1])
            at, states = first, restarted_states(states, np.tile(state[i * self.k : (i + 1) * self.k], (len(rows), 1)))
        own, states = self._kernel.trace(rows, states, grid.time[at : part.stop], inputs[at : part.stop])
        return (np.concatenate([*readings, own], axis=1) if readings else own), states


class _RemainingHeat:
    """Remaining effect of earlier blocks' heat: `shares` (b * k, r) of r basis states `basis` (r, size).

    Each basis state is simulated by itself. There are hardly more than the network has nodes: water circulates many
    times in a block, so its profile follows from the node temperatures.
    """

    def __init__(self, base: Array, shares: Array | None = None, basis: Array | None = None) -> None:
        self.base = np.atleast_2d(base)
        self._shares = np.empty((0, 0)) if shares is None else shares
        self.rows = self.base[:0] if basis is None else self.base + _STATE_STEP * basis

    def of(self, change: Array) -> Array:
        """Return the change (b * k, ...) by each earlier block's heat, for the changes (r, ...) of the basis states."""
        found: Array = self._shares @ change / _STATE_STEP
        return found

    def after(self, states: Array, k: int) -> _RemainingHeat:
        """Return the remaining effect after a block, from full states (1 + k + r, size) at its end."""
        change = states[1:] - states[0]
        own, carried = change[:k], change[k:] / _STATE_STEP
        count, r = self._shares.shape
        shares = np.zeros((count + k, r + k))
        shares[:count, :r], shares[count:, r:] = self._shares, np.eye(k)
        weight = np.abs(shares).max(axis=0)
        weight[weight == 0.0] = 1.0
        u, singular, ways = np.linalg.svd(np.vstack([carried, own]) * weight[:, None], full_matrices=False)
        kept = singular > _LEAST_WAY * singular[0]
        size = np.abs(ways[kept]).max(axis=1)
        return _RemainingHeat(
            states[:1], (shares / weight) @ (u * singular)[:, kept] * size, ways[kept] / size[:, None]
        )


def posterior(
    network: Network, probe: Probe, grid: Grid, state: Array, inflation: float, widen: float
) -> GaussianPrior:
    """Return the Gaussian posterior of [tunables z, initial state] after a healthy record; `widen` multiplies its
    variance.

    The initial state has the wide prior of commissioning, since the next record begins in another state. Its first
    readings are data as all others: a sensor bias from the beginning says nothing about a volume.
    """
    weight = np.where(np.isfinite(grid.measured), 1.0 / grid.sigma, 0.0)
    j = probe.sensitivities(grid, state) * weight[:, :, None]
    flat = j.reshape(-1, j.shape[2])
    prior_sd = probe.scaling.prior_sd()
    state_precision = np.full(j.shape[2] - probe.q, INITIAL_SD_K**-2.0)
    precision = flat.T @ flat / inflation + np.diag(np.concatenate([prior_sd**-2.0, state_precision]))
    covariance = np.linalg.inv(precision)[: probe.q, : probe.q] * widen
    limit = prior_sd / np.sqrt(np.diag(covariance))
    covariance = covariance * np.outer(np.minimum(limit, 1.0), np.minimum(limit, 1.0))
    full = np.eye(probe.q + probe.k) * INITIAL_SD_K**-2.0
    full[: probe.q, : probe.q] = np.linalg.inv(covariance)
    values = network.values[probe.scaling.index]
    return GaussianPrior(np.concatenate([probe.scaling.to_z(values), state[: probe.k]]), full)


def _with_probes(network: Network, columns: tuple[str, ...]) -> tuple[Network, tuple[str, ...], list[int]]:
    """Return a network with a heat input and a reading in every node, the ids of the inputs' gains, and the readings.

    `columns` (k,) name the inputs. The gains are 0, so that the network is as before; the readings are (k,) indices.
    """
    elements, parameters, inputs = list(network.elements), dict(network.parameters), dict(network.inputs)
    gains = []
    for node, column in zip(network.nodes, columns, strict=True):
        inputs[column] = InputSpec(column, 0.0, -1e6, 1e6, "W")
        element = HeatSource(f"probe_in_{node}", node, column, "linear")
        elements.append(element)
        for spec in element.parameter_specs():
            key = f"{element.name}.{spec.name}"
            status: Status = "tunable" if spec.name == "gain" else "fixed"
            parameters[key] = Parameter(
                key, element.name, spec.name, 0.0, spec.unit, spec.lower, spec.upper, status, "a question"
            )
        gains.append(f"{element.name}.gain")
    # Every node gets a reading of its own without lag or bias, behind those that the network has.
    reads = []
    for k, node in enumerate(network.nodes):
        sensor = Sensor(f"probe_at_{node}", node, (f"probe_at_{node}_C",))
        elements.append(sensor)
        reads.append(len(network.sensors) + k)
        for spec in sensor.parameter_specs():
            key = f"{sensor.name}.{spec.name}"
            value = spec.default if spec.default is not None else 0.0
            parameters[key] = Parameter(
                key, sensor.name, spec.name, value, spec.unit, spec.lower, spec.upper, "fixed", spec.source
            )
    probed = replace(
        network,
        elements=tuple(elements),
        parameters=MappingProxyType(parameters),
        inputs=MappingProxyType(inputs),
        digest="",
    )
    return probed, tuple(gains), reads


def free_run(probe: Probe, grid: Grid) -> tuple[Array, FreeRun, Array, np.ndarray]:
    """Return the first state (s * k,), the free run from it, its residual (n, m) K with gaps closed, and a mask (n, m)
    of readings.
    """
    state = probe.first_state(grid)
    run = probe.run(grid, state)
    off = grid.measured - run.readings
    good = np.isfinite(off)
    return state, run, filled(off, good), good
