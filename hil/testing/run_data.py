"""Data of a run that limits judge: values on the profile's clock, twins, trips and the diagnosis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.signals import Quality
from hil.journal import JournalReader, RunEvent, State, StateRow, profile_times
from hil.run_folder import RunFolder, read_diagnosis_verdict
from hil.testing.bound_limits import RigSignals

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class RunData:
    """Values of a run at `time_s` (n,), s of profile time, of the ticks on which the profile went on.

    `columns` are values (n,) by column in the units of their signals, NaN where none is good. `setpoints` names those
    that are commanded. `twins` are predictions (n,) in degC by twin and sensor. `diagnosis` is the verdict of the
    diagnosis and its sentence, None without one. `trips` are the trips of the run, a sentence each. `has_ended` is True
    for a run that went to its end.
    """

    time_s: Floats
    columns: Mapping[str, Floats]
    setpoints: tuple[str, ...]
    period_s: float
    duration_s: float
    twins: Mapping[str, Mapping[str, Floats]] = field(default_factory=dict)
    sensors: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    diagnosis: tuple[str, str] | None = None
    trips: tuple[str, ...] = ()
    has_ended: bool = False

    def measured(self, sensor: str) -> Floats:
        """Return the measured value (n,) of a twin sensor, degC: the mean of its good columns, NaN without one."""
        block = np.array([self.columns[column] for column in self.sensors[sensor]])
        count = np.isfinite(block).sum(axis=0)
        return np.where(count > 0, np.nansum(block, axis=0) / np.maximum(count, 1), np.nan)


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
    good = np.where(samples.quality == Quality.GOOD, samples.values, np.nan)[rows]
    tick = samples.tick[rows]
    twins = {}
    for name in header.twin_names:
        output = reader.twin_outputs(name)
        at = np.full((len(tick), len(header.twin_sensors)), np.nan)
        known = np.isin(output.tick, tick)
        at[np.searchsorted(tick, output.tick[known])] = output.values[known]
        twins[name] = {sensor: at[:, index] for index, sensor in enumerate(header.twin_sensors)}
    return RunData(
        time_s[rows],
        {signal.column: good[:, index] for index, signal in enumerate(header.signals)},
        tuple(signal.column for signal in header.signals if signal.kind == "setpoint"),
        header.period_s,
        header.duration_s,
        twins,
        header.twin_sensors,
        read_diagnosis_verdict(folder),
        trips_of(states),
        any(row.target == State.DONE for row in states[-1:]),
    )


def _on_profile(states: Sequence[StateRow], tick: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return the ticks (n,) that were read while the profile went on, or at its very beginning.

    A tick is read before the transitions that it causes.
    """
    before = np.searchsorted(np.array([row.tick for row in states]), tick, side="left") - 1
    goes = np.array([row.target == State.RUNNING for row in states])
    first = next((row.tick for row in states if row.target == State.RUNNING), -1)
    return np.asarray(np.where(before >= 0, goes[np.maximum(before, 0)], False) | (tick == first))


def trips_of(states: Sequence[StateRow]) -> tuple[str, ...]:
    """Return the reasons of all trips and failures in the transitions of a run."""
    events = (RunEvent.TRIP.value, RunEvent.FAIL.value)
    return tuple(dict.fromkeys(row.reason for row in states if row.event in events))
