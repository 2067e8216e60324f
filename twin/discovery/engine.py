"""Diagnosis from end to end: residual, score test, fit, verdict, errors on the held-out segment."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from twin.discovery.answer.assessed_finding import AssessedFinding
from twin.discovery.answer.leads import with_leads
from twin.discovery.answer.own_course import claimed
from twin.discovery.answer.verdict import conclude
from twin.discovery.diagnosis import Diagnosis
from twin.discovery.effects.phrases import clock
from twin.discovery.evidence.commissioned import (
    as_commissioned,
    as_under_another_load,
    nothing,
    retuned_alone,
)
from twin.discovery.evidence.held_out import binned
from twin.discovery.evidence.later_records import reranked
from twin.discovery.evidence.part import Part
from twin.discovery.evidence.split_search import SplitSearch
from twin.discovery.healthy.basis import Basis, Columns, basis
from twin.discovery.healthy.operating_range import with_range_notes
from twin.discovery.planning.experiment import Limits
from twin.discovery.planning.forecast import Forecast, either, forecast, plan_of, too_little, too_still, unseen_kinds
from twin.discovery.records.grid import Grid, on_grid, sample_period
from twin.discovery.records.standstill import Standstill, standstill
from twin.discovery.records.stuck_readings import Stuck, stuck
from twin.discovery.scoring.score_tests import ScoreTest, block_edges
from twin.discovery.thermometers.faulty_thermometers import (
    faulty_thermometers,
    unlisted_fault,
    with_faults,
    without_faults,
)
from twin.discovery.thermometers.members import Members, members
from twin.network import Array, Network, TwinFileError, mean_of_sensors
from twin.segments import CLOCK_PREFIX, LONG_GAP_S, Segments, find_segments
from twin.steady import steady_state

HELD_OUT = 0.25


def diagnose(
    network: Network,
    record: Columns,
    healthy: Columns | None = None,
    *,
    more: tuple[Columns, ...] = (),
    say: Callable[[str], None] = lambda _: None,
    held_out: float = HELD_OUT,
    limits: Limits | None = None,
) -> Diagnosis:
    """Isolate the effect that explains the residual of a record, or report that none is needed, or that none fits.

    Parameters
    ----------
    network
        The commissioned twin.
    healthy
        The record that it was commissioned on, as `CommissionedRecord` where the twin may have adopted effects since.
    more
        Records made later on the same rig, which rank the causes of an ambiguity group of this record.
    say
        Called with a description of each step.
    held_out
        Share of the record, at its end, that is held out of every fit.
    limits
        Of the rig, for the next experiment; by default the experiment stays within the record's own range.

    Raises
    ------
    TwinFileError
        A record too short or without readings, a healthy record that is not healthy.
    """
    return claimed(_isolated(network, record, healthy, more=more, say=say, held_out=held_out, limits=limits))


def _isolated(
    network: Network,
    record: Columns,
    healthy: Columns | None,
    *,
    more: tuple[Columns, ...],
    say: Callable[[str], None],
    held_out: float,
    limits: Limits | None,
) -> Diagnosis:
    """Return the diagnosis before an effect with a course of its own is claimed; arguments as of `diagnose`."""
    say("reading")
    given = record
    record, unread = _comparable(network, record, healthy)
    gaps = find_segments(network, record.time_s, record.inputs)
    record, stood = _moving(network, record, healthy)
    # Before its inputs are known the twin cannot begin, and after that it cannot go on.
    given_s, rows = given.time_s, slice(*find_segments(network, record.time_s, record.inputs).known)
    given, record = given.part(rows), record.part(rows)
    record, still = _without_stuck(network, record)
    grid = on_grid(network, record.time_s, record.inputs, record.measured)
    known = basis(network, healthy, grid, sample_period(record.time_s))
    single = _members(known, record, grid, healthy, block_edges(len(grid.time)))

    def again(other: Columns) -> Diagnosis:
        return _isolated(network, other, healthy, more=more, say=say, held_out=held_out, limits=limits)

    start = float(grid.time[0])
    faulty = faulty_thermometers(single)
    if faulty is not None:
        left = again(without_faults(faulty, network, replace(record, inputs=given.inputs)))
        apart = with_faults(faulty, left, network, start, still)
        if faulty.settled or left.verdict != "unexplained":
            return apart
    say("scanning")
    split_search, answer = SplitSearch.of(network, record, known, grid, say).settled(held_out)
    known, whole = split_search.known, split_search.whole
    finding, split = answer.finding, answer.split
    notes = [*unread, *_said(known, gaps, stood), *_without_inputs(gaps, given_s), *answer.notes]
    answers = [e.candidate for r in finding.ranked for e in r.entries]
    whole.know(answers)
    further: list[Part] = []
    if more and len(finding.ranked) > 1:
        say("comparing with further records")
        further = [split_search.part(on_grid(network, r.time_s, r.inputs, r.measured)) for r in more]
        for each in further:
            each.know(answers)
        finding, decided = reranked(finding, answer.train, further)
        notes += decided
    off = split_search.held_out_errors(finding, split)
    # Without a healthy record nothing else tells how much a lumped twin leaves of a healthy rig.
    usual = healthy is None and as_commissioned(network, off)
    if usual:
        finding, off = nothing(finding), retuned_alone(off)
    if finding.fit is None:
        usual = usual or (healthy is None and as_under_another_load(network, off))
        notes += _hidden(whole, known)
        unseen = unseen_kinds(whole.score_test, whole.laws, known.book.candidates)
        notes += [f"this record could not have shown any {' or '.join(unseen)}"] if unseen else []
    say("judging")
    case = AssessedFinding(
        finding=finding,
        known=known,
        whole=whole.score_test,
        grid=grid,
        split=split,
        errors=off,
        free=whole.free,
        laws=whole.laws,
        usual=usual,
        single=single,
        still=still,
        limits=limits,
        later=tuple(part.grid for part in further),
    )
    found = conclude(case, tuple(notes))
    found = with_range_notes(found, network, record, healthy)
    found = with_leads(found, case, record, healthy)
    if faulty is not None:
        # With its course taken off nothing explains the rest: the course was not all its own.
        return apart if found.verdict == "unexplained" else found
    faulty = unlisted_fault(single) if found.verdict == "unexplained" else None
    if faulty is None:
        return found
    left = again(without_faults(faulty, network, replace(record, inputs=given.inputs)))
    left = with_faults(faulty, left, network, start, still)
    return found if left.verdict in ("effect found", "ambiguous") else left


def _said(known: Basis, *others: Segments | Standstill | None) -> list[str]:
    """Return the notes about a healthy record and about a record's gaps and standstills."""
    said = (known, known.structure, known.missing, known.bootstrap, *others)
    return [told.sentence for told in said if told is not None and told.sentence]


def _without_inputs(gaps: Segments, time_s: Array) -> list[str]:
    """Return notes about the beginning and the end of a record, times (N,) s, where its inputs are unknown for long."""
    first_s, last_s = time_s[slice(*gaps.known)][[0, -1]]
    notes = []
    if first_s - time_s[0] > LONG_GAP_S:
        notes.append(f"the inputs are unknown before {clock(first_s)}: the diagnosis begins there")
    if time_s[-1] - last_s > LONG_GAP_S:
        notes.append(f"the inputs are unknown after {clock(last_s)}: the diagnosis ends there")
    return notes


def _hidden(whole: Part, known: Basis) -> list[str]:
    """Return a note if the record excites too little to detect most effects, though its inputs moved enough.

    Raises
    ------
    TwinFileError
        The inputs did not move enough.
    """
    candidates = known.book.candidates
    kinds = too_little(whole.score_test, whole.laws, candidates)
    if not kinds:
        return []
    white = known.noise.of_thermometers()
    quiet = ScoreTest(known.probe, whole.grid, whole.state, whole.run, white, known.prior)
    if too_little(quiet, whole.laws, candidates):
        raise TwinFileError(too_still(whole.score_test, kinds))
    return [f"beside what this twin leaves in health, the record could only have shown a very large {either(kinds)}"]


def _comparable(network: Network, record: Columns, healthy: Columns | None) -> tuple[Columns, list[str]]:
    """Return the record without the readings of sensors that the healthy record lacks, and a note on those missing in
    either.
    """
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


def _moving(network: Network, record: Columns, healthy: Columns | None) -> tuple[Columns, Standstill | None]:
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


def _members(
    told: Basis, record: Columns, grid: Grid, healthy: Columns | None, edges: np.ndarray
) -> tuple[Members, ...]:
    """Return the single thermometers that the record and a healthy one have.

    Thermometers of a place where an effect was adopted between the two are left out: their differences have changed.
    """
    if healthy is None or not record.members:
        return ()
    network = told.probe.network
    ours = {s.name for s in network.sensors if s.node not in told.taken_up}
    known = on_grid(network, healthy.time_s, healthy.inputs, healthy.measured)

    def means(columns: Columns, on: Grid) -> dict[str, Array]:
        return {
            name: np.column_stack([binned(one, columns.time_s, on) for one in each.T])
            for name, each in columns.members.items()
            if name in ours
        }

    return members(network, means(record, grid), grid, means(healthy, known), known, edges)


def foresee(network: Network, record: Columns, healthy: Columns | None = None) -> Forecast:
    """Return the detectability and isolability of effects in a record with these inputs; only its first readings are
    used.

    Raises
    ------
    TwinFileError
        As `diagnose`.
    """
    grid = on_grid(network, record.time_s, record.inputs, record.measured)
    known = basis(network, healthy, grid)
    return forecast(known, grid)


def foresee_plan(network: Network, time: Array, inputs: Array, healthy: Columns) -> Forecast:
    """Return the detectability and isolability of effects in a record of a planned profile that begins at steady state.

    Parameters
    ----------
    time
        (n,) s, evenly spaced.
    inputs
        (n, c).
    healthy
        The record that the twin was commissioned on, for noise.

    Raises
    ------
    TwinFileError
        As `basis`.
    """
    grid = plan_of(network, time, inputs)
    known = basis(network, healthy, grid)
    rest = steady_state(network, inputs[0]).reshape(-1)
    return forecast(known, grid, rest)
