"""Drift alarm, gates and the basin's second thermometer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.tower.governance import Indicators, drift_alarms
from hil.tower.governance.gates import GateEvidence, judge
from hil.tower.governance.records import drift_sentence
from hil.tower.governance.service import hidden_shares
from twin.tower.identifiability.identify import Identifiability
from twin.tower.windows import TargetWindow


def indicators(hours: int = 100, **beyond: slice) -> Indicators:
    columns = {
        "residual_mean": np.zeros(hours),
        "coverage": np.full(hours, 0.9),
        "withheld": np.zeros(hours),
        "missing": np.zeros(hours),
        "distance": np.ones(hours),
    }
    bad = {"residual_mean": 0.6, "coverage": 0.4, "withheld": 1.0, "missing": 0.5, "distance": 9.0}
    for name, rows in beyond.items():
        columns[name][rows] = bad[name]
    return Indicators(3600.0 * np.arange(hours), **columns)


def test_one_indicator_or_a_short_excursion_of_two_raises_no_alarm() -> None:
    assert not drift_alarms(indicators(coverage=slice(10, 90)))
    assert not drift_alarms(indicators(coverage=slice(10, 32), residual_mean=slice(10, 32)))


def test_two_indicators_for_a_day_raise_one_alarm_that_names_them() -> None:
    found = drift_alarms(indicators(coverage=slice(10, 90), residual_mean=slice(20, 80)))
    assert found == [(3600.0 * 43, ("residual_mean", "coverage"))]
    assert drift_sentence(found[0][1]) == (
        "for a day the mean error was above 0.25 K and less than 80 % of the readings lay in the interval"
    )


def window(
    k: int, excited: bool = True, half: float = 0.3, frozen: tuple[str, ...] = (), hidden: float = 0.0
) -> TargetWindow:
    told = Identifiability(200.0 if frozen else 20.0, {}, {}, frozen, 20.0, hidden)
    return TargetWindow(7200.0 * k, 7200.0 * (k + 1), told, excited, np.ones(4), 1.0, half)


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"hidden": 0.3}, "MISSING_REQUIRED"),
        ({"half": 0.9}, "HIGH_UNCERTAINTY"),
        ({"half": float("nan")}, "HIGH_UNCERTAINTY"),
    ],
)
def test_each_gate_holds_back_with_its_code(change: dict[str, float], code: str) -> None:
    nothing = GateEvidence((), (), (), False)
    zero = np.zeros(1)
    assert code in judge([window(0, **change)], zero, zero, nothing)[0].codes  # type: ignore[arg-type]


def test_an_operating_point_that_was_not_seen_before_is_held_back_until_it_is_usual() -> None:
    usual = np.random.default_rng(3).normal(0.0, 1.0, (400, 4))
    features = np.vstack([usual[:200], usual[200:] + 100.0])
    windows = [replace(window(k), features=row) for k, row in enumerate(features)]
    found = judge(windows, np.zeros(400), np.zeros(400), GateEvidence((), (), (), False))
    outside = np.array(["OUT_OF_ENVELOPE" in v.codes for v in found])
    assert outside[:200].mean() < 0.03 and outside[200:205].all()
    assert outside[205:].mean() < 0.1  # a plant that now runs there is no exception for ever


def test_fill_needs_three_excited_windows_and_an_inspection_and_bias_a_second_thermometer() -> None:
    zero = np.zeros(4)
    windows = [window(k) for k in range(4)]
    bare = judge(windows, zero, zero, GateEvidence((), (), (), False))
    assert [v.accepts("fill") for v in bare] == [False] * 4 and not bare[3].accepts("bias") and bare[3].accepts("air")
    full = judge(windows, zero, zero, GateEvidence((), (0.0,), (), True, "NO_MAKEUP"))
    assert [v.accepts("fill") for v in full] == [False, False, True, True] and full[0].accepts("bias")
    assert full[0].notes == ("BALANCE_OFF:NO_MAKEUP",)


def test_a_frozen_deviation_is_held_back_and_the_others_pass() -> None:
    zero = np.zeros(4)
    windows = [*(window(k) for k in range(3)), window(3, frozen=("fill",))]
    last = judge(windows, zero, zero, GateEvidence((), (0.0,), (), True))[3]
    assert last.of["fill"] == ("LOW_SENSITIVITY:fill",) and last.accepts("uniformity")


def test_an_unexplained_step_of_the_water_holds_everything_back_for_a_day() -> None:
    zero = np.zeros(20)
    found = judge([window(k) for k in range(20)], zero, zero, GateEvidence((), (0.0,), (7200.0 * 2 + 10,), True))
    assert [bool(v.codes) for v in found] == [False] * 2 + [True] * 13 + [False] * 5


def test_a_cell_on_standby_whose_tags_are_silent_hides_nothing() -> None:
    missing = np.full(4, np.nan)
    columns = {"m_w_kg_s": missing, "fan_speed_pct": missing, "fan_power_kW": missing, "t_in_C": missing}
    columns |= {name: np.ones(4) for name in ("t_out_C", "dry_C", "pressure_kPa")}
    off = np.array([0, 0, 2, 7], dtype=np.uint8)
    np.testing.assert_allclose(hidden_shares(columns, off), [0.0, 0.0, 4 / 7, 4 / 7])
