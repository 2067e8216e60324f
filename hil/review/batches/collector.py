"""Collector of a journal's new rows as column batches for the review, in the order that they appear."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drivers.signals import Quality
from hil.journal import CalibrationRow, JournalReader, JournalSamples, TwinOutput
from hil.review.batches.columns import Estimates, ReviewBatch, Rows, States, Texts
from hil.review.batches.residuals import Residuals
from hil.review.batches.twin_bands import Proposals, band_batches
from hil.review.plan import QUALITY_NAMES, ReviewPlan, make_plan, path, worst_state
from twin import NORMAL90

PAGE_TICKS = 36_000
_NOISE_POINTS = 500
_STEPS_OF_NOISE = 8.0
"""Least steps of residuals in a standard deviation of the sensor's noise. A power of two halves the size in a file, and
no figure shows so small a step.
"""
_CURVE_OF_NOISE = 20.0
"""Largest error of predictions in a file, as a share of the sensor's noise; see `hil.review.batches.thinning`."""
_ROUTINE_WRITES = ("profile", "slew", "restore", "soak")  # the last one in older journals


class _Ticks:
    """Growing table of each tick's sensor means, so that a twin may answer late: `tick (n,)`, `means (n, m)`."""

    def __init__(self, width: int) -> None:
        self._tick = np.empty(1024, dtype=np.int64)
        self._means = np.empty((1024, width))
        self._count = 0

    @property
    def last(self) -> int:
        return int(self._tick[self._count - 1]) if self._count else -1

    def append(self, tick: NDArray[np.int64], means: NDArray[np.float64]) -> None:
        count = self._count + len(tick)
        if count > len(self._tick):
            room = max(count, 2 * len(self._tick))
            self._tick = np.resize(self._tick, room)
            self._means = np.resize(self._means, (room, self._means.shape[1]))
        self._tick[self._count : count], self._means[self._count : count] = tick, means
        self._count = count

    def at(self, tick: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the means at `tick (n,)`, shape (n, m); NaN for ticks without a sample."""
        known = self._tick[: self._count]
        where = np.minimum(np.searchsorted(known, tick), self._count - 1)
        means = self._means[where].copy()
        means[known[where] != tick] = np.nan
        return means


class BatchCollector:
    """Reader of new rows of a journal. Not thread-safe."""

    def __init__(self, reader: JournalReader) -> None:
        self._reader = reader
        header = reader.header
        self._columns = {signal.column: i for i, signal in enumerate(header.signals)}
        self._watched = [i for i, signal in enumerate(header.signals) if signal.kind != "status"]
        self.plan: ReviewPlan = make_plan(header)
        self._ticks = _Ticks(len(header.twin_sensors))
        self._twin_tick = dict.fromkeys(header.twin_names, -1)
        self._residuals = Residuals(header.twin_names, len(header.twin_sensors))
        self._states: dict[str, str] = {}
        self._spans_so_far: dict[str, tuple[str | None, float]] = {}
        self._units: dict[str, str] = {}
        self._commissioned: dict[str, float] = {}
        self._proposals = Proposals()
        self._ids = {"calibrations": 0, "proposals": 0, "bands": 0, "writes": 0, "events": 0, "states": 0}
        self._noise_mark = -1
        self._cuts = np.zeros(0)
        self.end_s = 0.0

    def finished(self) -> bool:
        """Return True if the run has ended. Call it before `poll`; then `poll` reads the rest until it is empty."""
        return self._reader.meta("exit_status") is not None

    def poll(self, *, last: bool = False) -> Iterator[ReviewBatch]:
        """Return all rows committed since the last call, at most `PAGE_TICKS` ticks of a table.

        Residuals wait for the twins that answer late, unless this is the `last` call.
        """
        self._cuts = np.array([row.time_s for row in self._reader.segments()])
        read = PAGE_TICKS
        while read == PAGE_TICKS:
            samples = self._reader.samples(self._ticks.last, PAGE_TICKS)
            read = len(samples.tick)
            if read:
                yield from self._samples(samples)
        for twin in self._reader.header.twin_names:
            read = PAGE_TICKS
            while read == PAGE_TICKS:
                output = self._reader.twin_outputs(twin, self._twin_tick[twin], PAGE_TICKS)
                read = len(output.tick)
                # A commit between the two queries may bring predictions for samples that are not read yet.
                known = int(np.searchsorted(output.tick, self._ticks.last, side="right"))
                if known:
                    yield from self._twin(output, known)
                if known < read:
                    break
        yield from self._residual(last)
        calibrations = self._reader.calibrations(self._ids["calibrations"])
        yield from self._bands_and_proposals()
        yield from self._calibrations(calibrations)
        yield from self._texts()

    def _bands_and_proposals(self) -> Iterator[ReviewBatch]:
        bands = self._reader.bands(self._ids["bands"])
        if bands:
            self._ids["bands"] = bands[-1].id
            yield from band_batches(bands)
        proposals = self._reader.proposals(self._ids["proposals"])
        if proposals:
            self._ids["proposals"] = proposals[-1].id
            known = self._proposals.calibrators
            yield from self._proposals.batches(proposals, self._units)
            if self._proposals.calibrators != known:
                self._plan_again()

    def _noise(self, time_s: NDArray[np.float64]) -> Iterator[ReviewBatch]:
        """Return zero and noise lines up to the present; otherwise a live view would follow them to the planned end."""
        header = self._reader.header
        marks = np.floor(time_s * (_NOISE_POINTS / header.duration_s)).astype(np.int64)
        before = np.concatenate([[self._noise_mark], marks[:-1]])
        ends = time_s[marks != before]
        self._noise_mark = int(marks[-1])
        if not len(ends):
            return
        for sensor in header.twin_sensors:
            sigma = header.noise_K.get(sensor)
            levels = [0.0] if sigma is None else [0.0, 2 * sigma, -2 * sigma]
            yield Rows(path("sensors", sensor, "noise"), ends, np.tile(levels, (len(ends), 1)))

    def _samples(self, samples: JournalSamples) -> Iterator[ReviewBatch]:
        good = np.where(samples.quality == Quality.GOOD, samples.values, np.nan)
        for entity, columns in self.plan.columns_of.items():
            yield self._rows(entity, samples.time_s, good[:, [self._columns[column] for column in columns]])
        means = np.empty((len(samples.tick), len(self._reader.header.twin_sensors)))
        for k, (sensor, columns) in enumerate(self._reader.header.twin_sensors.items()):
            parts = good[:, [self._columns[column] for column in columns]]
            present = np.isfinite(parts).sum(axis=1)
            total = np.nansum(parts, axis=1)
            # A single column is passed on unchanged: a sum would turn -0.0 into 0.0 and a mean may round.
            means[:, k] = (
                parts[:, 0] if len(columns) == 1 else np.where(present > 0, total / np.maximum(present, 1), np.nan)
            )
            yield self._rows(path("sensors", sensor, "measured"), samples.time_s, means[:, k : k + 1])
        yield from self._noise(samples.time_s)
        self._ticks.append(samples.tick, means)
        self.end_s = float(samples.time_s.max())
        for column, k in self._columns.items():
            states = samples.quality[:, k : k + 1]
            yield from self._lane(path("quality", column), samples.time_s, states, _quality_name)
        watched = samples.quality[:, self._watched]
        names = [signal.column for signal in self._reader.header.signals]

        def worst(row: NDArray[np.uint8]) -> str:
            bad = np.flatnonzero(row)
            return worst_state([names[self._watched[i]] for i in bad], row[bad].tolist())

        yield from self._lane("/quality", samples.time_s, watched, worst)

    def _rows(self, entity: str, time_s: NDArray[np.float64], values: NDArray[np.float64]) -> Rows:
        """Return a curve with a gap at each interruption of the run."""
        cuts = self._cuts[(self._cuts >= time_s[0]) & (self._cuts <= time_s[-1])]
        at = np.searchsorted(time_s, cuts)
        just_before = cuts - 0.5 * self._reader.header.period_s
        return Rows(entity, np.insert(time_s, at, just_before), np.insert(values, at, np.nan, axis=0))

    def _lane(
        self,
        entity: str,
        time_s: NDArray[np.float64],
        rows: NDArray[np.uint8],
        name: Callable[[NDArray[np.uint8]], str],
    ) -> Iterator[ReviewBatch]:
        """Return changes of state along `rows (n, k)`, distinguished by value and named by `name`."""
        changed = np.flatnonzero((rows[1:] != rows[:-1]).any(axis=1)) + 1
        times, states = [], []
        last = self._states.get(entity)
        for i in (0, *changed.tolist()):
            state = name(rows[i])
            if state != last:
                times.append(float(time_s[i]))
                states.append(state)
                last = state
        if states:
            self._states[entity] = states[-1]
            yield States(entity, np.array(times), list(states))

    def _twin(self, output: TwinOutput, count: int) -> Iterator[ReviewBatch]:
        time_s, values = output.time_s[:count], output.values[:count]
        self._residuals.add(output.twin, output.tick[:count], time_s, self._ticks.at(output.tick[:count]) - values)
        header = self._reader.header
        for k, sensor in enumerate(header.twin_sensors):
            rows = self._rows(path("sensors", sensor, "twin", output.twin), time_s, values[:, k : k + 1])
            yield replace(rows, tolerance=header.noise_K.get(sensor, 0.0) / _CURVE_OF_NOISE)
        self._twin_tick[output.twin] = int(output.tick[count - 1])

    def _residual(self, last: bool) -> Iterator[ReviewBatch]:
        """Return measured minus predicted of all twins: for each sensor as many rows as for one twin."""
        time_s, residual = self._residuals.take(last=last)
        if not len(time_s):
            return
        header = self._reader.header
        for k, sensor in enumerate(header.twin_sensors):
            sigma = header.noise_K.get(sensor)
            step = 0.0 if not sigma else 2.0 ** np.floor(np.log2(sigma / _STEPS_OF_NOISE))
            values = np.round(residual[:, :, k] / step) * step if step else residual[:, :, k]
            yield self._rows(path("sensors", sensor, "residual"), time_s, values)

    def _calibrations(self, windows: list[CalibrationRow]) -> Iterator[ReviewBatch]:
        if not windows:
            return
        self._ids["calibrations"] = windows[-1].id
        self._learn_parameters(windows)
        for calibrator in dict.fromkeys(window.calibrator for window in windows):
            mine = [window for window in windows if window.calibrator == calibrator]
            end_s = np.array([window.end_s for window in mine])
            kinds = [str(window.document.get("kind", "window")) for window in mine]
            yield from self._spans(path("windows", calibrator), mine, kinds)
            flags = ["calibrated" if window.document.get("calibrated") else "not calibrated" for window in mine]
            yield from self._spans(path("calibrated", calibrator), mine, flags)
            errors = [[_number(window.document.get(key)) for key in ("rmse_before_K", "rmse_K")] for window in mine]
            yield Rows(path("fit", calibrator), end_s, np.array(errors))
            yield from self._parameters(calibrator, mine)

    def _spans(self, entity: str, windows: list[CalibrationRow], states: list[str]) -> Iterator[ReviewBatch]:
        """Return a lane of windows: equal neighbours are one span, time between windows is empty."""
        times: list[float] = []
        changes: list[str | None] = []
        last, last_end_s = self._spans_so_far.get(entity, (None, -np.inf))
        for window, state in zip(windows, states, strict=True):
            # A window ends with its last sample, the next begins with the sample after it.
            if last is not None and window.start_s - last_end_s > 0.1 * (window.end_s - window.start_s):
                times.append(last_end_s)
                changes.append(None)
                last = None
            if state != last:
                times.append(window.start_s)
                changes.append(state)
            last, last_end_s = state, window.end_s
        self._spans_so_far[entity] = (last, last_end_s)
        if times:
            yield States(entity, np.array(times), changes)

    def _learn_parameters(self, windows: list[CalibrationRow]) -> None:
        """Add panels for parameters that appear for the first time."""
        names = [name for window in windows for name in window.document.get("parameters", {})]
        if set(names) <= set(self._units):
            return
        self._commissioned = self._reader.meta("commissioned") or {}
        units = self._reader.meta("parameter_units") or {}
        self._units |= {name: units.get(name, "1") for name in names}
        self._plan_again()

    def _plan_again(self) -> None:
        self.plan = make_plan(self._reader.header, self._units, bool(self._commissioned), self._proposals.calibrators)

    def _parameters(self, calibrator: str, windows: list[CalibrationRow]) -> Iterator[ReviewBatch]:
        for name, unit in self._units.items():
            with_it = [window for window in windows if name in window.document.get("parameters", {})]
            if not with_it:
                continue
            end_s = np.array([window.end_s for window in with_it])
            values = np.array([_number(window.document["parameters"][name]) for window in with_it])
            errors = np.array([_number((window.document.get("standard_errors") or {}).get(name)) for window in with_it])
            if calibrator in self._proposals.calibrators:
                errors = np.full_like(errors, np.nan)  # The bands are those of its proposals.
            yield Estimates(
                path("parameters", name, calibrator), calibrator, unit, end_s, values, (NORMAL90 * errors) ** 2
            )
            commissioned = self._commissioned.get(name)
            if commissioned:
                relative = 100.0 * (values / commissioned - 1.0)
                yield Rows(path("relative", calibrator, name), end_s, relative[:, None])

    def _texts(self) -> Iterator[ReviewBatch]:
        states = self._reader.states(self._ids["states"])
        if states:
            self._ids["states"] = states[-1].id
            # Of several states on one tick, the last one is that of the run.
            at = {row.time_s: row.target for row in states}
            yield States("/state", np.array(list(at)), list(at.values()))
        events = self._reader.events(self._ids["events"])
        if events:
            self._ids["events"] = events[-1].id
            time_s = np.array([event.time_s for event in events])
            yield Texts("/events", time_s, [event.text for event in events], [event.level for event in events])
        writes = self._reader.writes(self._ids["writes"])
        if writes:
            self._ids["writes"] = writes[-1].id
        told = [write for write in writes if write.reason not in _ROUTINE_WRITES]
        if told:
            texts = [f"{write.signal} = {write.value:g} ({write.reason})" for write in told]
            levels = ["WARN" if write.reason.startswith("safe") else "INFO" for write in told]
            yield Texts("/writes", np.array([write.time_s for write in told]), texts, levels)


def _quality_name(row: NDArray[np.uint8]) -> str:
    return QUALITY_NAMES[Quality(int(row[0]))]


def _number(value: float | None) -> float:
    return float("nan") if value is None else float(value)
