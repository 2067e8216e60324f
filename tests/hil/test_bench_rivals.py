"""`hil bench tower-rivals`: sizes of rivals, causality, equal starts, early stopping, the tables of a trial."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed: the network calibrator is left out")

from hil.bench.rivals import TrialSize, contestants, training  # noqa: E402
from hil.bench.rivals import trial as trial_module  # noqa: E402
from hil.bench.rivals.contestants import CONTESTANTS, HIERA, REMEDY, Contestant  # noqa: E402
from hil.bench.rivals.networks import BODIES, PATCH_MIN, Rival  # noqa: E402
from hil.bench.rivals.stations import FIRST, HEALTHY_D, ShortStation, in_turn, stations_of  # noqa: E402
from hil.bench.rivals.training import RivalTraining, WindowPool, corrections, cut, error_of  # noqa: E402
from tests.twin.hiera.tower_tables import made_table  # noqa: E402
from twin.calibrators.hiera_unet.tower import Fleet  # noqa: E402
from twin.calibrators.hiera_unet.tower.table import SUBJECT  # noqa: E402

MOST_WEIGHTS = 1_100_000
BY_NAME = {one.name: one for one in CONTESTANTS}


@pytest.fixture(scope="module")
def fleet() -> Fleet:
    return Fleet([made_table(f"made{k}_1", seed=k) for k in range(2)])


def alive(name: str) -> torch.nn.Module:
    """Return an untrained rival whose last layer reads its features."""
    torch.manual_seed(0)
    made = BY_NAME[name].build()
    torch.nn.init.normal_(made.head.out.weight)  # type: ignore[union-attr, arg-type]
    return made


@pytest.mark.parametrize("name", list(BY_NAME))
def test_each_contestant_starts_at_the_given_answer_with_about_a_million_weights(fleet: Fleet, name: str) -> None:
    one, windows = BY_NAME[name], cut(fleet, fleet.rows[:2])
    network = one.build()
    found = corrections(one, network, windows)
    assert found.shape == (2, SUBJECT.target) and not found.any()
    assert sum(p.numel() for p in network.parameters()) <= MOST_WEIGHTS


@pytest.mark.parametrize("name", list(BODIES))
def test_each_rival_reads_the_order_of_the_day(fleet: Fleet, name: str) -> None:
    windows = cut(fleet, fleet.rows[:1])
    turned = replace(windows, x=windows.x.flip(1), m=windows.m.flip(1))
    made = alive(name)
    assert np.abs(corrections(BY_NAME[name], made, windows) - corrections(BY_NAME[name], made, turned)).max() > 1e-3


def test_the_tcn_alone_knows_nothing_of_later_tokens(fleet: Fleet) -> None:
    windows = cut(fleet, fleet.rows[:1])
    other = replace(windows, x=windows.x.clone())
    other.x[:, -PATCH_MIN:] += 1.0
    moved = {
        name: np.abs(corrections(BY_NAME[name], made, windows) - corrections(BY_NAME[name], made, other))[0]
        for name, made in ((name, alive(name)) for name in BODIES)
    }
    for name, change in moved.items():
        assert change[-PATCH_MIN:].max() > 1e-4
        assert (change[:-PATCH_MIN].max() < 1e-6) == (name == "TCN")


def test_a_hidden_channel_and_the_memory_reach_no_answer(fleet: Fleet) -> None:
    windows = cut(fleet, fleet.rows[:1])
    made = alive("TCN")
    assert isinstance(made, Rival)
    blind = Contestant("blind", "ablation", lambda: made, hidden=contestants.RESIDUALS, memory=False)
    other = replace(windows, x=windows.x.clone(), memory=windows.memory + 1.0)
    for name in contestants.RESIDUALS:
        other.x[..., SUBJECT.index(name)] += 1.0
    assert np.allclose(corrections(blind, made, windows), corrections(blind, made, other), atol=1e-6)
    seeing = replace(blind, hidden=(), memory=True)
    assert np.abs(corrections(seeing, made, windows) - corrections(seeing, made, other)).max() > 1e-3


def test_the_remedy_corrects_no_mean_and_pays_for_none(fleet: Fleet) -> None:
    windows = training.taken(cut(fleet, fleet.rows[:2]), torch.arange(2))
    one = replace(BY_NAME["TCN"], centred=True)
    delta = one.correction(alive("TCN"), windows, windows.m)
    assert float(delta.detach().mean(1).abs().max()) < 1e-5 < float(delta.detach().abs().max())
    moved = replace(windows, base_water=windows.base_water + 0.3)
    zero = torch.zeros_like(windows.base_water)
    assert float(training.loss_of(one, zero, windows)) == pytest.approx(
        float(training.loss_of(one, zero, moved)), rel=1e-3
    )
    assert float(training.loss_of(BY_NAME["TCN"], zero, moved)) > float(training.loss_of(one, zero, moved))


def test_training_lowers_the_error_and_the_chosen_weights_are_the_best_on_validation(fleet: Fleet) -> None:
    pool, windows = WindowPool(fleet, 24, 0), cut(fleet, fleet.rows)
    found = RivalTraining(BY_NAME["TCN"], pool, 0).run(0.8, windows, windows, windows)
    assert found.steps > 0 and found.learned < 0.0 and 0 <= found.chosen <= found.steps
    assert found.chosen_validation <= min(found.validation, 0.0)
    share = error_of(windows, found.stopped) / error_of(windows) - 1.0
    assert share == pytest.approx(found.chosen_validation, abs=1e-5)


def test_a_tiny_trial_prints_each_contestant_and_continues_without_training(
    fleet: Fleet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    size = TrialSize(2, 2, 2, windows=(6, 2, 2), seconds=0.05, seeds=1)
    fleets = dict.fromkeys(("train", "validation", "test"), fleet)
    some = tuple(BY_NAME[name] for name in ("TCN", HIERA, REMEDY, f"{HIERA}, no memory"))
    monkeypatch.setattr(trial_module, "_boosted", lambda *_: [])
    kept = trial_module.Kept(tmp_path, 60.0, lambda *_: None)
    _, left_out = trial_module.trial(fleets, size, 0, replace(kept, minutes=0.0), some)
    assert len(left_out) == len(some) and "0 of 1 trainings" in left_out[0]
    first, _ = trial_module.trial(fleets, size, 0, kept, some)
    monkeypatch.setattr(RivalTraining, "run", lambda *_: pytest.fail("trained again"))
    again, _ = trial_module.trial(fleets, size, 0, kept, some)
    assert again == first
    by_key = {table.key: table for table in first}
    assert [row[0] for row in by_key["outlet"].rows][3:] == [one.name for one in some]
    assert len(by_key["parts"].rows) == 1 and len(by_key["remedy"].rows) == 4
    assert all(len(row) == len(table.columns) for table in first for row in table.rows)


def test_no_station_is_in_two_splits_and_a_cut_leaves_some_of_each() -> None:
    counts = {"train": 20, "validation": 4, "test": 8}
    seeds = {split: {one.seed for one in stations_of(split, n)} for split, n in counts.items()}
    assert not seeds["train"] & seeds["validation"] and not seeds["validation"] & seeds["test"]
    early = [one.seed for one in in_turn(counts)][:16]
    assert {s: sum(FIRST[s] <= seed < FIRST[s] + n for seed in early) for s, n in counts.items()} == {
        "train": 10,
        "validation": 2,
        "test": 4,
    }
    (first, healthy), (begin, end) = ShortStation("F", 5, 14.0, 1, True).segments()
    assert (first, healthy) == (0, HEALTHY_D) and HEALTHY_D <= begin < end <= 14 * 31
