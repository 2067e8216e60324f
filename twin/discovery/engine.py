"""Diagnosis from end to end: residual, score test, fit, verdict, errors on the held-out segment."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from twin.discovery.answer.assessed_finding import AssessedFinding
from twin.discovery.answer.leads import with_leads
from twin.discovery.answer.own_course import claimed
from twin.discovery.answer.verdict import conclude
from twin.discovery.diagnosis import Diagnosis
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
from twin.discovery.healthy.comparable import ComparableRecord
from twin.discovery.healthy.operating_range import with_range_notes
from twin.discovery.planning.experiment import Limits
from twin.discovery.planning.forecast import Forecast, either, forecast, plan_of, too_little, too_still, unseen_kinds
from twin.discovery.records.grid import Grid, on_grid, sample_period
from twin.discovery.scoring.score_tests import ScoreTest, block_edges
from twin.discovery.thermometers.faulty_thermometers import (
    FaultyThermometers,
    faulty_thermometers,
    unlisted_fault,
    with_faults,
    without_faults,
)
from twin.discovery.thermometers.members import Members, members
from twin.network import Array, Network, TwinFileError
from twin.steady import steady_state

HELD_OUT = 0.25
"""Share of the record, at its end, that is held out of every fit by default. A judgement."""


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
    question = _Question(network, healthy, more, say, held_out, limits)
    return claimed(_isolated(question, record))


@dataclass(frozen=True)
class _Question:
    """Arguments of `diagnose` but for the record, which a diagnosis without a faulty thermometer replaces."""

    network: Network
    healthy: Columns | None
    more: tuple[Columns, ...]
    say: Callable[[str], None]
    held_out: float
    limits: Limits | None


def _isolated(question: _Question, given: Columns) -> Diagnosis:
    """Return the diagnosis before an effect with a course of its own is claimed.

    A thermometer that deviates from others of its place is examined first, and the record then diagnosed without its
    fault. If nothing explains the rest, the fault was not all of the deviation, and the whole record is searched.
    """
    network, healthy = question.network, question.healthy
    question.say("reading")
    comparable = ComparableRecord.of(network, given, healthy)
    record = comparable.record
    grid = on_grid(network, record.time_s, record.inputs, record.measured)
    known = basis(network, healthy, grid, sample_period(record.time_s))
    single = _members(known, record, grid, healthy, block_edges(len(grid.time)))

    def without(faulty: FaultyThermometers) -> tuple[Diagnosis, Diagnosis]:
        """Return the diagnosis without faulty thermometers, and the same with their faults among its effects."""
        left = _isolated(question, without_faults(faulty, network, comparable.with_given_inputs()))
        return left, with_faults(faulty, left, network, float(grid.time[0]), comparable.stuck)

    faulty = faulty_thermometers(single)
    if faulty is not None:
        left, apart = without(faulty)
        if faulty.settled or left.verdict != "unexplained":
            return apart
        found = _searched(question, comparable, grid, known, single)
        # With its course taken off nothing explains the rest: the course was not all its own.
        return apart if found.verdict == "unexplained" else found
    found = _searched(question, comparable, grid, known, single)
    faulty = unlisted_fault(single) if found.verdict == "unexplained" else None
    if faulty is None:
        return found
    _, apart = without(faulty)
    return found if apart.verdict in ("effect found", "ambiguous") else apart


def _searched(
    question: _Question, comparable: ComparableRecord, grid: Grid, known: Basis, single: tuple[Members, ...]
) -> Diagnosis:
    """Return the diagnosis of a record by a search of effects, its held-out errors, and a verdict on both."""
    network, healthy, say, record = question.network, question.healthy, question.say, comparable.record
    say("scanning")
    split_search, answer = SplitSearch.of(network, record, known, grid, say).settled(question.held_out)
    known, whole = split_search.known, split_search.whole
    finding, split = answer.finding, answer.split
    notes = [*comparable.missing, *_sentences(known, comparable), *comparable.cut, *answer.notes]
    answers = [e.candidate for r in finding.ranked for e in r.entries]
    whole.know(answers)
    further: list[Part] = []
    if question.more and len(finding.ranked) > 1:
        say("comparing with further records")
        further = [split_search.further(on_grid(network, r.time_s, r.inputs, r.measured)) for r in question.more]
        for each in further:
            each.know(answers)
        finding, decided = reranked(finding, answer.train, further)
        notes += decided
    errors = split_search.held_out_errors(finding, split)
    # Without a healthy record nothing else tells how much a lumped twin leaves of a healthy rig.
    usual = healthy is None and as_commissioned(network, errors)
    if usual:
        finding, errors = nothing(finding), retuned_alone(errors)
    if finding.fit is None:
        usual = usual or (healthy is None and as_under_another_load(network, errors))
        notes += _undetectable(whole, known)
        unseen = unseen_kinds(whole.score_test, whole.laws, known.book.candidates)
        notes += [f"this record could not have shown any {' or '.join(unseen)}"] if unseen else []
    say("judging")
    case = AssessedFinding(
        finding=finding,
        known=known,
        whole=whole.score_test,
        grid=grid,
        split=split,
        errors=errors,
        free=whole.free,
        laws=whole.laws,
        usual=usual,
        single=single,
        still=comparable.stuck,
        limits=question.limits,
        later=tuple(part.grid for part in further),
    )
    found = conclude(case, tuple(notes))
    found = with_range_notes(found, network, record, healthy)
    return with_leads(found, case, record, healthy)


def _sentences(known: Basis, comparable: ComparableRecord) -> list[str]:
    """Return the notes about a healthy record and about a record's gaps and standstills."""
    parts = (known, known.structure, known.missing, known.bootstrap, comparable.gaps, comparable.standstill)
    return [part.sentence for part in parts if part is not None and part.sentence]


def _undetectable(whole: Part, known: Basis) -> list[str]:
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


def _members(
    known: Basis, record: Columns, grid: Grid, healthy: Columns | None, edges: np.ndarray
) -> tuple[Members, ...]:
    """Return the single thermometers that the record and a healthy one have.

    Thermometers of a place where an effect was adopted between the two are left out: their differences have changed.
    """
    if healthy is None or not record.members:
        return ()
    network = known.probe.network
    ours = {s.name for s in network.sensors if s.node not in known.taken_up}
    before = on_grid(network, healthy.time_s, healthy.inputs, healthy.measured)

    def means(columns: Columns, on: Grid) -> dict[str, Array]:
        return {
            name: np.column_stack([binned(one, columns.time_s, on) for one in each.T])
            for name, each in columns.members.items()
            if name in ours
        }

    return members(network, means(record, grid), grid, means(healthy, before), before, edges)


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
