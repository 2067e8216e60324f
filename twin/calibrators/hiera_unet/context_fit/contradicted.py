"""Sensor faults by analytical redundancy: thermometers that the rest of the rig contradicts.

A change of a rig affects its water and so every thermometer of the loop, a sensor fault one thermometer alone. The live
twin, as it is and as it was half an hour ago, runs free over the last 45 minutes. A thermometer is excluded if it has
stepped away from such a run while the others stayed, and no change of a parameter, then or throughout, explains all of
them nearly as well. From that time on it counts as missing, until it agrees with both runs again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from twin.calibrators.hiera_unet.context_fit.evidence import CORRELATED_STEPS, step_noise
from twin.calibrators.hiera_unet.data.features import Features
from twin.calibrators.hiera_unet.data.series import STEP_S, ResampledSeries
from twin.calibrators.hiera_unet.data.windows import CONTEXT
from twin.kernel import Kernel
from twin.network import Array, Network

SPAN, LATEST, LEAST, EVERY = 540, 360, 24, 12
"""Steps of the free run; its last steps in which a step may lie; fewest steps after it; and spacing of candidates."""
OFF_K, BACK_K = 0.1, 0.05
"""Least step of a faulty thermometer, K, and largest deviation of its last `AGREEING` steps for its return, K."""
AGREEING = 120
OTHERS_K, OTHERS = 0.03, 0.15
"""Largest change of the others, K, or as a share of the step, whichever is more."""
LEFT = 4.0
"""Largest mean square that the step may leave of all thermometers, in noises, with correlated steps counting as one."""
SURE = 15.0
"""Least log likelihood ratio of the step over any change of a parameter."""
NEAR = 36
"""Steps about the step within which a parameter may have changed as well."""
SMALL, LARGE, REACH = 0.1, 0.6, 2.5
"""Changes of a parameter whose responses are tried, as shares of its value, and their largest multiple."""


@dataclass(frozen=True)
class Doubt:
    """Excluded thermometer: its number, the onset of its fault, s, and its step, K."""

    sensor: int
    since_s: float
    off_K: float

    def sentence(self, network: Network) -> str:
        name, way = network.sensor_names[self.sensor], "more" if self.off_K > 0.0 else "less"
        return (
            f"DOUBTED_SENSOR: {name} has come to read {abs(self.off_K):.2f} K {way} than the other thermometers and "
            "any parameter allow: left aside"
        )

    def document(self, network: Network) -> dict[str, Any]:
        """Return plain data for a log."""
        return {"sensor": network.sensor_names[self.sensor], "since_s": self.since_s, "off_K": self.off_K}

    def plain(self) -> dict[str, Any]:
        """Return plain data for resuming."""
        return asdict(self)

    @classmethod
    def restored(cls, data: Mapping[str, Any]) -> Doubt:
        """Restore from the result of `plain`."""
        return cls(int(data["sensor"]), float(data["since_s"]), float(data["off_K"]))


def without(time: Array, measured: Array, doubts: Sequence[Doubt]) -> Array:
    """Return readings (n, Y) at times (n,), with NaN for excluded thermometers."""
    if not doubts:
        return measured
    left = measured.copy()
    for doubt in doubts:
        left[time > doubt.since_s - STEP_S / 2.0, doubt.sensor] = np.nan
    return left


def trusted(series: ResampledSeries, doubts: Sequence[Doubt]) -> ResampledSeries:
    """Return the record without excluded thermometers."""
    return replace(series, measured=without(series.time, series.measured, doubts)) if doubts else series


def reviewed(
    features: Features, series: ResampledSeries, twins: Sequence[Array], doubts: Sequence[Doubt]
) -> tuple[Doubt, ...]:
    """Return the exclusions that still hold, and a thermometer that became faulty since.

    Never more than half of the thermometers are excluded: with fewer there is no redundancy.

    Args:
        series: as it was measured. twins: full vectors (p,): of the live twin, and of its earlier values, since it may
            have followed a sensor fault.
    """
    runs = _free_runs(features, trusted(series, doubts), twins)
    if not runs:
        return tuple(doubts)
    standing = tuple(d for d in doubts if not all(_agrees(run, series, d) for run in runs))
    if len(standing) != len(doubts):
        runs = _free_runs(features, trusted(series, standing), twins)
    if len(standing) >= len(features.network.sensors) // 2:
        return standing
    for twin, run in zip(twins, runs, strict=True):
        if (found := _stepped(features, run, twin)) is not None:
            return (*standing, found)
    return standing


class _TwinRun(NamedTuple):
    """Free run of the live twin over the last steps.

    Times (n,) s, inputs (n, c), state at the first, readings (n, Y) and measured (n, Y), degC.
    """

    time: Array
    held: Array
    state: Array
    readings: Array
    measured: Array


def _free_runs(features: Features, series: ResampledSeries, twins: Sequence[Array]) -> list[_TwinRun]:
    """Return the free run of each twin; none if the record is too short."""
    nominal = features.network.values
    frame = features.frame(series, len(series), nominal)
    first = max(CONTEXT - SPAN, frame.begin)
    if CONTEXT - first < SPAN // 2:
        return []
    state, time, held = features.state_at(frame, first, nominal), frame.time[first:], frame.held[first:]
    readings = (features.kernel.trace(twin, state, time, held)[0][0] for twin in twins)
    return [_TwinRun(time, held, state, own, frame.measured[first:]) for own in readings]


def _agrees(run: _TwinRun, series: ResampledSeries, doubt: Doubt) -> bool:
    measured = series.measured[-AGREEING:, doubt.sensor]
    off = measured - run.readings[-len(measured) :, doubt.sensor]
    off = off[np.isfinite(off)]
    return off.size >= AGREEING // 2 and abs(float(off.mean())) < BACK_K


class _CentredResiduals:
    """Residuals (n, Y) without each thermometer's mean, in noises; correlated steps count as one."""

    def __init__(self, residual: Array, noise: Array) -> None:
        self.known = np.isfinite(residual)
        self._weight = np.where(self.known, 1.0 / (noise * np.sqrt(CORRELATED_STEPS)), 0.0)
        self._count = np.maximum(self.known.sum(axis=0), 1)
        self.left = self.scaled(np.where(self.known, residual, 0.0))
        self.total = float((self.left**2).sum())

    def scaled(self, shape: Array) -> Array:
        """Return responses (..., n, Y) centred and scaled as the residuals are."""
        mean = (shape * self.known).sum(axis=-2, keepdims=True) / self._count
        return np.asarray((shape - mean) * self._weight)

    def explained(self, shape: Array, least: float, most: float) -> tuple[Array, Array]:
        """Return the multiple of each response (..., n, Y) in the residuals, within bounds, and its fall of `total`."""
        scaled = self.scaled(shape)
        power = np.maximum((scaled**2).sum(axis=(-2, -1)), 1e-12)
        pull = (scaled * self.left).sum(axis=(-2, -1))
        times = np.clip(pull / power, least, most)
        return times, 2.0 * times * pull - times**2 * power


def _stepped(features: Features, run: _TwinRun, live: Array) -> Doubt | None:
    """Return the thermometer that has stepped away alone, or None."""
    residual = run.measured - run.readings
    squares = _CentredResiduals(residual, step_noise(features))
    n, sensors = residual.shape
    moments = np.arange(max(n - LATEST, LEAST), n - LEAST + 1, EVERY)
    steps = np.zeros((sensors, len(moments), n, sensors))
    for j in range(sensors):
        steps[j, :, :, j] = np.arange(n) >= moments[:, None]
    times, gained = squares.explained(steps, -np.inf, np.inf)
    sensor, moment = np.unravel_index(int(np.argmax(gained)), gained.shape)
    off, since, gain = float(times[sensor, moment]), int(moments[moment]), float(gained[sensor, moment])
    if abs(off) < OFF_K or squares.total - gain > LEFT * squares.known.sum() / CORRELATED_STEPS:
        return None
    others = np.delete(np.arange(sensors), sensor)
    if not (_moved(residual[:, others], since) <= max(OTHERS_K, OTHERS * abs(off))).all():
        return None
    about = np.unique(np.clip(np.arange(since - NEAR, since + NEAR + 1, EVERY), 0, n - LEAST))
    _, rival = squares.explained(_responses(features.network, run, live, about), 0.0, REACH)
    if gain - float(rival.max(initial=0.0)) < 2.0 * SURE:
        return None
    return Doubt(int(sensor), float(run.time[since]), off)


def _moved(residual: Array, since: int) -> Array:
    """Return the step (Y,), K, of the mean of residuals (n, Y) at step `since`; 0 without readings before or after."""
    known = np.isfinite(residual)
    filled = np.where(known, residual, 0.0)
    before, after = (
        filled[rows].sum(axis=0) / np.maximum(known[rows].sum(axis=0), 1)
        for rows in (slice(None, since), slice(since, None))
    )
    there = known[:since].any(axis=0) & known[since:].any(axis=0)
    return np.where(there, np.abs(after - before), 0.0)


def _responses(network: Network, run: _TwinRun, live: Array, moments: np.ndarray) -> Array:
    """Return the responses of the readings (r, n, Y) to changes of the twin's parameters, from every onset and
    throughout.
    """
    # Its code is kept by what it does: compiled once, at the first step that needs it.
    kernel, rows = Kernel(network, _of_the_rig(network)), _changed(network, live)
    out = []
    for since in (0, *moments.tolist()):
        before = slice(None, since + 1)
        state = kernel.trace(live, run.state, run.time[before], run.held[before])[1] if since else run.state[None]
        after = slice(since, None)
        states = np.repeat(state, len(rows), axis=0)
        readings = kernel.trace(rows, states, run.time[after], run.held[after])[0]
        shape = np.zeros((len(rows), *run.readings.shape))
        shape[:, since:] = readings - run.readings[since:]
        out.append(shape)
    found = np.concatenate(out)
    return np.asarray(found[np.isfinite(found).all(axis=(1, 2))])


def _changed(network: Network, live: Array) -> Array:
    """Return full vectors (r, p), each with one parameter changed, together with those that are tied to it."""
    rows = []
    for name in _of_the_rig(network):
        own = [k for k, p in enumerate(network.parameters.values()) if name in (p.id, p.same_as)]
        p, value = network.parameters[name], float(live[own[0]])
        size = abs(value) or 0.1 * (p.upper - p.lower)
        for share in (SMALL, -SMALL, LARGE, -LARGE):
            changed = live.copy()
            changed[own] = np.clip(value + share * size, p.lower, p.upper)
            if changed[own[0]] != value:
                rows.append(changed)
    return np.array(rows)


def _of_the_rig(network: Network) -> tuple[str, ...]:
    """Return the parameters that are no thermometer's, and are tied to no other."""
    sensors = set(network.sensor_names)
    return tuple(i for i, p in network.parameters.items() if p.element not in sensors and not p.same_as)
