"""What a twin's structure leaves in health is known in the next record, and not found there."""

from dataclasses import replace

import numpy as np
import pytest

from tests.discovery.conftest import Bench
from twin.discovery.effects.probe import free_run
from twin.discovery.engine import diagnose
from twin.discovery.evidence.part import Part
from twin.discovery.evidence.priors import CLAIM
from twin.discovery.healthy.basis import Basis, Columns, basis
from twin.discovery.healthy.health import NotHealthyError
from twin.discovery.records.grid import Grid, on_grid
from twin.discovery.scoring.score_tests import narrowed
from twin.discovery.scoring.structure import Structure
from twin.kernel import Kernel


@pytest.fixture(scope="module")
def bench(slow_pair: Bench) -> Bench:
    return slow_pair


@pytest.fixture(scope="module")
def healthy(slow_pair_healthy: Columns) -> Columns:
    return slow_pair_healthy


@pytest.fixture(scope="module")
def rig(bench: Bench) -> Bench:
    """A rig with a late thermometer, for which no tunable of the twin stands."""
    return bench.of(bench.with_values(T_modules_C__lag_s=40.0))


@pytest.fixture(scope="module")
def good(rig: Bench) -> Columns:
    return rig.record(10.0, seed=7)


def seen(bench: Bench, record: Columns, good: Columns) -> tuple[Basis, Grid]:
    grid = on_grid(bench.network, record.time_s, record.inputs, record.measured)
    return basis(bench.network, good, grid), grid


def test_what_is_there_in_health_is_foretold_in_the_next_record(bench: Bench, rig: Bench, good: Columns) -> None:
    known, grid = seen(bench, rig.record(20.0, seed=3), good)
    with_it, without = Part.of(known, grid), Part.of(replace(known, structure=None), grid)
    assert without.scanned[0].log_bayes > 2.0 * CLAIM
    assert with_it.scanned[0].log_bayes < CLAIM


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
    assert with_it.score_test.chi == pytest.approx(without.score_test.chi, rel=0.2)


def test_what_healthy_readings_told_of_tunable_and_structure_together_is_not_open(
    bench: Bench, rig: Bench, good: Columns
) -> None:
    """Each may stand for the other; a later record in which the sum has changed has changed."""
    known, grid = seen(bench, rig.record(20.0, seed=3), good)
    with_it, without = Part.of(known, grid), Part.of(replace(known, structure=None), grid)
    tunables = slice(known.probe.q)
    left, there = ((part.score_test.slopes[:, tunables] ** 2).sum(axis=0) for part in (with_it, without))
    assert (left > 0.05 * there).all()
    weaker = bench.of(rig.network.with_values({"fins.UA_100": 0.92 * rig.network.parameters["fins.UA_100"].value}))
    known, grid = seen(bench, weaker.record(20.0, seed=3), good)
    part = Part.of(known, grid)
    leading = part.scanned
    assert {e.label[:2] for e in leading[:2]} == {("heat_rejection", "tank"), ("actuator", "fan_speed")}
    assert leading[0].log_bayes > 50.0 * CLAIM


def test_open_directions_count_as_their_covariance_says() -> None:
    rng = np.random.default_rng(0)
    spread = rng.normal(size=(30, 4))
    directions, singular, _ = np.linalg.svd(spread, full_matrices=False)
    opened = directions, 1.0 - 1.0 / np.sqrt(1.0 + singular**2)
    x = rng.normal(size=(30, 2))
    twice = narrowed(narrowed(x, opened), opened)
    assert twice == pytest.approx(np.linalg.solve(np.eye(30) + spread @ spread.T, x))


OFFSETS = {(70.0, 50.0): 0.88, (85.0, 50.0): 1.10, (100.0, 70.0): 1.12, (85.0, 100.0): 0.90, (70.0, 100.0): 1.10}


def patchy(bench: Bench, hours: float, seed: int) -> Columns:
    """A rig whose radiator follows no two powers: at pairs of pump and fan speeds it is off by some per cent."""
    t, u = bench.inputs(hours, seed)
    factor = np.array([OFFSETS.get((pump, fan), 1.0) for pump, fan in u[:, 1:3]])
    full = bench.network.parameters["fins.UA_100"].value
    rows = np.flatnonzero(np.diff(factor, prepend=np.nan) != 0.0)
    values = np.tile(bench.network.values, (len(rows), 1, 1))
    values[:, 0, bench.network.index(["fins.UA_100"])[0]] = full * factor[rows]
    kernel = Kernel(bench.network, ("fins.UA_100",))
    readings, _ = kernel.trace_pieces(values, np.array([bench.start_C]), t, u, rows.tolist())
    rng = np.random.default_rng(seed + 100)
    return Columns(t, u, readings[0] + bench.network.sigma * rng.normal(0.0, 1.0, readings[0].shape))


def test_offsets_at_pairs_of_speeds_are_structure_where_a_record_speaks_for_them(
    bench: Bench, healthy: Columns
) -> None:
    good = patchy(bench, 10.0, seed=7)
    # What the record speaks for is told of this very twin, which leaves more of it than noise.
    rough = replace(
        bench.network,
        revision=replace(bench.network.revision, error_after_K=dict.fromkeys(bench.network.sensor_names, 0.5)),
    )
    own = bench.of(rough)
    known, grid = seen(own, patchy(own, 20.0, seed=3), good)
    assert known.structure is not None and known.structure.width > 0.0
    assert any("pump_speed_pct" in name for c in known.structure.candidates for name in c.changes)
    bare = replace(known, structure=replace(known.structure, width=0.0, **plainly(known.structure)))
    best = [max(e.log_bayes for e in Part.of(k, grid).scanned) for k in (known, bare)]
    assert best[0] < 0.5 * best[1]
    none, _ = seen(bench, bench.record(20.0, seed=3), healthy)
    assert none.structure is not None and none.structure.width == 0.0


def plainly(structure: Structure) -> dict[str, object]:
    """A structure's fields without its offsets."""
    kept = [i for i, c in enumerate(structure.candidates) if not any(" at " in name for name in c.changes)]
    return {
        "candidates": tuple(structure.candidates[i] for i in kept),
        "sizes": structure.sizes[kept],
        "covariance": structure.covariance[np.ix_(kept, kept)],
    }


def test_what_a_twin_left_when_it_was_commissioned_is_no_illness(bench: Bench, rig: Bench) -> None:
    good = bench.of(bench.with_values(modules_power__power=60.0)).record(10.0, seed=7)
    with pytest.raises(NotHealthyError):
        seen(bench, rig.record(16.0, seed=4), good)
    grid = on_grid(bench.network, good.time_s, good.inputs, good.measured)
    known, _ = seen(bench, rig.record(16.0, seed=4), bench.record(10.0, seed=7))
    _, _, residual, _ = free_run(known.probe, grid)
    left = dict(zip(bench.network.sensor_names, np.sqrt((residual**2).mean(axis=0)).tolist(), strict=True))
    revision = replace(bench.network.revision, error_fitted_K=left)
    rough, _ = seen(bench.of(replace(bench.network, revision=revision)), rig.record(16.0, seed=4), good)
    assert "of its own healthy record the twin leaves" in rough.warnings[0]
