"""Weak effects are claimed where they foretell what no fit saw, and sizes beyond measure where much asks for them."""

from dataclasses import replace

import numpy as np
import pytest
from twin.discovery.selection.ladder import search

from tests.discovery.conftest import Bench
from twin.discovery.answer.case import Case
from twin.discovery.answer.judging import adequate, slight
from twin.discovery.diagnosis import Course, Fold, SensorError
from twin.discovery.engine import diagnose
from twin.discovery.evidence.commissioned import as_under_another_load, imagined, unconfirmed
from twin.discovery.evidence.finding import Finding, unusual
from twin.discovery.evidence.part import Part
from twin.discovery.healthy.basis import Columns, basis
from twin.discovery.records.grid import on_grid

SAME = {"T_tank_C": SensorError(0.06, 0.055, 0.055, 0.05)}
LESS = {"T_tank_C": SensorError(0.09, 0.060, 0.052, 0.05)}


@pytest.fixture(scope="module")
def weak_record(bench: Bench) -> Columns:
    changed = bench.with_element("unknown", {"kind": "heat_source", "node": "tank", "power": 0.45})
    return bench.record(12.0, seed=3, changed=changed, onset_h=3.0)


@pytest.fixture(scope="module")
def weak(bench: Bench, healthy: Columns, weak_record: Columns) -> Finding:
    grid = on_grid(bench.network, weak_record.time_s, weak_record.inputs, weak_record.measured)
    found = search(Part.of(basis(bench.network, healthy, grid), grid), lambda _: None)
    assert found.fit is not None
    assert 5.0 < found.ladder[0].best_z < 8.0
    return found


def folds(*gains: float) -> tuple[Fold, ...]:
    return tuple(Fold(0.0, 3600.0, 240, gain) for gain in gains)


def test_what_foretells_nothing_is_not_confirmed(weak: Finding) -> None:
    assert weak.fit is not None
    gain = weak.start - weak.fit.total
    assert unconfirmed(replace(weak, folds=folds(-7.0, 8.0)), SAME)
    assert unconfirmed(replace(weak, folds=()), SAME)
    assert not unconfirmed(replace(weak, folds=folds(0.3 * gain, 0.2 * gain)), SAME)
    assert not unconfirmed(replace(weak, folds=()), LESS)


def test_a_weak_effect_is_told_from_nothing(weak: Finding) -> None:
    assert weak.fit is not None
    (entry,) = weak.fit.entries
    for sd, unsized in ((0.5, False), (0.7, True)):
        found = replace(weak.fit, entries=(replace(entry, sd=sd * abs(entry.size)),))
        assert unconfirmed(replace(weak, fit=found, folds=()), LESS) is unsized


def test_what_is_slight_beside_an_effect_is_of_its_form(weak: Finding) -> None:
    assert weak.fit is not None
    large = replace(weak, start=weak.fit.total + 10_000.0)
    (entry,) = weak.fit.entries
    assert slight(replace(entry, gain=29.0), large)
    assert not slight(replace(entry, gain=31.0), large)


def test_what_is_strong_needs_no_such_confirmation(weak: Finding) -> None:
    assert not unconfirmed(replace(weak, start=weak.start + 64.0, folds=()), SAME)


def test_what_is_withdrawn_and_shows_nowhere_leaves_the_twin_adequate(
    bench: Bench, healthy: Columns, weak_record: Columns, weak: Finding
) -> None:
    """Nothing is unexplained where no unknown, free from block to block, says anything at any place."""
    grid = on_grid(bench.network, weak_record.time_s, weak_record.inputs, weak_record.measured)
    whole, none = weak.contest, np.zeros(weak.contest.b)
    silent = Course("tank", "W", whole.hours, none, none, -3.0, "energy", "tank")
    case = Case(
        finding=weak, known=basis(bench.network, healthy, grid), whole=whole, laws=[], lasting=[], grid=grid, split=0,
        errors=SAME, free=(silent,), doubted=True,
    )  # fmt: skip
    assert adequate(case)
    assert not adequate(replace(case, free=(replace(silent, log_evidence=12.0),)))


def test_a_true_weak_effect_foretells(bench: Bench, healthy: Columns, weak_record: Columns) -> None:
    found = diagnose(bench.network, weak_record, healthy)
    assert found.verdict in ("effect found", "ambiguous")
    assert found.effects[0].where == "tank"


def test_sizes_far_beyond_the_typical_have_to_win_more(weak: Finding) -> None:
    (entry,) = weak.entries
    typical = entry.candidate.typical
    assert unusual((replace(entry, size=typical),)) < 0.01
    assert unusual((replace(entry, size=70.0 * typical),)) == pytest.approx(12.25)
    assert unusual((replace(entry, size=1e6 * typical), entry)) < 20.1


def test_a_commissioned_twin_may_leave_more_of_a_rig_that_moves_more(bench: Bench) -> None:
    """In squares beyond the thermometers' own noise: twice that of 0.08 K is well within, three times is not."""
    revision = replace(bench.network.revision, error_after_K={"T_tank_C": float(np.hypot(0.05, 0.08))})
    known = replace(bench.network, revision=revision)

    def left(structure_K: float) -> dict[str, SensorError]:
        before = float(np.hypot(0.05, structure_K))
        return {"T_tank_C": SensorError(before, before, before, 0.05)}

    assert as_under_another_load(known, left(0.16))
    assert not as_under_another_load(known, left(0.24))
    unread = {**left(0.05), "T_heater_C": SensorError(0.5, 0.5, 0.5, 0.05)}
    assert not as_under_another_load(known, unread)  # nothing excuses a thermometer that commissioning did not read
    assert not as_under_another_load(bench.network, left(0.16))  # nothing is known of its commissioning


def test_an_effect_has_to_be_right_about_what_it_changes() -> None:
    assert imagined(gained=-0.02, apart=0.2)
    assert not imagined(gained=0.19, apart=0.2)
    assert not imagined(gained=0.0, apart=0.05)  # too little changes there to tell


def test_nothing_is_searched_for_in_a_twin_that_is_as_good_as_when_commissioned(bench: Bench) -> None:
    revision = replace(bench.network.revision, error_after_K={s.name: 1e-3 for s in bench.network.sensors}, number=1)
    network = replace(bench.network, revision=revision)
    heard: list[str] = []
    assert diagnose(network, bench.record(16.0, seed=9), say=heard.append).verdict == "adequate"
    assert "re-tuning" in heard and not [what for what in heard if what.startswith("fitting")]
