"""Thresholds by the whole pipeline: records drawn from a twin, and what is kept of their diagnoses."""

from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from tests.discovery.conftest import Bench
from twin.discovery.bootstrap import bootstrap_claims
from twin.discovery.cache import cached
from twin.discovery.effects.probe import free_run
from twin.discovery.engine import diagnose
from twin.discovery.evidence.priors import CLAIM
from twin.discovery.healthy.basis import Columns, basis
from twin.discovery.healthy.claim_threshold import Bootstrap, keep_bootstrap, kept
from twin.discovery.healthy.simulated_records import simulated_records
from twin.discovery.records.grid import on_grid

CALM = Bootstrap(tuple(-6.0 + 0.2 * i for i in range(20)), CLAIM, 0)
ROUGH = Bootstrap(tuple(2.0 + 0.8 * i for i in range(20)), CLAIM, 3)


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing that a test keeps meets another diagnosis."""
    monkeypatch.setattr("twin.discovery.cache.cache_folder", lambda name: tmp_path)


def test_drawn_records_are_as_noisy_as_what_they_are_drawn_from(bench: Bench, healthy: Columns) -> None:
    grid = on_grid(bench.network, healthy.time_s, healthy.inputs, healthy.measured)
    known = basis(bench.network, healthy, grid)
    first, second = islice(simulated_records(known, healthy, np.random.default_rng(3)), 2)
    assert np.array_equal(first.inputs, healthy.inputs)
    # One rig, two records: what they differ by is noise, of one sample as of a bin's mean.
    apart = (first.measured - second.measured) / np.sqrt(2.0)
    assert apart.std(axis=0) == pytest.approx(bench.network.sigma, rel=0.15)
    residual = free_run(known.probe, grid)[2]
    means = on_grid(bench.network, healthy.time_s, healthy.inputs, apart).measured
    assert means.std(axis=0) == pytest.approx(residual.std(axis=0), rel=0.3)


def test_drawn_records_are_of_rigs_that_differ_by_what_commissioning_does_not_know(
    bench: Bench, healthy: Columns
) -> None:
    known = basis(bench.network, healthy, on_grid(bench.network, healthy.time_s, healthy.inputs, healthy.measured))
    rigs = [islice(simulated_records(known, healthy, np.random.default_rng(i)), 2) for i in range(8)]
    means = np.array([[r.measured.mean(axis=0) for r in pair] for pair in rigs])
    between, within = means.mean(axis=1).std(axis=0), (means[:, 0] - means[:, 1]).std(axis=0)
    # What commissioning knows least shows; where it is told sharply, nothing does.
    assert (between / within).max() > 3.0


def test_gaps_and_single_thermometers_are_drawn_too(bench: Bench, healthy: Columns) -> None:
    measured = healthy.measured.copy()
    measured[100:200, 1] = np.nan
    name = bench.network.sensor_names[0]
    single = healthy.measured[:, :1] + np.array([0.3, -0.1, -0.2])
    single[50:60], single[70:80, 1] = np.nan, np.nan
    gappy = replace(healthy, measured=measured, members={name: single})
    known = basis(bench.network, gappy, on_grid(bench.network, gappy.time_s, gappy.inputs, gappy.measured))
    made = next(simulated_records(known, gappy, np.random.default_rng(1)))
    assert np.array_equal(np.isnan(made.measured), np.isnan(measured))
    assert np.array_equal(np.isnan(made.members[name]), np.isnan(single))
    whole = np.isfinite(single).all(axis=1)
    assert made.members[name][whole].mean(axis=1) == pytest.approx(made.measured[whole, 0])
    away = (made.members[name] - made.measured[:, :1])[whole].mean(axis=0)
    assert away == pytest.approx([0.3, -0.1, -0.2], abs=0.01)


@pytest.mark.usefixtures("own_cache")
def test_healthy_draws_give_no_alarm_and_raise_the_odds_little(pair: Bench) -> None:
    told: list[int] = []
    found = bootstrap_claims(pair.network, pair.record(4.0, seed=7), 10, done=told.append)
    assert told == list(range(1, 11))
    assert found.alarms <= 1
    assert len(found.odds) == 10 and max(found.odds) < CLAIM + 3.0
    assert CLAIM == found.needed <= found.claim < 2.0 * CLAIM


def test_too_few_draws_are_refused(bench: Bench, healthy: Columns) -> None:
    with pytest.raises(ValueError, match="10 draws or more, not 9"):
        bootstrap_claims(bench.network, healthy, 9)


def test_the_odds_needed_rise_with_those_of_healthy_records_and_never_fall() -> None:
    assert CALM.claim == CLAIM
    assert "0 gave an alarm; the odds needed for a claim stand" in CALM.sentence
    assert ROUGH.claim > max(ROUGH.odds)
    assert f"3 gave an alarm; a claim with it needs log odds of {ROUGH.claim:.1f} instead of 12.0" in ROUGH.sentence


@pytest.mark.usefixtures("own_cache")
def test_what_was_kept_counts_for_that_twin_alone(pair: Bench, pair_healthy: Columns) -> None:
    grid = on_grid(pair.network, pair_healthy.time_s, pair_healthy.inputs, pair_healthy.measured)
    before = basis(pair.network, pair_healthy, grid)
    assert before.bootstrap is None and before.claim == 0.0
    keep_bootstrap(ROUGH, pair.network, pair_healthy.time_s, pair_healthy.inputs, pair_healthy.measured)
    assert basis(pair.network, pair_healthy, grid).claim == ROUGH.claim
    record = pair.record(10.0)
    assert diagnose(pair.network, record, pair_healthy).claim == ROUGH.claim
    other = pair.with_values(fins__UA_100=pair.network.parameters["fins.UA_100"].value * 1.01)
    assert kept(other, pair_healthy.time_s, pair_healthy.inputs, pair_healthy.measured) is None
    assert kept(pair.network, pair_healthy.time_s, pair_healthy.inputs, pair_healthy.measured + 0.01) is None


@pytest.mark.usefixtures("own_cache")
def test_a_full_disk_loses_no_diagnosis(bench: Bench, healthy: Columns, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> int:
        raise OSError(28, "No space left on device")

    arrays = (healthy.time_s, healthy.inputs, healthy.measured)
    keep_bootstrap(CALM, bench.network, *arrays)
    monkeypatch.setattr(Path, "write_text", full)
    keep_bootstrap(ROUGH, bench.network, *arrays)
    assert kept(bench.network, *arrays) == CALM


@pytest.mark.usefixtures("own_cache")
@pytest.mark.parametrize("text", ["", "{", '{"odds": [1], "needed": 12, "alarms": 0}', '{"odds": "abc"}'])
def test_a_damaged_file_is_as_none(bench: Bench, healthy: Columns, text: str) -> None:
    arrays = (healthy.time_s, healthy.inputs, healthy.measured)
    keep_bootstrap(CALM, bench.network, *arrays)
    path = cached("bootstrap", bench.network, *arrays)
    assert path is not None
    path.write_text(text)
    assert kept(bench.network, *arrays) is None
