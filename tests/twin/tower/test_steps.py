"""Steps of a thermometer: found in time, never taken for fouling, and told from steps of the water."""

from __future__ import annotations

import numpy as np
import pytest

from twin.tower.change_detection.steps import find_steps

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
