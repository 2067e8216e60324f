"""A tower network as a correction: it starts at the answer of boosted trees, and held-out windows never get worse."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed: the network calibrator is left out")
pytest.importorskip("safetensors", reason="safetensors is not installed: trained networks cannot be read")

from hil.training.tower.selftest import random_trees  # noqa: E402
from tests.twin.hiera.tower_tables import made_table  # noqa: E402
from twin.calibrators.hiera_unet.tower.cell_table import trimmed  # noqa: E402
from twin.calibrators.hiera_unet.tower.member import MemberTraining, load_member  # noqa: E402
from twin.calibrators.hiera_unet.tower.plan import TowerPlan  # noqa: E402
from twin.calibrators.hiera_unet.tower.predict import NOT_TESTED, predict, settle  # noqa: E402
from twin.calibrators.hiera_unet.tower.score import (  # noqa: E402
    MethodPrediction,
    boosted,
    mixed,
    scores,
    shrink_factors,
    shrunk,
    started,
    targets_of,
)
from twin.calibrators.hiera_unet.tower.windows import Fleet  # noqa: E402

PLAN = TowerPlan(steps=2, batch=3, pairs=0.34, rate=0.05)


def made_fleet() -> Fleet:
    return Fleet([made_table(seed=0), made_table("made_2", seed=1)])


def test_an_untrained_member_says_what_its_trees_say_on_disk_and_off(tmp_path: Path) -> None:
    fleet, trees = made_fleet(), random_trees()
    training = MemberTraining("small", PLAN, made_fleet(), made_fleet(), None, "data", trees)
    path = tmp_path / "tower_small_0.safetensors"
    training.write(path, NOT_TESTED, {})
    rows = fleet.rows[:5]
    t, wanted = targets_of(fleet, rows), boosted(trees, fleet, rows)
    assert np.abs(wanted.water - t.water).max() > 1e-3
    for network in (training.trainer.average, load_member(path, blind_too=True).network):
        found, _, _ = mixed(t, [predict(network, fleet, rows)])
        np.testing.assert_allclose(found.theta, wanted.theta, atol=1e-5)
        np.testing.assert_allclose(found.water, wanted.water, atol=1e-4)


def test_answers_worked_out_before_are_those_of_the_trees_and_only_of_the_rows_given() -> None:
    fleet, trees = made_fleet(), random_trees()
    settle(fleet, trees, fleet.rows[:3])
    settle(fleet, random_trees(1), fleet.rows[3:5])
    for rows, own in ((fleet.rows[:3], trees), (fleet.rows[3:5], random_trees(1))):
        np.testing.assert_allclose(
            started(fleet, targets_of(fleet, rows)).water, boosted(own, made_fleet(), rows).water, atol=1e-4
        )
    t = targets_of(fleet, fleet.rows[5:7])
    np.testing.assert_array_equal(started(fleet, t).theta, t.mean)


def test_another_thermometer_moves_readings_belief_and_label_alike() -> None:
    fleet = made_fleet()
    rows = torch.from_numpy(fleet.rows[:3])
    plain, moved = fleet.batch(rows), fleet.batch(rows, offset=torch.full((3,), 0.4))
    for a, b in ((plain.mean, moved.mean), (plain.true, moved.true)):
        torch.testing.assert_close(b[:, 3], a[:, 3] + 0.4)
        torch.testing.assert_close(b[:, :3], a[:, :3])
    torch.testing.assert_close(moved.reading, plain.reading + 0.4, equal_nan=True)
    torch.testing.assert_close(moved.true_water, plain.true_water, equal_nan=True)
    torch.testing.assert_close(moved.features[:, -3:], plain.features[:, -3:], atol=1e-4, rtol=0.0)


def test_factors_of_corrections_leave_no_mean_error_above_that_of_the_base() -> None:
    fleet = made_fleet()
    t = targets_of(fleet, fleet.rows)
    rng, base = np.random.default_rng(0), MethodPrediction(t.mean, t.water)
    right = MethodPrediction(t.mean + 2.0 * (t.true - t.mean), t.water + 2.0 * np.nan_to_num(t.true_water - t.water))
    theta, water = shrink_factors(t, base, right)
    np.testing.assert_allclose([*theta[[0, 1, 3]], water], 0.5, atol=1e-3)
    wrong = MethodPrediction(t.mean - (t.true - t.mean), t.water + rng.normal(0.0, 1.0, t.water.shape))
    found = scores(t, shrunk(base, wrong, *shrink_factors(t, base, wrong)))
    assert found["water_mae_K"] <= scores(t, base)["water_mae_K"]
    assert found["deviation_mae"]["fill"] == pytest.approx(scores(t, base)["deviation_mae"]["fill"], rel=1e-5)


def test_a_training_that_only_spoils_its_start_ends_at_it() -> None:
    held_out = made_fleet()
    # Labels of the training say the opposite of those that are held out.
    spoiled = [replace(one, true=2.0 * one.mean - one.true) for one in (made_table(seed=0), made_table("b", seed=1))]
    spoiled = [replace(one, true_water=2.0 * one.water - one.true_water) for one in spoiled]
    training = MemberTraining("small", PLAN, Fleet(spoiled), held_out, None, "data")
    assert training.run(None, lambda: False, lambda *_: None)
    assert training.best["score"] <= 1.0 and training.curves[-1]["of_base"] <= 1.0 + 1e-6
    t = targets_of(held_out, training.looked)
    found, _, _ = mixed(t, [predict(training.trainer.average, held_out, training.looked)])
    assert scores(t, found)["water_mae_K"] <= scores(t, started(held_out, t))["water_mae_K"] + 1e-6


def test_windows_of_a_trimmed_table_have_their_whole_day_and_begin_in_settled_minutes() -> None:
    table = made_table(minutes=6 * 1440)
    day = np.arange(6 * 1440) // 1440
    keep, settled = (day < 2) | (day > 3), (day < 2) | (day > 4)
    short = trimmed(table, keep, settled)
    assert len(short.regime) == 4 * 1440 and short.valid.any()
    whole, part = Fleet([table]), Fleet([short])
    # Windows of day 5 reach back into day 4; those of days 2 to 4 lack minutes or are not settled.
    start = table.start[part.rows]
    assert set(start // 1440) == {0, 1, 5}
    a, b = (fleet.batch(torch.from_numpy(part.rows)) for fleet in (whole, part))
    torch.testing.assert_close(a.x, b.x)
    torch.testing.assert_close(a.reading, b.reading, equal_nan=True)
    torch.testing.assert_close(a.water, b.water)
