"""What a twin's structure leaves in health is known in the next record, and not found there."""

from dataclasses import replace

import numpy as np
import pytest

from tests.discovery.conftest import Bench
from twin.discovery.basis import Basis, Columns, basis
from twin.discovery.contest import narrowed
from twin.discovery.engine import diagnose
from twin.discovery.grid import Grid, on_grid
from twin.discovery.part import Part


@pytest.fixture(scope="module")
def rig(bench: Bench) -> Bench:
    """A rig with a late thermometer, for which no tunable of the twin stands."""
    return Bench(bench.with_values(T_modules_C__lag_s=40.0))


@pytest.fixture(scope="module")
def good(rig: Bench) -> Columns:
    return rig.record(10.0, seed=7)


def seen(bench: Bench, record: Columns, good: Columns) -> tuple[Basis, Grid]:
    grid = on_grid(bench.network, record.time_s, record.inputs, record.measured)
    return basis(bench.network, good, grid), grid


def test_what_is_there_in_health_is_foretold_in_the_next_record(bench: Bench, rig: Bench, good: Columns) -> None:
    known, grid = seen(bench, rig.record(20.0, seed=3), good)
    with_it, without = Part.of(known, grid), Part.of(replace(known, structure=None), grid)
    assert without.best_z > 2.0 * without.threshold
    assert with_it.best_z < with_it.threshold


def test_a_rig_that_is_not_quite_its_twin_is_healthy_still(bench: Bench, rig: Bench, good: Columns) -> None:
    assert diagnose(bench.network, rig.record(16.0, seed=4), good).verdict == "adequate"


def test_an_effect_beside_it_keeps_its_size(bench: Bench, rig: Bench, good: Columns) -> None:
    heated = rig.with_element("unknown", {"kind": "heat_source", "node": "modules", "power": 40.0})
    found = diagnose(bench.network, rig.record(16.0, seed=4, changed=heated, onset_h=5.0), good)
    (effect,) = found.effects
    assert (effect.kind, effect.where, effect.driver) == ("heat_source", "modules", "constant")
    assert effect.value == pytest.approx(40.0, rel=0.1)
    assert abs(effect.onset_s - 18000.0) < 600.0


def test_a_twin_without_faults_has_no_structure_to_speak_of(bench: Bench, healthy: Columns) -> None:
    known, grid = seen(bench, bench.record(20.0, seed=3), healthy)
    with_it, without = Part.of(known, grid), Part.of(replace(known, structure=None), grid)
    assert with_it.contest.chi == pytest.approx(without.contest.chi, rel=0.2)


def test_what_healthy_readings_told_of_tunable_and_structure_together_is_not_open(
    bench: Bench, rig: Bench, good: Columns
) -> None:
    """Each may stand for the other; a later record in which the sum has changed has changed."""
    known, grid = seen(bench, rig.record(20.0, seed=3), good)
    with_it, without = Part.of(known, grid), Part.of(replace(known, structure=None), grid)
    tunables = slice(known.probe.q)
    left, there = ((part.contest.slopes[:, tunables] ** 2).sum(axis=0) for part in (with_it, without))
    assert (left > 0.05 * there).all()
    weaker = Bench(rig.network.with_values({"fins.UA_100": 0.92 * rig.network.parameters["fins.UA_100"].value}))
    known, grid = seen(bench, weaker.record(20.0, seed=3), good)
    part = Part.of(known, grid)
    assert {e.label[:2] for e in part.entries[:2]} == {("heat_rejection", "radiator"), ("actuator", "fan_speed")}
    assert part.best_z > 15.0 * part.threshold


def test_open_directions_count_as_their_covariance_says() -> None:
    rng = np.random.default_rng(0)
    spread = rng.normal(size=(30, 4))
    directions, singular, _ = np.linalg.svd(spread, full_matrices=False)
    opened = directions, 1.0 - 1.0 / np.sqrt(1.0 + singular**2)
    x = rng.normal(size=(30, 2))
    twice = narrowed(narrowed(x, opened), opened)
    assert twice == pytest.approx(np.linalg.solve(np.eye(30) + spread @ spread.T, x))
