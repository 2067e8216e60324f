"""Compiled simulation of one network: build once, cache on disk (`twin.kernel_cache`), call with arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from twin.codegen import LANES, Mode, kernel_source
from twin.kernel_cache import compiled
from twin.memory import Memory
from twin.network import Array, Network, TwinFileError

CHUNK = 4096
"""Particles handed to a cost kernel at once, so that a swarm of any size needs little memory."""


@dataclass(frozen=True)
class GaussNewton:
    """What one linearisation yields, for q varied quantities and m sensors.

    Attributes:
        jtj: (q, q) of the noise-weighted residuals.
        jtr: (q,) gradient of half the cost.
        sse: (m,) weighted squared residuals at the centre, per sensor.
        end: (k,) state at the last sample, at the centre.
    """

    jtj: Array
    jtr: Array
    sse: Array
    end: Array


class Kernel:
    """The simulation of one network with `lane_ids` free to differ between particles.

    Parameter vectors are always full ones, (p,) or (P, p) in the order of ``network.ids``; columns outside
    `lane_ids` must be the same for all particles of a call.

    Arrays: time (n,) s, not decreasing; inputs (n, c); measured (n, m) degC with NaN where masked. Inputs hold from
    a sample to the next; NaN in an input holds the last good value (the network's nominal before the first).

    A state is (k,) or (P, k), the node temperatures in degC at the first sample, with everything that the elements
    remember at rest; or (size,) or (P, size), what an earlier call handed out, from which it goes on. Its first k
    entries are the node temperatures. For a network without memory the two are the same.

    With `whole_memory` a full state holds what parameters in `lane_ids` may bring along, too: a lag that is 0 in the
    network. Only this kernel can then take it up.
    """

    def __init__(
        self, network: Network, lane_ids: tuple[str, ...] | None = None, *, whole_memory: bool = False
    ) -> None:
        self.network = network
        self.lane_ids = network.ids if lane_ids is None else tuple(dict.fromkeys(lane_ids))
        self.lane = network.index(self.lane_ids)
        self._memory = Memory(network, self.lane_ids, self.lane_ids if whole_memory else ())
        self._variants: dict[tuple[Mode, int, bool], Callable[..., None]] = {}

    @property
    def size(self) -> int:
        """Length of a full state."""
        return self._memory.size

    def _variant(self, mode: Mode, call: Call) -> Callable[..., None]:
        key = (mode, call.lanes, call.alike)
        if key not in self._variants:
            self._variants[key] = compiled(kernel_source(self.network, mode, self.lane_ids, call.lanes, call.alike))
        return self._variants[key]

    def cost(
        self, parameters: Array, state: Array, time: Array, inputs: Array, measured: Array, weight: Array
    ) -> tuple[Array, Array]:
        """Sum of squared weighted residuals per particle and sensor (P, m), and end temperatures (P, k).

        Args:
            measured, weight: (n, m); entries of weight 0 are ignored (`masked` makes both).
        """
        parameters, state = np.atleast_2d(parameters), np.atleast_2d(state)
        count, k, m = max(len(parameters), len(state)), len(self.network.nodes), len(self.network.sensors)
        sse, end = np.empty((count, m)), np.empty((count, k))
        for low in range(0, count, CHUNK):
            part = slice(low, low + CHUNK)
            rows = [a if len(a) == 1 else a[part] for a in (parameters, state)]
            call = self._call(rows[0], rows[1], time, inputs, min(CHUNK, count - low), 1 if count == 1 else LANES)
            out = np.empty((call.blocks, m, call.lanes))
            call.run(self._variant("cost", call), *call.later(measured, weight), out, call.end, call.no_future)
            sse[part], end[part] = call.particles(out), call.particles(call.end)[:, :k]
        return sse, end

    def trace(
        self, parameters: Array, state: Array, time: Array, inputs: Array, lanes: int | None = None
    ) -> tuple[Array, Array]:
        """Readings (P, n, m) at every sample, and full end states (P, size).

        Args:
            lanes: particles that run side by side, 1, FEW_LANES or LANES; by default 1 or LANES, as suits P. Each is
                compiled by itself.
        """
        return self.trace_pieces(np.atleast_2d(parameters)[None], state, time, inputs, [0], lanes)

    def trace_pieces(
        self, parameters: Array, state: Array, time: Array, inputs: Array, cuts: Sequence[int], lanes: int | None = None
    ) -> tuple[Array, Array]:
        """The same where parameters change at some samples.

        Args:
            parameters: (c, P, p), those of each piece. cuts: (c,) sample at which each piece begins, 0 first. What is
                read at that sample is read by the piece that begins.
            lanes: as of `trace`.
        """
        call = self._call(parameters, state, time, inputs, lanes=lanes)
        m = len(self.network.sensors)
        readings = np.empty((call.blocks, len(call.time), m, call.lanes))
        call.run_pieces(self._variant("trace", call), cuts, readings)
        # Of one block this is a view.
        rows = readings[:, call.first :].transpose(0, 3, 1, 2).reshape(-1, len(time), m)
        return rows[: call.count], call.ends(time, inputs)

    def linearise(
        self,
        parameters: Array,
        state: Array,
        steps: Array,
        time: Array,
        inputs: Array,
        measured: Array,
        weight: Array,
    ) -> GaussNewton:
        """Normal equations by forward differences across lanes: row 0 is the centre, row a differs by steps[a - 1].

        Args:
            parameters: (1 + q, p). state: (1 + q, k). steps: (q,), the size of each row's difference.
            measured, weight: (n, m) as `cost`. q is at most LANES - 1.
        """
        count = max(len(np.atleast_2d(parameters)), len(np.atleast_2d(state)))
        if count > LANES:
            raise ValueError(f"at most {LANES - 1} quantities can be varied at once, got {count - 1}")
        call = self._call(parameters, state, time, inputs, count, LANES)
        m = len(self.network.sensors)
        gram, sse = np.empty((1, LANES, LANES)), np.zeros((1, m))
        call.run(
            self._variant("gram", call), *call.later(measured, weight), count, gram, sse, call.end, call.future
        )  # fmt: skip
        inner = gram[0, 1:count, 1:count] / np.outer(steps, steps)
        return GaussNewton(inner, gram[0, 0, 1:count] / steps, sse[0], call.ends(time, inputs)[0])

    def _call(
        self,
        parameters: Array,
        state: Array,
        time: Array,
        inputs: Array,
        count: int | None = None,
        lanes: int | None = None,
    ) -> Call:
        if not len(time):
            raise ValueError("there is no sample to simulate")
        parameters, state = np.atleast_2d(parameters), np.atleast_2d(state)
        count = count or max(parameters.shape[-2], len(state))
        lanes = lanes or (1 if count == 1 else LANES)
        return Call(self._memory, parameters, state, time, inputs, count, lanes, self.lane)


class Call:
    """Arguments of one call of a compiled kernel, laid out in blocks of lanes."""

    def __init__(
        self,
        memory: Memory,
        parameters: Array,
        state: Array,
        time: Array,
        inputs: Array,
        count: int,
        lanes: int,
        lane: np.ndarray,
    ) -> None:
        self.memory, self.count, self.lanes = memory, count, lanes
        self.blocks = -(-count // lanes)
        self._base = parameters.reshape(-1, parameters.shape[-1])[0].copy()
        self._lane = _laid_out(parameters[..., lane], count, lanes)
        temperatures, past, history = memory.taken_apart(state)
        if not (np.isfinite(self._lane).all() and np.isfinite(state[:, : memory.nodes]).all()):
            raise ValueError("parameters and initial states must be finite")
        self._start = _laid_out(temperatures, count, lanes)
        self._past = np.empty((0, 0, 0)) if past is None else _laid_out(past, count, lanes)
        self.alike = memory.alike(past)
        self.history = history
        self.time, self.inputs = memory.extended(history, time, inputs)
        self.first = len(self.time) - len(time)
        self.end = np.empty((self.blocks, self._start.shape[1], lanes))
        self.no_future = np.empty((0, 0, 0))
        self.future = np.empty((self.blocks if memory.rows else 0, memory.rows, lanes))

    def run(self, kernel: Callable[..., None], *rest: Any) -> None:
        kernel(self._base, self._lane, self._start, self._past, self.first, self.time, self.inputs, *rest)

    def run_pieces(self, kernel: Callable[..., None], cuts: Sequence[int], readings: Array) -> None:
        rows = np.array([*cuts, len(self.time) - self.first], dtype=np.int64) + self.first
        past, now = (self._start, self._past), (self.time, self.inputs)
        kernel(self._base, self._lane, *past, rows, *now, readings, self.end, self.future)

    def later(self, *arrays: Array) -> list[Array]:
        """Arrays over the samples with rows put before them for the samples that are history."""
        if not self.first:
            return list(arrays)
        return [np.vstack([np.zeros((self.first, a.shape[1])), a]) for a in arrays]

    def particles(self, lanes: Array) -> Array:
        """(blocks, q, lanes) -> (P, q)."""
        blocks, q, width = lanes.shape
        return lanes.transpose(0, 2, 1).reshape(blocks * width, q)[: self.count]

    def ends(self, time: Array, inputs: Array) -> Array:
        """Full states (P, size) at the last sample."""
        history = self.memory.remembered(self.time, self.inputs)
        return self.memory.put_together(self.particles(self.end), self.particles(self.future), history)


def simulate(
    network: Network, time: ArrayLike, inputs: ArrayLike, state: ArrayLike, parameters: ArrayLike | None = None
) -> Array:
    """Free-running readings (n, m) in degC of a network from an initial state.

    Args:
        time: (n,) s. inputs: (n, c) in the order of ``network.input_columns``. state: (k,) degC.
        parameters: full vector (p,), the network's own by default.
    """
    values = network.values if parameters is None else np.asarray(parameters, dtype=np.float64)
    t, u = clean_time(time), held(network, inputs)
    return Kernel(network, ()).trace(values, np.asarray(state, dtype=np.float64), t, u)[0][0]


def held(network: Network, inputs: ArrayLike, last: Array | None = None) -> Array:
    """Inputs (n, c) with NaN replaced by the last good value; before the first, by `last` or the nominal."""
    u = np.ascontiguousarray(np.atleast_2d(np.asarray(inputs, dtype=np.float64)))
    if u.shape[1] != len(network.inputs):
        raise TwinFileError(f"expected {len(network.inputs)} input columns, got {u.shape[1]}")
    good = np.isfinite(u)
    if good.all():
        return u
    before = network.nominal_inputs if last is None else last
    filled = np.vstack([before, np.where(good, u, 0.0)])
    row = np.where(good, np.arange(1, len(u) + 1)[:, None], 0)
    latest = np.maximum.accumulate(row, axis=0)
    return np.ascontiguousarray(np.take_along_axis(filled, latest, axis=0))


def clean_time(time: ArrayLike) -> Array:
    """Time (n,) as contiguous floats.

    Raises:
        TwinFileError: not finite, or going back.
    """
    t = np.ascontiguousarray(np.asarray(time, dtype=np.float64).ravel())
    if not np.isfinite(t).all() or (np.diff(t) < 0.0).any():
        raise TwinFileError("time must be finite and must not go back; sort the record or drop those rows")
    return t


def masked(measured: ArrayLike, sigma: Array | float = 1.0) -> tuple[Array, Array]:
    """Measurements with NaN replaced by 0, and weights 1/sigma with 0 where there was NaN; both (n, m)."""
    y = np.atleast_2d(np.asarray(measured, dtype=np.float64))
    good = np.isfinite(y)
    weight = np.where(good, 1.0 / np.broadcast_to(np.asarray(sigma, dtype=np.float64), y.shape), 0.0)
    return np.ascontiguousarray(np.where(good, y, 0.0)), np.ascontiguousarray(weight)


def _laid_out(rows: Array, count: int, lanes: int) -> Array:
    """(..., P or 1, q) -> (..., blocks, q, lanes); a last partial block repeats its final particle."""
    last = min(count, rows.shape[-2]) - 1
    if count <= lanes:  # one block, by far the most frequent: fancy indices would take longer than the copy
        out = np.empty((*rows.shape[:-2], 1, rows.shape[-1], lanes))
        turned = rows.swapaxes(-1, -2)
        out[..., 0, :, : last + 1] = turned[..., : last + 1]
        out[..., 0, :, last + 1 :] = turned[..., last : last + 1]
        return out
    take = np.minimum(np.arange(-(-count // lanes) * lanes), last).reshape(-1, lanes)
    return np.array(np.moveaxis(rows[..., take, :], -1, -2), order="C")
