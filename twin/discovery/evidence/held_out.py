"""Errors over the held-out segment of a record, and the tests of a finding against them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from twin.discovery.diagnosis import SensorError
from twin.discovery.evidence.finding import Finding
from twin.discovery.healthy.basis import Columns
from twin.discovery.records.grid import Grid, bridged
from twin.discovery.records.noise import Noise
from twin.discovery.refit.model import Model
from twin.discovery.scoring.search import Entry
from twin.elements.candidates import LASTING
from twin.network import Array, Network
from twin.segments import find_segments

FAR_OFF, UNUSUAL = 3.0, 1.5
"""Ratios to a thermometer's noise and to the usual error up to which block means may deviate in the held-out segment.
"""
MOST = 0.5
"""Largest share of the squares that an effect may leave where it acts; one that leaves more is not their main cause."""
HELD_OUT_WORSE, MUCH_WORSE = 1.04, 4.0
"""Ratios of the squares to those of re-tuning alone. From the first an answer is worse than none. From the second the
weights of the search are in doubt: without a healthy record they may treat slow misfit as noise."""
CACHED_RUNS = 4
"""Free runs in the cache."""


def contradicted(errors: Mapping[str, SensorError], network: Network) -> bool:
    """Return True if an answer has a large error, and most of the re-tuned twin's squares remain where it acts.

    A sensor's weight is the square of the difference that the answer predicts there beyond re-tuning, in the usual
    error of health, which is noise where no healthy record shows more. Model error of a lumped twin at other sensors
    under a new load does not count. An answer that predicts no difference above the usual error, such as one whose
    effect has passed, leaves nothing to compare.
    """
    weights = {name: (e.moved / max(e.noise, e.usual)) ** 2 for name, e in errors.items()}
    if sum(weights.values()) < len(errors):
        return False
    before, after = (sum(w * (errors[n].means[k] / errors[n].noise) ** 2 for n, w in weights.items()) for k in (1, 2))
    far = any(_far(network, name, e.means[2], e.usual) for name, e in errors.items())
    return far and after > MOST * before


def leaves_more_squares(errors: Mapping[str, SensorError], times: float = HELD_OUT_WORSE) -> bool:
    """Return True if an answer leaves more held-out squares than `times` those of re-tuning alone, and than noise.

    Squares are over noise, and summed over all sensors.
    """
    before = sum((e.before / e.noise) ** 2 for e in errors.values())
    return sum((e.after / e.noise) ** 2 for e in errors.values()) > times * max(before, len(errors))


def _lasting_leave_more(errors: Mapping[str, SensorError], entries: Sequence[Entry]) -> bool:
    """Return True if effects that stay leave more held-out squares than re-tuning alone.

    An effect that has passed, such as a refill, predicts nothing about what comes later.
    """
    stays = all(e.shape.name in LASTING and not e.candidate.is_event and not e.candidate.begins for e in entries)
    return bool(entries) and stays and leaves_more_squares(errors)


def weights_unreliable(errors: Mapping[str, SensorError], network: Network) -> bool:
    """Return True if an answer is so much worse than none that the weights of the search are in doubt.

    Unknown quantities that were found by the same weights are then unreliable too.
    """
    return leaves_more_squares(errors, MUCH_WORSE) and any(
        _far(network, name, e.means[2], e.usual) for name, e in errors.items()
    )


@dataclass(frozen=True)
class HeldOutRecord:
    """Record with a held-out segment at its end, which the fit of a finding did not use.

    Attributes:
        network: as commissioned.
        record, grid: the record, and its bins, in which a finding names the `split` of fit and held-out segment.
        healthy: noise with all model error, as estimated from a healthy record.
    """

    network: Network
    record: Columns
    grid: Grid
    healthy: Noise | None = None
    _runs: dict[tuple[object, ...], Array] = field(default_factory=dict, repr=False)

    def errors(self, finding: Finding, split: int) -> dict[str, SensorError]:
        """Return the RMSE per sensor from bin `split` on, of free runs from the beginning of a segment."""
        found = finding.retuned, finding.fit or finding.retuned
        runs = [self._run(finding, self.network.values, finding.state)]
        runs += [self._run(finding, f.values, f.state, f.entries) for f in found]
        usual = self._usual(finding, split)
        out = {}
        for j, name in enumerate(self.network.sensor_names):
            off = [self._off(run, split, j) for run in runs]
            raw = [_rms(x) for x in off]
            means = [self._mean(x) for x in off]
            if np.isfinite(raw[0]):
                of_means = (means[0], means[1], means[2])
                noise = float(self.network.sigma[j])
                apart = self._mean(off[2] - off[1])
                out[name] = SensorError(raw[0], raw[1], raw[2], noise, of_means, float(usual[j]), apart)
        return out

    def exceeds_usual(self, finding: Finding, split: int) -> bool:
        """Return True if an answer's error from bin `split` on is larger than usual, or than that of re-tuning.

        The fit may then need more of the record. Stricter than `contradicted`: errors of all sensors count.
        """
        if _lasting_leave_more(self.errors(finding, split), finding.entries):
            return True
        run, usual = self._answered(finding), self._usual(finding, split)
        return any(
            _far(self.network, name, self._mean(self._off(run, split, j)), float(usual[j]))
            for j, name in enumerate(self.network.sensor_names)
        )

    def left(self, finding: Finding, split: int) -> float:
        """Return the squares that an answer leaves from bin `split` on, over all sensors, over the usual ones."""
        run = self._answered(finding)
        off = np.array([_rms(self._off(run, split, j)) for j in range(len(self.network.sensors))])
        return float(np.nansum((off / np.maximum(self.network.sigma, self._usual(finding, split))) ** 2))

    def _answered(self, finding: Finding) -> Array:
        found = finding.fit or finding.retuned
        return self._run(finding, found.values, found.state, found.entries)

    def _run(self, finding: Finding, values: Array, state: Array, entries: tuple[Entry, ...] = ()) -> Array:
        """Return the readings (N, m), degC, of a free run; the latest runs are cached, as an answer is evaluated
        repeatedly.
        """
        key = (values.tobytes(), state.tobytes(), *((e.candidate.id, e.shape, e.size) for e in entries))
        if key not in self._runs:
            inputs = bridged(self.network, self.record.time_s, self.record.inputs)
            model, time = Model.of(finding.score_test.probe, entries), self.record.time_s
            begins = tuple(int(np.searchsorted(time, self.grid.time[b])) for b in self.grid.begins)
            state = model.begun(time, inputs, self._measured, state, values, begins)
            sizes = np.array([[e.size for e in entries]])
            while len(self._runs) >= CACHED_RUNS:
                del self._runs[next(iter(self._runs))]
            self._runs[key] = model.run(time, inputs, state[None], values[None, :], sizes, begins=begins)[0]
        return self._runs[key]

    def _off(self, run: Array, split: int, sensor: int) -> Array:
        """Return measured minus simulated (N,) of a sensor, NaN before bin `split`."""
        late = self.record.time_s >= self.grid.time[split]
        return np.where(late, self._measured[:, sensor] - run[:, sensor], np.nan)

    @cached_property
    def _measured(self) -> Array:
        """Return the readings (N, m), with NaN in gaps in which the inputs are unknown."""
        lost = find_segments(self.network, self.record.time_s, self.record.inputs).lost
        return np.where(lost[:, None], np.nan, self.record.measured)

    def _mean(self, off: Array) -> float:
        """Return the root mean square of means over a bin."""
        return _rms(binned(off, self.record.time_s, self.grid))

    def _begun(self, finding: Finding) -> Array:
        """Return the initial states of a finding, with those of the segments that it was not fitted to."""
        if len(finding.score_test.grid.begins) == len(self.grid.begins):
            return finding.state
        return np.concatenate([finding.state, finding.score_test.probe.first_state(self.grid)[len(finding.state) :]])

    def _usual(self, finding: Finding, split: int) -> Array:
        """Return the error (m,), K, of means over a bin to expect in health; 0 without a healthy record."""
        if self.healthy is None:
            return np.zeros(len(self.network.sensors))
        here = finding.score_test.probe.run(self.grid, self._begun(finding)).readings[split:]
        return self.healthy.where_moved(here, self.grid.step_s, self.grid.resolution).rms(len(here))


def _far(network: Network, sensor: str, means: float, usual: float) -> bool:
    """Return True if the error of means over a bin, K, is larger than is usual in a held-out segment.

    The limit for a mean of several thermometers is a larger multiple of its noise: model error does not average out.
    """
    return means > max(FAR_OFF * network.parameters[f"{sensor}.sigma"].value, UNUSUAL * usual)


def binned(values: Array, time: Array, grid: Grid) -> Array:
    """Return the means (n,) over the bins of a grid of values (N,) at times (N,), s; NaN for a bin without a value."""
    where = np.minimum(((time - grid.time[0]) / grid.step_s + 1e-9).astype(np.intp), len(grid.time) - 1)
    good = np.isfinite(values)
    count = np.bincount(where[good], minlength=len(grid.time))
    total = np.bincount(where[good], values[good], len(grid.time))
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _rms(values: Array) -> float:
    """Return the root mean square of the finite values; NaN without any."""
    good = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(good**2))) if good.size else float("nan")
