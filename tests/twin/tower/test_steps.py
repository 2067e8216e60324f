"""Steps of a thermometer: found in time, never taken for fouling, and told from steps of the water."""

from __future__ import annotations

import numpy as np
import pytest

from twin.tower.change_detection.steps import DAY_S, find_steps, with_fan

SCAN_S = 300.0


def residuals(rng: np.random.Generator, hours: float = 24.0, sigma: float = 0.06) -> tuple[np.ndarray, np.ndarray]:
    """Readings every five minutes with white noise and an error that stays for half an hour."""
    n = int(hours * 3600 / SCAN_S)
    slow = np.zeros(n)
    for i in range(1, n):
        slow[i] = np.exp(-SCAN_S / 1800.0) * slow[i - 1] + rng.normal(0, 0.03)
    return np.arange(n) * SCAN_S, slow + rng.normal(0, sigma, n)


def test_steps_of_half_a_kelvin_are_reported_within_18_minutes_in_200_trials() -> None:
    rng = np.random.default_rng(11)
    late, missed, wrong = 0, 0, 0
    for _ in range(200):
        t, r = residuals(rng)
        at = float(rng.uniform(8, 20)) * 3600.0
        size = float(rng.choice([-0.5, 0.5]))
        second = residuals(rng)[1]
        found = find_steps(t, r + size * (t >= at), second)
        near = [s for s in found if at - SCAN_S <= s.alarm_s <= at + 2 * 3600 and s.lasting]
        missed += not near
        late += bool(near) and near[0].alarm_s - at > 18 * 60
        wrong += any(s.kind != "thermometer" for s in near)
    assert (missed, late, wrong) == (0, 0, 0)


@pytest.mark.parametrize("hours", [5.0, 10.0, 18.0])
def test_steps_within_a_day_of_each_other_are_both_found(hours: float) -> None:
    """A thermometer is exchanged, and the new one steps as well."""
    t, r = residuals(np.random.default_rng(17), 24 * 7)
    first, then = 4.5 * DAY_S, 4.5 * DAY_S + hours * 3600.0
    found = [s for s in find_steps(t, r - 0.35 * (t >= first) + 0.5 * (t >= then)) if s.lasting]
    assert [s.start_s for s in found] == pytest.approx([first, then], abs=900.0)
    assert [s.size for s in found] == pytest.approx([-0.35, 0.5], abs=0.12)


@pytest.mark.parametrize("hours", [3.5, 6.0, 9.0])
def test_a_disturbance_of_hours_is_no_step(hours: float) -> None:
    rng = np.random.default_rng(18)
    t, r = residuals(rng, 24 * 9)
    for day in range(8):
        begin = (day + rng.uniform(0.3, 0.5)) * DAY_S
        r = r + rng.uniform(0.4, 0.6) * ((t >= begin) & (t < begin + hours * 3600.0))
    assert not [s for s in find_steps(t, r) if s.lasting]


def test_fouling_of_weeks_raises_no_step() -> None:
    rng = np.random.default_rng(12)
    t, r = residuals(rng, 24 * 20)
    assert not [s for s in find_steps(t, r + 0.4 * t / t[-1]) if s.lasting]


def test_one_wrong_reading_is_no_step() -> None:
    t, r = residuals(np.random.default_rng(13))
    r[150] += 5.0
    assert not find_steps(t, r)


@pytest.mark.parametrize("size", [0.5, -0.7])
def test_a_step_of_both_thermometers_is_one_of_the_water(size: float) -> None:
    t, r = residuals(np.random.default_rng(14))
    moved = size * (t >= 12 * 3600)
    found = [s for s in find_steps(t, r + moved, residuals(np.random.default_rng(15))[1] + moved) if s.lasting]
    assert [s.kind for s in found] == ["water"] and found[0].size == pytest.approx(size, abs=0.15)


def by_exception(t: np.ndarray, r: np.ndarray, rng: np.random.Generator, at: float) -> np.ndarray:
    """The rows that an archive keeps: now and then one, and the first after `at`."""
    kept = rng.random(len(t)) < 0.3
    kept[np.searchsorted(t, at)] = True
    return np.flatnonzero(kept)


def test_an_archive_that_holds_the_reading_after_a_step_confirms_it() -> None:
    rng = np.random.default_rng(16)
    late = missed = 0
    for _ in range(50):
        t, r = residuals(rng, sigma=0.03)
        at = float(rng.uniform(12, 20)) * 3600.0
        rows = by_exception(t, r, rng, at)
        found = [s for s in find_steps(t[rows], (r + 0.5 * (t >= at))[rows]) if s.lasting and s.alarm_s >= at]
        missed += not found
        late += bool(found) and found[0].alarm_s - at > 18 * 60
    assert missed == 0 and late <= 1  # 24 of 50 where held readings do not count


def test_few_readings_of_the_last_hours_are_filled_up_by_earlier_ones() -> None:
    t, r = residuals(np.random.default_rng(17))
    at = 16 * 3600.0
    rows = np.flatnonzero((t < at - 4 * 3600) | (t >= at - 1800))  # hardly steady in the hours before the step
    found = [s for s in find_steps(t[rows], (r - 0.5 * (t >= at))[rows]) if s.lasting]
    assert len(found) == 1 and 0.0 <= found[0].alarm_s - at <= 18 * 60


def test_a_single_wrong_reading_is_corrected_by_the_next_scan_of_an_archive() -> None:
    rng = np.random.default_rng(18)
    t, r = residuals(rng)
    r[150] += 5.0
    kept = np.union1d(np.flatnonzero(rng.random(len(t)) < 0.3), [149, 150, 151])
    assert not [s for s in find_steps(t[kept], r[kept]) if s.lasting]


@pytest.mark.parametrize(("power_at_h", "kind"), [(36.0, "fan"), (38.0, "thermometer"), (None, "thermometer")])
def test_a_step_is_the_fan_s_where_its_power_steps_in_the_same_minutes(power_at_h: float | None, kind: str) -> None:
    rng = np.random.default_rng(16)
    t, r = residuals(rng, 72.0)
    power = rng.normal(0, 0.01, len(t))
    if power_at_h is not None:
        power = power - 0.06 * (t >= power_at_h * 3600)
    steps = [s for s in find_steps(t, r + 0.6 * (t >= 36 * 3600)) if s.lasting]
    (found,) = with_fan(steps, t, power)
    assert found.kind == kind and found.alone
    assert (found.power == pytest.approx(-0.06, abs=0.01)) == (kind == "fan")


@pytest.mark.parametrize("stop_days", [1.2, 9.0])
@pytest.mark.parametrize(("moved_K", "kind"), [(0.0, "thermometer"), (0.6, "water")])
def test_a_step_while_the_cell_stands_is_found_when_it_runs_again(stop_days: float, moved_K: float, kind: str) -> None:
    """Thermometers are exchanged while a cell stands, for longer than any level before it lasts."""
    rng = np.random.default_rng(18)
    for _ in range(20):
        t, r = residuals(rng, 24 * 12)
        after = t >= 6 * DAY_S
        clock_s = t + stop_days * DAY_S * after
        second = residuals(rng, 24 * 12)[1] + moved_K * after
        found = [s for s in find_steps(clock_s, r + 0.6 * after, second) if s.lasting]
        assert [s.kind for s in found] == [kind]
        assert (found[0].since_s, found[0].start_s) == (clock_s[~after][-1], clock_s[after][0])
        assert found[0].alarm_s - found[0].start_s <= 18 * 60


def test_a_long_stop_alone_is_no_step() -> None:
    rng = np.random.default_rng(19)
    for _ in range(20):
        t, r = residuals(rng, 24 * 12)
        assert not [s for s in find_steps(t + 3.0 * DAY_S * (t >= 6 * DAY_S), r) if s.lasting]


def test_a_fan_that_was_changed_while_the_cell_stood_is_no_thermometer() -> None:
    rng = np.random.default_rng(20)
    t, r = residuals(rng, 24 * 12)
    after = t >= 6 * DAY_S
    clock_s = t + 4.0 * DAY_S * after
    power = rng.normal(0.0, 0.01, len(t)) - 0.1 * after
    steps = [s for s in find_steps(clock_s, r + 0.6 * after) if s.lasting]
    assert [s.kind for s in with_fan(steps, clock_s, power)] == ["fan"]


@pytest.mark.parametrize(("moved_K", "later_s"), [(-2.2, 0.0), (-0.6, 5400.0)])
def test_a_basin_that_moves_by_itself_in_the_same_hours_is_no_witness(moved_K: float, later_s: float) -> None:
    """A basin moves by kelvins as other cells come and go; a step of the water is as large, and at the same minute."""
    rng = np.random.default_rng(21)
    for _ in range(20):
        t, r = residuals(rng, 24 * 4)
        at = 50.0 * 3600.0
        second = residuals(rng, 24 * 4)[1] + moved_K * (t >= at + later_s)
        (step,) = [s for s in find_steps(t, r - 0.56 * (t >= at), second) if s.lasting]
        assert step.kind == "thermometer" and (step.alone or later_s > 0.0)


def test_a_basin_that_often_moves_by_as_much_is_no_witness() -> None:
    """It happens to go the same way in the minutes of the step."""
    rng = np.random.default_rng(22)
    t, r = residuals(rng, 24 * 4)
    at = 50.0 * 3600.0
    turns = np.where((t - at) % (6 * 3600.0) < 3 * 3600.0, 0.25, -0.25)  # a cell of the same basin comes and goes
    (step,) = [s for s in find_steps(t, r + 0.5 * (t >= at), residuals(rng, 24 * 4)[1] + turns) if s.lasting]
    assert (step.kind, step.alone) == ("thermometer", True)
