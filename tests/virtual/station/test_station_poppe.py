"""Poppe's method of the virtual station: monotone, converged, closed in heat, and unlike Merkel's."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.virtual.tower.physics.moist_air import CP_WATER, enthalpy, ratios, wet_bulb
from drivers.virtual.tower.physics.poppe import merkel_number, outlet

PRESSURE = 100.0


def air(dry: float, humidity: float) -> tuple[float, float]:
    """Return humidity ratio and wet bulb."""
    ratio = float(ratios(np.array([dry]), np.array([humidity]), np.array([PRESSURE]))[0])
    return ratio, float(wet_bulb(dry, ratio, PRESSURE))


def points(seed: int, count: int, loading: tuple[float, float]) -> list[tuple[float, ...]]:
    """Return operating points: inlet, loading, dry bulb, ratio, wet bulb, Merkel number."""
    rng = np.random.default_rng(seed)
    found = []
    while len(found) < count:
        dry = rng.uniform(-10.0, 38.0)
        ratio, wet = air(dry, rng.uniform(0.2, 1.0))
        hot = rng.uniform(15.0, 45.0)
        if hot > wet + 2.0:
            found.append((hot, rng.uniform(*loading), dry, ratio, wet, rng.uniform(0.3, 2.5)))
    return found


def cold(hot: float, loading: float, dry: float, ratio: float, wet: float, number: float) -> float:
    """Return the outlet temperature from a cold start."""
    return float(outlet(hot, loading, dry, ratio, PRESSURE, wet, number, hot - 4.0, ratio + 0.01)[0])


@pytest.mark.parametrize("loading", [(0.4, 3.0), (3.0, 12.0)], ids=["fan", "free_convection"])
def test_more_fill_and_more_air_never_warm_the_outlet(loading: tuple[float, float]) -> None:
    for hot, water, *rest, number in points(1, 400, loading):
        here = cold(hot, water, *rest, number)
        assert cold(hot, water, *rest, number * 1.03) <= here + 0.02
        assert cold(hot, water * 0.97, *rest, number) <= here + 0.02
        assert rest[2] - 1e-6 <= here <= hot


def test_the_outlet_depends_on_no_guess() -> None:
    for hot, water, dry, ratio, wet, number in points(2, 200, (0.4, 3.0)):
        found = [
            outlet(hot, water, dry, ratio, PRESSURE, wet, number, guess, w)[0]
            for guess, w in ((hot - 1.0, ratio), (wet + 0.5, ratio + 0.03), (0.5 * (hot + wet), ratio + 0.01))
        ]
        assert max(found) - min(found) < 0.02


def test_the_merkel_number_is_infinite_where_the_operating_line_meets_saturation() -> None:
    ratio, wet = air(25.0, 0.5)
    assert merkel_number(wet + 1e-3, 40.0, 4.0, 25.0, ratio, PRESSURE, 0.04)[0] == np.inf
    numbers = [merkel_number(t, 40.0, 1.2, 25.0, ratio, PRESSURE, 0.035)[0] for t in np.linspace(wet + 2.0, 39.0, 60)]
    finite = [number for number in numbers if np.isfinite(number)]
    assert numbers[-len(finite) :] == finite, "finite above the pinch, infinite below"
    assert finite == sorted(finite, reverse=True)
    assert len(finite) > 30


def test_four_steps_are_those_of_sixty() -> None:
    errors = []
    for hot, water, dry, ratio, wet, number in points(3, 300, (0.6, 2.5)):
        t, w, _ = outlet(hot, water, dry, ratio, PRESSURE, wet, number, hot - 4.0, ratio + 0.01)
        fine = merkel_number(t, hot, water, dry, ratio, PRESSURE, w, 60)[0]
        steeper = merkel_number(t + 1e-3, hot, water, dry, ratio, PRESSURE, w, 60)[0]
        if np.isfinite(fine) and np.isfinite(steeper):
            errors.append(abs((fine - number) / (steeper - fine)) * 1e-3)
    assert np.quantile(errors, 0.9) < 3e-3
    assert max(errors) < 0.08


def test_the_water_gives_the_heat_that_the_air_takes() -> None:
    for hot, water, dry, ratio, wet, number in points(4, 200, (0.5, 2.5)):
        t, w, i = outlet(hot, water, dry, ratio, PRESSURE, wet, number, hot - 4.0, ratio + 0.01)
        left = water - (w - ratio)
        given = CP_WATER * (water * hot - left * t)
        assert i - enthalpy(dry, ratio) == pytest.approx(given, rel=2e-3)
