"""The bench of effects: warnings judged against the truth, thresholds, and the command's refusals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

pytest.importorskip("torch")

from hil.bench.commands.bench import command
from hil.bench.effects.judge import Case, alarms, outcome, threshold_for
from hil.bench.effects.simulated import Watched, make_rig
from hil.bench.effects.store import SPLITS, planned
from hil.bench.effects.trial import Judged, poisson_interval, reached, tables
from hil.bench.zoo.plants import SEALED
from twin.calibrators.hiera_unet.effects.balance import Figures, Hypothesis
from twin.calibrators.hiera_unet.effects.courses import Course

HYPOTHESES = (Hypothesis("heat_source", "tank"), Hypothesis("sensor", "T_tank_C"))
COUNT = 48
ACTS_S = 7200.0


def course(warned_at: float | None, hypothesis: int = 0) -> Course:
    end = figures().end_s
    statistic = np.where(end >= (np.inf if warned_at is None else warned_at), 9.0, 1.0)
    ones = np.ones(COUNT)
    return Course(
        statistic, np.full(COUNT, hypothesis), 50.0 * ones, 40.0 * ones, 60.0 * ones, 600.0 * ones, ones, 3600.0 * ones
    )


def figures() -> Figures:
    end = 600.0 + 300.0 * np.arange(COUNT)
    none = np.zeros((COUNT, 1))
    return Figures(end, none, np.zeros((COUNT, 2, 1)), np.zeros((2, 1)), none, none, np.ones(COUNT, bool))


def case(warned_at: float | None, hypothesis: int = 0, calm_at: float | None = None) -> Case:
    truth: dict[str, Any] = {
        "acts_s": ACTS_S,
        "places": ["tank"],
        "answers": [["heat_source", "tank"]],
        "early": [30.0, 60.0],
        "unit": "W",
        "group": "heat",
        "family": "serial",
    }
    record = Watched(figures(), figures(), truth, np.full(COUNT, 45.0))
    return Case(course(warned_at, hypothesis), course(calm_at), HYPOTHESES, record)


def test_a_warning_counts_as_found_within_two_windows_at_the_right_place() -> None:
    assert outcome(case(ACTS_S + 900.0), 5.0).found
    assert not outcome(case(ACTS_S + 1500.0), 5.0).found
    assert not outcome(case(ACTS_S + 900.0, hypothesis=1), 5.0).found
    assert outcome(case(None), 5.0).delay_s is None


def test_a_warning_before_the_onset_is_early_and_not_late() -> None:
    early = outcome(case(ACTS_S - 900.0), 5.0)
    assert early.early
    assert early.delay_s == 300.0


def test_the_size_is_compared_with_that_of_the_same_kind_alone() -> None:
    right, other = outcome(case(ACTS_S + 900.0), 5.0), outcome(case(ACTS_S + 900.0, hypothesis=1), 5.0)
    assert right.size_error == pytest.approx(50.0 / 45.0 - 1.0)
    assert right.size_inside
    assert np.isnan(other.size_error)


def test_warnings_close_to_each_other_are_one_alarm() -> None:
    end = figures().end_s
    statistic = np.ones(COUNT)
    statistic[[3, 5, 40]] = 9.0
    one = course(None)
    assert alarms(Course(statistic, *(getattr(one, n) for n in list(Course.__dataclass_fields__)[1:])), end, 5.0) == 2


def test_the_threshold_is_the_least_that_allows_so_many_alarms() -> None:
    end = figures().end_s
    calm = [(course(3600.0 if k < 3 else None), end) for k in range(30)]
    total = 30 * end[-1] / 86_400.0
    assert threshold_for(calm, 2.0 / total) == 9.0
    assert threshold_for(calm, 3.0 / total) < 9.0


def test_the_goal_takes_both_places_and_false_alarms() -> None:
    def judged(found: int, false: int) -> Judged:
        done = [outcome(case(ACTS_S + 900.0 if k < found else None), 5.0) for k in range(10)]
        return Judged("network", "test_seen", 5.0, done, false, 100.0)

    assert reached(judged(8, 1))
    assert not reached(judged(7, 0))
    assert not reached(judged(10, 2))
    assert {t.key for t in tables([judged(8, 1)])} >= {"goal", "found", "false", "errors"}


def test_a_count_of_none_bounds_the_rate_by_three() -> None:
    low, high = poisson_interval(0)
    assert low == 0.0
    assert high == pytest.approx(2.996, abs=1e-3)


def test_no_split_shares_a_seed_and_none_has_a_sealed_family() -> None:
    seeds = [seed for split in SPLITS for _, seed in planned(split, 0)]
    assert len(set(seeds)) == len(seeds)
    assert not {family for split in SPLITS for family, _ in planned(split, 0)} & set(SEALED)
    assert not set(SPLITS[0].families) & set(SPLITS[3].families)
    with pytest.raises(ValueError, match="none for development"):
        make_rig(SEALED[0], 1)


def test_a_missing_network_is_named_before_anything_is_simulated(tmp_path: Path) -> None:
    data = tmp_path / "rigs"
    weights = str(tmp_path / "none.safetensors")
    done = CliRunner().invoke(command, ["effects", "--network", weights, "--data", str(data)])
    assert done.exit_code != 0
    assert "none.json" in str(done.exception or done.output)
    assert not data.exists()
