"""Record as it can be diagnosed: with the readings that a healthy record has too, and without standstills."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin.discovery.effects.phrases import clock
from twin.discovery.healthy.basis import Columns
from twin.discovery.records.standstill import Standstill, standstill
from twin.discovery.records.stuck_readings import Stuck, stuck
from twin.network import Array, Network, mean_of_sensors
from twin.segments import CLOCK_PREFIX, LONG_GAP_S, Segments, find_segments


@dataclass(frozen=True)
class ComparableRecord:
    """Record without readings that cannot be compared with the healthy one, and the reasons.

    Attributes:
        record: from the first to the last row with known inputs, NaN where pump or fan stood still or a reading stuck.
        inputs: (N, c) of the same rows as they were given.
        stuck: stuck thermometers, and when. gaps: spans of unknown inputs. standstill: None without a healthy record,
            or if nothing stood still that never did in health.
        missing: notes about sensors without readings. cut: notes about the record's cut ends.
    """

    record: Columns
    inputs: Array
    stuck: tuple[Stuck, ...]
    gaps: Segments
    standstill: Standstill | None
    missing: list[str]
    cut: list[str]

    @classmethod
    def of(cls, network: Network, given: Columns, healthy: Columns | None) -> ComparableRecord:
        """Return the comparable part of a record."""
        record, missing = _with_common_sensors(network, given, healthy)
        gaps = find_segments(network, record.time_s, record.inputs)
        record, stood = _without_standstills(network, record, healthy)
        # Before its inputs are known the twin cannot begin, and after that it cannot go on.
        rows = slice(*find_segments(network, record.time_s, record.inputs).known)
        record, still = _without_stuck(network, record.part(rows))
        return cls(record, given.inputs[rows], still, gaps, stood, missing, _notes_on_cut_ends(gaps, given.time_s))

    def with_given_inputs(self) -> Columns:
        """Return the record with its inputs as they were given, for another diagnosis of it."""
        return replace(self.record, inputs=self.inputs)


def _with_common_sensors(network: Network, record: Columns, healthy: Columns | None) -> tuple[Columns, list[str]]:
    """Return the record without the readings of sensors that the healthy record lacks, and notes on missing ones."""
    measured, notes = record.measured.copy(), []
    for j, name in enumerate(network.sensor_names):
        if not np.isfinite(measured[:, j]).any():
            notes.append(f"{name} has no reading in this record: what is there is told by the others")
        elif healthy is not None and not np.isfinite(healthy.measured[:, j]).any():
            measured[:, j] = np.nan
            notes.append(f"{name} is left aside, as the healthy record has no reading of it")
        elif healthy is not None and name in record.members and name in healthy.members:
            here, then = record.members[name], healthy.members[name]
            seen, whole = np.asarray(np.isfinite(here).any(axis=0)), np.asarray(np.isfinite(then).all(axis=1))
            # The mean of fewer thermometers than were there in health is another one.
            if not seen.all() and whole.any():
                measured[:, j] -= float((then[whole][:, seen].mean(axis=1) - then[whole].mean(axis=1)).mean())
                missing = [c for i, c in enumerate(network.sensors[j].measured) if not seen[i]]
                notes.append(f"{' and '.join(missing)} is not in this record: {name} is the mean of the others")
    return replace(record, measured=measured), notes


def _without_standstills(
    network: Network, record: Columns, healthy: Columns | None
) -> tuple[Columns, Standstill | None]:
    """Return the record without the periods in which pump or fan stood still and never did so in health."""
    if healthy is None:
        return record, None
    stood = standstill(network, record.time_s, record.inputs, healthy.inputs)
    if not stood.count:
        return record, None
    inputs, measured = record.inputs.copy(), record.measured.copy()
    driven = np.array([not c.endswith("_C") and not c.startswith(CLOCK_PREFIX) for c in network.input_columns])
    inputs[stood.rows[:, None] & driven] = np.nan
    measured[stood.rows] = np.nan
    members = {name: np.where(stood.rows[:, None], np.nan, each) for name, each in record.members.items()}
    return replace(record, inputs=inputs, measured=measured, members=members), stood


def _without_stuck(network: Network, record: Columns) -> tuple[Columns, tuple[Stuck, ...]]:
    """Return the record without the readings of stuck thermometers, and what was removed."""
    found: list[Stuck] = []
    measured = record.measured.copy()
    members = {name: each.copy() for name, each in record.members.items()}
    for j, sensor in enumerate(network.sensors):
        sigma = network.parameters[f"{sensor.name}.sigma"].value
        each = members.get(sensor.name)
        columns = measured[:, j : j + 1] if each is None else each
        names = sensor.measured if each is not None else sensor.measured[:1]
        spans = [s for i, name in enumerate(names) for s in stuck(name, record.time_s, columns[:, i], sigma)]
        for span in spans:
            columns[span.rows, names.index(span.column)] = np.nan
        if spans and each is not None:
            measured[:, j] = mean_of_sensors(each)
        found += spans
    return replace(record, measured=measured, members=members), tuple(found)


def _notes_on_cut_ends(gaps: Segments, time_s: Array) -> list[str]:
    """Return notes about the beginning and the end of a record, times (N,) s, where its inputs are unknown for long."""
    first_s, last_s = time_s[slice(*gaps.known)][[0, -1]]
    notes = []
    if first_s - time_s[0] > LONG_GAP_S:
        notes.append(f"the inputs are unknown before {clock(first_s)}: the diagnosis begins there")
    if time_s[-1] - last_s > LONG_GAP_S:
        notes.append(f"the inputs are unknown after {clock(last_s)}: the diagnosis ends there")
    return notes
