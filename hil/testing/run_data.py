"""Data of a run that limits judge: values on the profile's clock, twins, trips and the diagnosis."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from drivers.signals import Quality
from hil.journal import ENDED, NO_TICK, JournalReader, RunEvent, State, StateRow, profile_times, samples_sha256
from hil.run_folder import DiagnosisVerdict, RunFolder, read_diagnosis_verdict
from hil.testing.bound_limits import RigSignals

Floats = NDArray[np.float64]
_SAME = 1e-6
"""Share of a tick by which two times may differ and still be the same."""


_BY_TEST = re.compile(r"test [A-Za-z0-9_.:-]+: limit ")
"""Begin of the reason of a trip that a limit of a test has asked for (see `hil.testing.live`)."""


@dataclass(frozen=True, slots=True)
class Trip:
    """Trip or failure of a run at `at_s`, s of profile time.

    `by` is `test` where a limit of a test plan has tripped the run, `bench` for a fault of the bench itself (journal,
    guardian, a process that was paused, a defect), else `protection`: interlocks, the rig's own trip, a lost link.
    """

    reason: str
    at_s: float
    by: Literal["protection", "test", "bench"] = "protection"


@dataclass(frozen=True, slots=True)
class StandingTicks:
    """Values of the ticks on which the profile stood: at `time_s` (m,), s of profile time, by column (m,).

    A run stands while it is held, paused, suspended or in a thermal restore. `as_profile` (m,) is True where
    the outputs were those of the profile, and not at their safe values or those of a thermal restore.
    """

    time_s: Floats
    columns: Mapping[str, Floats]
    as_profile: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class RunData:
    """Values of a run at `time_s` (n,), s of profile time, of the ticks on which the profile went on.

    `columns` are values (n,) by column in the units of their signals, NaN where none is good. `setpoints` names
    those that are commanded. `twins` are predictions (n,) in degC by twin and sensor. `diagnosis` is the verdict of
    the diagnosis, None without one. `trips` are the trips and failures of the run in their order. `has_ended` is
    True for a run that went to its end. `standing` are the ticks on which the profile stood, None where they are
    unknown. `parts` (n,) are numbers that differ for ticks between which the profile stood, None where it never
    did. `reason` states why the run has ended, empty for one that has not.
    """

    time_s: Floats
    columns: Mapping[str, Floats]
    setpoints: tuple[str, ...]
    period_s: float
    duration_s: float
    twins: Mapping[str, Mapping[str, Floats]] = field(default_factory=dict)
    sensors: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    diagnosis: DiagnosisVerdict | None = None
    trips: tuple[Trip, ...] = ()
    has_ended: bool = False
    standing: StandingTicks | None = None
    parts: NDArray[np.int64] | None = None
    reason: str = ""

    @property
    def stood(self) -> NDArray[np.bool_]:
        """Return of each tick (n,) whether the profile stood between it and the tick before."""
        if self.parts is None or not len(self.parts):
            return np.zeros(len(self.time_s), dtype=np.bool_)
        return np.diff(self.parts, prepend=self.parts[0]) != 0

    def measured(self, sensor: str) -> Floats:
        """Return the measured value (n,) of a twin sensor, degC: the mean of its columns, NaN where one is missing.

        A twin predicts the mean of all of them: that of the rest is another quantity.
        """
        return np.mean([self.columns[column] for column in self.sensors[sensor]], axis=0)

    def positions(self) -> NDArray[np.int64]:
        """Return the numbers (n,) of the ticks, counted from 0 s of profile time."""
        return np.rint(self.time_s / self.period_s).astype(np.int64)


def ticks_within(from_s: float, to_s: float, period_s: float) -> range:
    """Return the numbers of all ticks of the profile from `from_s` to `to_s`, s of profile time, with both ends.

    Parameters
    ----------
    from_s, to_s
        Profile times, s; they may lie between two ticks.
    period_s
        Length of a tick, s.
    """
    return range(math.ceil(from_s / period_s - _SAME), math.floor(to_s / period_s + _SAME) + 1)


def longest_piece(flags: NDArray[np.bool_]) -> tuple[int, int]:
    """Return the length of the longest run of True in `flags` (n,), and its beginning; 0 and 0 without any."""
    padded = np.concatenate([[False], flags, [False]])
    edges = np.flatnonzero(padded[1:] != padded[:-1])
    begins, lengths = edges[::2], edges[1::2] - edges[::2]
    if not len(begins):
        return 0, 0
    at = int(np.argmax(lengths))
    return int(lengths[at]), int(begins[at])


def root_mean_square(x: Floats) -> float:
    """Return the root mean square of `x` (n,), at least one; a damaged value may be too large to be squared."""
    most = float(np.max(np.abs(x)))
    return most * float(np.sqrt(np.mean((x / most) ** 2))) if 0.0 < most < math.inf else most


def carried_on(values: Floats) -> Floats:
    """Return `values` (n,) with the last known one where one is missing; NaN before the first."""
    at = np.maximum.accumulate(np.where(np.isfinite(values), np.arange(len(values)), 0))
    return values[at] if len(values) else values


def signals_of_run(reader: JournalReader, source: str) -> RigSignals:
    """Return the names of a recorded run that limits may use; `source` names it in messages."""
    header = reader.header
    return RigSignals(
        header.signals, header.twin_sensors, header.twin_names, header.duration_s, header.period_s, source
    )


def read_run(folder: RunFolder, reader: JournalReader) -> RunData:
    """Return the data of a recorded run; raises JournalError."""
    header, samples, states = reader.header, reader.samples(), reader.states()
    if states:
        time_s = profile_times(states, samples.tick, header.period_s)
        counts = _on_profile(states, samples.tick)
    else:
        time_s, counts = samples.time_s, np.ones(len(samples.tick), dtype=np.bool_)
    rows = np.flatnonzero(counts)
    # On a tick that stopped the clock it had not gone on.
    rows = rows[np.diff(time_s[rows], prepend=-np.inf) > 0.0]
    good = np.where(samples.quality == Quality.GOOD, samples.values, np.nan)
    tick = samples.tick[rows]
    twins = {}
    for name in header.twin_names:
        output = reader.twin_outputs(name)
        at = np.full((len(tick), len(header.twin_sensors)), np.nan)
        known = np.isin(output.tick, tick)
        at[np.searchsorted(tick, output.tick[known])] = output.values[known]
        twins[name] = {sensor: at[:, index] for index, sensor in enumerate(header.twin_sensors)}
    columns = {signal.column: good[:, index] for index, signal in enumerate(header.signals)}
    # The clocks of rig and profile differ in their progress where the profile stood.
    waited_s = np.diff(samples.time_s[rows], prepend=0.0) - np.diff(time_s[rows], prepend=0.0)
    stood = np.setdiff1d(np.arange(len(samples.tick)), rows)
    return RunData(
        time_s[rows],
        {name: values[rows] for name, values in columns.items()},
        tuple(signal.column for signal in header.signals if signal.kind == "setpoint"),
        header.period_s,
        header.duration_s,
        twins,
        header.twin_sensors,
        _diagnosis(folder, samples_sha256(samples.time_s, columns)),
        trips_of(states),
        any(row.target == State.DONE for row in states[-1:]),
        StandingTicks(
            time_s[stood],
            {name: values[stood] for name, values in columns.items()},
            _in_states(states, samples.tick[stood], _has_outputs_of_profile),
        ),
        np.cumsum(waited_s > 0.5 * header.period_s),
        states[-1].reason if states and states[-1].target in ENDED else "",
    )


def _diagnosis(folder: RunFolder, sha256: str) -> DiagnosisVerdict | None:
    """Return the verdict of the diagnosis, with the doubt that it is not of all samples of the run."""
    found = read_diagnosis_verdict(folder)
    if found is None or found.samples_sha256 == sha256:
        return found
    doubt = (
        "it does not state the samples that it is of"
        if found.samples_sha256 is None
        else "it is of other samples than the run has now"
    )
    return replace(found, doubts=(*found.doubts, doubt))


def _in_states(
    states: Sequence[StateRow], tick: NDArray[np.int64], wanted: Callable[[StateRow], bool]
) -> NDArray[np.bool_]:
    """Return the ticks (n,) that were read in a state that is `wanted`; a tick is read before its transitions."""
    if not states:
        return np.zeros(len(tick), dtype=np.bool_)
    before = np.searchsorted(np.array([row.tick for row in states]), tick, side="left") - 1
    is_wanted = np.array([wanted(row) for row in states])
    return np.asarray(np.where(before >= 0, is_wanted[np.maximum(before, 0)], False))


def _goes_on(row: StateRow) -> bool:
    return bool(row.target == State.RUNNING)


def _has_outputs_of_profile(row: StateRow) -> bool:
    """Return True where outputs are those of the profile; a thermal restore that is held keeps its own."""
    return _goes_on(row) or (row.target == State.HELD and row.source == State.RUNNING)


def _on_profile(states: Sequence[StateRow], tick: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return the ticks (n,) that were read while the profile went on, or at its very beginning."""
    first = next((row.tick for row in states if row.target == State.RUNNING), -1)
    return np.asarray(_in_states(states, tick, _goes_on) | (tick == first))


def trips_of(states: Sequence[StateRow]) -> tuple[Trip, ...]:
    """Return all trips and failures in the transitions of a run, each reason once.

    What fails before the profile has begun, such as a rig that is off, is none: nothing was tested then.
    """
    events = (RunEvent.TRIP.value, RunEvent.FAIL.value, RunEvent.FAULT.value)
    first = next((place for place, row in enumerate(states) if row.target == State.RUNNING), len(states))
    found: dict[str, Trip] = {}
    for row in states[first:]:
        if row.event in events:
            found.setdefault(row.reason, Trip(row.reason, row.profile_s, _tripped_by(row)))
    return tuple(found.values())


def _tripped_by(row: StateRow) -> Literal["protection", "test", "bench"]:
    said = row.reason.removeprefix("tripped: ")
    if row.event == RunEvent.FAULT.value or said.startswith(NO_TICK):
        return "bench"
    return "test" if _BY_TEST.match(said) else "protection"
