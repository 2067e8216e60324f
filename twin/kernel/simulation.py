"""Compiled simulation of one network: build once, cache on disk (`twin.kernel.cache`), call with arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from twin.elements.base import STAMP
from twin.kernel.cache import compile_kernel
from twin.kernel.codegen import FEW_LANES, LANES, Mode, kernel_source
from twin.kernel.integrators import MOST_STEPS, STEP_LIMIT
from twin.kernel.state_layout import StateLayout
from twin.network import Array, Network, TwinFileError

CHUNK = 4096
"""Particles handed to a cost kernel at once, so that a swarm of any size needs little memory."""
STIFF = 128.0
"""Sample interval in shortest time constants beyond which the linearly implicit method is used: an explicit one would
take four times as many substeps, each of which costs little less."""
FEW_INTERVALS = 64
"""Intervals of a call up to which the explicit method is used where it can reach: its cost is small, and the median of
a few intervals is not that of their record, whose pieces have to give what the whole gives."""
REACH = 0.1 * MOST_STEPS * STEP_LIMIT
"""Interval in shortest time constants that the explicit method reaches in any case: the norms by which it counts its
substeps may be ten times the largest rate."""


class Kernel:
    """The simulation of one network in which the parameters `lane_ids` may differ between particles.

    Parameters
    ----------
    network
        The network to simulate.
    lane_ids
        Ids of the parameters that may vary; all by default.
    whole_memory
        Include in a full state all memory that the parameters in `lane_ids` may bring along, such as a lag that is 0 in
        the network. Only this kernel can then take up that state.

    Notes
    -----
    Parameter vectors are always full, (p,) or (P, p) in the order of ``network.ids``; columns outside `lane_ids` must
    be the same for all particles of a call.

    Arrays: time (n,) s, not decreasing; inputs (n, c); measured (n, m) degC with NaN where masked. Inputs hold from
    a sample to the next; NaN in an input holds the last good value (the network's nominal before the first).

    Where samples are further apart than `STIFF` of the shortest time constants, a linearly implicit method takes the
    place of the explicit one (`integrators`). It is off by at most 2.2e-4 of a jump at the end of the jump's interval.

    A state is (k,) or (P, k), the node temperatures in degC at the first sample with all memory at rest; or (size,) or
    (P, size), the full state that an earlier call returned. Its first k entries are the node temperatures. For a
    network without memory the two are the same.
    """

    def __init__(
        self, network: Network, lane_ids: tuple[str, ...] | None = None, *, whole_memory: bool = False
    ) -> None:
        self.network = network
        self.lane_ids = network.ids if lane_ids is None else tuple(dict.fromkeys(lane_ids))
        self.lane = network.index(self.lane_ids)
        self._layout = StateLayout(network, self.lane_ids, self.lane_ids if whole_memory else ())
        self._variants: dict[tuple[Mode, int, bool, bool], Callable[..., None]] = {}

    @property
    def size(self) -> int:
        """Return the length of a full state."""
        return self._layout.size

    @property
    def states(self) -> tuple[str, ...]:
        """Return the names of the node temperatures and of the elements' own states."""
        return self._layout.states

    def _variant(self, mode: Mode, call: _Call) -> Callable[..., None]:
        key = (mode, call.lanes, call.same_flow, call.stiff)
        if key not in self._variants:
            self._variants[key] = compile_kernel(
                kernel_source(self.network, mode, self.lane_ids, call.lanes, call.same_flow, call.stiff)
            )
        return self._variants[key]

    def cost(
        self, parameters: Array, state: Array, time: Array, inputs: Array, measured: Array, weight: Array
    ) -> tuple[Array, Array]:
        """Return the sum of squared weighted residuals per particle and sensor (P, m), and end temperatures (P, k),
        degC.

        Parameters
        ----------
        parameters, state, time, inputs
            Arrays as described for the class.
        measured, weight
            (n, m) degC and 1/K; entries of weight 0 are ignored (`mask_measurements` makes both).

        Raises
        ------
        ValueError
            There is no sample, a parameter or state is not finite, or an array has another size.
        """
        parameters, state = np.atleast_2d(parameters), np.atleast_2d(state)
        wanted = (len(time), len(self.network.instruments))
        if measured.shape != wanted or weight.shape != wanted:
            raise ValueError(f"measured and weight must have the shape {wanted}, not {measured.shape}, {weight.shape}")
        count, k, m = max(len(parameters), len(state)), len(self.network.nodes), len(self.network.instruments)
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
        """Return readings (P, n, m) in degC at every sample, and full end states (P, size).

        Parameters
        ----------
        parameters, state, time, inputs
            Arrays as described for the class.
        lanes
            Number of particles in a block, 1, FEW_LANES or LANES; by default the fewest that hold P. Each is compiled
            by itself.

        Raises
        ------
        ValueError
            There is no sample, a parameter or state is not finite, or an array has another size.
        """
        return self.trace_pieces(np.atleast_2d(parameters)[None], state, time, inputs, [0], lanes)

    def trace_pieces(
        self, parameters: Array, state: Array, time: Array, inputs: Array, cuts: Sequence[int], lanes: int | None = None
    ) -> tuple[Array, Array]:
        """Return readings and end states as `trace` does, where parameters change at some samples.

        Parameters
        ----------
        parameters
            (c, P, p), those of each piece.
        cuts
            (c,) sample at which each piece begins, 0 first. The reading at that sample is that of the piece that
            begins.
        lanes
            As for `trace`.
        """
        ends = [*cuts, len(time)]
        if len(cuts) != len(parameters) or cuts[0] != 0 or any(a > b for a, b in zip(ends[:-1], ends[1:], strict=True)):
            raise ValueError(f"{len(parameters)} pieces need as many cuts, from 0 on and in order, not {list(cuts)}")
        call = self._call(parameters, state, time, inputs, lanes=lanes)
        m = len(self.network.instruments)
        readings = np.empty((call.blocks, len(call.time), m, call.lanes))
        call.run_pieces(self._variant("trace", call), cuts, readings)
        # Of one block this is a view.
        rows = readings[:, call.first :].transpose(0, 3, 1, 2).reshape(-1, len(time), m)
        return rows[: call.count], call.ends(time, inputs)

    def _call(
        self,
        parameters: Array,
        state: Array,
        time: Array,
        inputs: Array,
        count: int | None = None,
        lanes: int | None = None,
    ) -> _Call:
        if not len(time):
            raise ValueError("there is no sample to simulate")
        parameters, state = np.atleast_2d(parameters), np.atleast_2d(state)
        if len(inputs) != len(time) or parameters.shape[-1] != len(self.network.ids):
            raise ValueError(
                f"{len(time)} samples need as many rows of inputs, and {len(self.network.ids)} parameters; got "
                f"{len(inputs)} and {parameters.shape[-1]}"
            )
        count = count or max(parameters.shape[-2], len(state))
        lanes = lanes or next((width for width in (1, FEW_LANES) if count <= width), LANES)
        return _Call(self._layout, parameters, state, time, inputs, count, lanes, self.lane)


class _Call:
    """Arguments of one call of a compiled kernel, laid out in blocks of lanes."""

    def __init__(
        self,
        layout: StateLayout,
        parameters: Array,
        state: Array,
        time: Array,
        inputs: Array,
        count: int,
        lanes: int,
        lane: np.ndarray,
    ) -> None:
        self.layout, self.count, self.lanes = layout, count, lanes
        self.blocks = -(-count // lanes)
        self._base = parameters.reshape(-1, parameters.shape[-1])[0].copy()
        self._lane = _in_blocks(parameters[..., lane], count, lanes)
        temperatures, past, history = layout.split(state)
        if not (np.isfinite(parameters).all() and np.isfinite(state[:, : layout.nodes]).all()):
            raise ValueError("parameters and initial states must be finite")
        needed = len(layout.network.input_columns)
        if inputs.ndim != 2 or inputs.shape[1] < needed:
            raise ValueError(f"inputs must have {needed} columns, and have the shape {inputs.shape}")
        self._start = _in_blocks(temperatures, count, lanes)
        self._past = np.empty((0, 0, 0)) if past is None else _in_blocks(past, count, lanes)
        self.same_flow = layout.pushed_equally(past)
        self.history = history
        self.time, self.inputs = layout.with_history(history, time, inputs)
        self.inputs = with_stamps(layout.network, self.time, self.inputs)
        self.first = len(self.time) - len(time)
        self.stiff = _is_stiff(np.diff(time), layout.fastest)
        self.end = np.empty((self.blocks, self._start.shape[1], lanes))
        self.no_future = np.empty((0, 0, 0))
        self.future = np.empty((self.blocks if layout.rows else 0, layout.rows, lanes))

    def run(self, kernel: Callable[..., None], *rest: Any) -> None:
        """Run a kernel of mode ``cost``."""
        kernel(self._base, self._lane, self._start, self._past, self.first, self.time, self.inputs, *rest)

    def run_pieces(self, kernel: Callable[..., None], cuts: Sequence[int], readings: Array) -> None:
        """Run a kernel of mode ``trace`` over pieces that begin at `cuts`."""
        rows = np.array([*cuts, len(self.time) - self.first], dtype=np.int64) + self.first
        past, now = (self._start, self._past), (self.time, self.inputs)
        kernel(self._base, self._lane, *past, rows, *now, readings, self.end, self.future)

    def later(self, *arrays: Array) -> list[Array]:
        """Return arrays over the samples with zero rows put before them for the samples that are history."""
        if not self.first:
            return list(arrays)
        return [np.vstack([np.zeros((self.first, a.shape[1])), a]) for a in arrays]

    def particles(self, lanes: Array) -> Array:
        """Return an array (blocks, q, lanes) as (P, q)."""
        blocks, q, width = lanes.shape
        return lanes.transpose(0, 2, 1).reshape(blocks * width, q)[: self.count]

    def ends(self, time: Array, inputs: Array) -> Array:
        """Return the full states (P, size) at the last sample."""
        history = self.layout.recent_commands(self.time, self.inputs)
        return self.layout.join(self.particles(self.end), self.particles(self.future), history)


def _is_stiff(intervals: Array, fastest: float) -> bool:
    """Return True where the linearly implicit method is to take these intervals (n - 1,), s, of a network whose largest
    rate is `fastest`, 1/s."""
    longest = float(intervals.max(initial=0.0))
    # The median, which takes far longer to find, is no longer than that.
    if longest * fastest <= STIFF or float(np.median(intervals)) * fastest <= STIFF:
        return False
    return len(intervals) > FEW_INTERVALS or longest * fastest > REACH


def simulate(
    network: Network, time: ArrayLike, inputs: ArrayLike, state: ArrayLike, parameters: ArrayLike | None = None
) -> Array:
    """Simulate a network without measurements (free run) and return the sensors' readings.

    Parameters
    ----------
    network
        The network.
    time
        (n,) s, not decreasing.
    inputs
        (n, c) in the order of ``network.input_columns``; NaN holds the last good value.
    state
        (k,) node temperatures at the first sample, degC, in the order of ``network.nodes``.
    parameters
        Full vector (p,) in the order of ``network.ids``; the network's own by default.

    Returns
    -------
    ndarray
        Readings (n, m) in degC, of meters in their own unit, in the order of ``network.sensor_names``.

    Raises
    ------
    TwinFileError
        Time goes back or is not finite, an array has another size, or a parameter is not finite.
    """
    values = network.values if parameters is None else np.asarray(parameters, dtype=np.float64)
    t, u = clean_time(time), hold_inputs(network, inputs)
    if len(u) != len(t):
        raise TwinFileError(f"{len(t)} stamps need as many rows of inputs, not {len(u)}")
    if values.shape != network.values.shape or not np.isfinite(values).all():
        raise TwinFileError(f"twin {network.name!r} needs {len(network.ids)} finite parameters, got {values.size}")
    return Kernel(network, ()).trace(values, np.asarray(state, dtype=np.float64), t, u)[0][0]


def hold_inputs(network: Network, inputs: ArrayLike, last: Array | None = None) -> Array:
    """Return inputs (n, c) with NaN replaced by the last good value; before the first, by `last` or the nominal.

    Raises
    ------
    TwinFileError
        The number of input columns is wrong.
    """
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


def with_stamps(network: Network, time: Array, inputs: Array) -> Array:
    """Return inputs (n, c) with the stamps (n,) s in the column of that name, where the network has it."""
    if STAMP not in network.inputs:
        return inputs
    stamped = inputs.copy()
    stamped[:, network.input_columns.index(STAMP)] = time
    return stamped


def clean_time(time: ArrayLike) -> Array:
    """Return time (n,) as contiguous floats.

    Raises
    ------
    TwinFileError
        Time is not finite, or goes back.
    """
    t = np.ascontiguousarray(np.asarray(time, dtype=np.float64).ravel())
    if not np.isfinite(t).all() or (np.diff(t) < 0.0).any():
        raise TwinFileError("time must be finite and must not go back; sort the record or drop those rows")
    return t


def mask_measurements(measured: ArrayLike, sigma: Array | float = 1.0) -> tuple[Array, Array]:
    """Return measurements with NaN replaced by 0, and weights 1/sigma with 0 where there was NaN; both (n, m)."""
    y = np.atleast_2d(np.asarray(measured, dtype=np.float64))
    good = np.isfinite(y)
    weight = np.where(good, 1.0 / np.broadcast_to(np.asarray(sigma, dtype=np.float64), y.shape), 0.0)
    return np.ascontiguousarray(np.where(good, y, 0.0)), np.ascontiguousarray(weight)


def _in_blocks(rows: Array, count: int, lanes: int) -> Array:
    """Return an array (..., P or 1, q) as (..., blocks, q, lanes); a last partial block repeats its final particle."""
    last = min(count, rows.shape[-2]) - 1
    if count <= lanes:  # one block, by far the most frequent: fancy indices would take longer than the copy
        out = np.empty((*rows.shape[:-2], 1, rows.shape[-1], lanes))
        turned = rows.swapaxes(-1, -2)
        out[..., 0, :, : last + 1] = turned[..., : last + 1]
        out[..., 0, :, last + 1 :] = turned[..., last : last + 1]
        return out
    take = np.minimum(np.arange(-(-count // lanes) * lanes), last).reshape(-1, lanes)
    return np.array(np.moveaxis(rows[..., take, :], -1, -2), order="C")
