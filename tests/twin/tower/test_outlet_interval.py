"""Interval of the outlet's true temperature, from residuals of noisy readings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from tests.twin.tower.made_cell import M_W0
from twin.tower.air import Array
from twin.tower.calibration.outlet_interval import half_width
from twin.tower.cell import Inputs
from twin.tower.estimates import Estimate
from twin.tower.minutes import Minutes
from twin.tower.model import NAMES, SLOW, Operation

DAYS = 20
N = DAYS * 1440
SCAN = 3
BY_INLET, BY_WET = 0.6, 0.3
TWIN_K = 0.04
"""Slow error of the made twin, K."""


@dataclass(frozen=True)
class MadeOutlet:
    """Minutes of a made outlet, their blocks, a prediction, the truth and a posterior of nothing but slopes."""

    minutes: Minutes
    of_minute: np.ndarray
    t_out: Array
    truth: Array
    posterior: Estimate

    def half(self) -> Array:
        return half_width(self.minutes, self.of_minute, self.t_out, np.zeros(N), self.posterior)

    def within(self, rows: np.ndarray | slice = slice(None)) -> float:
        return float(np.mean((np.abs(self.truth - self.t_out) <= self.half())[rows]))


def made_outlet(reading_K: float, input_K: float, *, bias_sd: float = 0.0, regime: Array | None = None) -> MadeOutlet:
    """Minutes whose outlet is read every third minute with noise `reading_K`, and predicted from an inlet and a wet
    bulb with noise `input_K` and from a twin that errs slowly."""
    rng = np.random.default_rng(5)
    minute = np.arange(N)
    truth = 24.0 + 2.0 * np.sin(2 * np.pi * minute / 1440.0)
    slow = np.interp(minute, np.arange(0, N + 240, 240), rng.normal(0, TWIN_K, N // 240 + 1))
    sampled = minute % SCAN == 0
    noise = [np.interp(minute, minute[sampled], rng.normal(0, input_K, sampled.sum())) for _ in range(2)]
    t_out = truth + slow + BY_INLET * noise[0] + BY_WET * noise[1]
    outlet = np.where(sampled, truth + rng.normal(0, reading_K, N), np.nan)
    full = np.ones(N)
    inputs = Inputs(32.0 + noise[0], M_W0 * full, 0.8 * full, 25.0 * full, 20.0 * full + noise[1], 99.0 * full)
    operation = Operation(inputs, 0.0 * full, 3.0 * full, 0.0 * full, full)
    steady = np.ones(N, dtype=bool)
    kind = np.full(N, 3, dtype=np.uint8) if regime is None else regime.astype(np.uint8)
    minutes = Minutes(1.66e9 + 60.0 * minute, operation, outlet, np.full(N, np.nan), steady, steady, kind)
    return MadeOutlet(minutes, minute // 10, t_out, truth, posterior(minutes, bias_sd))


def posterior(minutes: Minutes, bias_sd: float) -> Estimate:
    slow, blocks = len(SLOW), N // 10
    jacobian = np.zeros((blocks, slow + len(NAMES)))
    jacobian[:, slow + NAMES.index("inlet_bias")] = BY_INLET
    jacobian[:, slow + NAMES.index("wet_bulb_bias")] = BY_WET
    covariance = np.zeros((slow + len(NAMES), slow + len(NAMES)))
    covariance[SLOW.index("bias"), SLOW.index("bias")] = bias_sd**2
    nothing = np.zeros(blocks)
    edges = np.array([minutes.time_s[0], minutes.time_s[-1] + 60.0])
    return Estimate(
        edges, np.zeros((1, slow)), np.zeros(len(NAMES)), covariance, (0.1, 0.03), nothing, nothing,
        np.zeros(blocks, dtype=np.intp), jacobian, 3.0, nothing, nothing,
    )  # fmt: skip


@pytest.mark.parametrize("reading_K", [0.01, 0.05, 0.1])
def test_nine_tenths_of_the_water_is_within_the_interval_however_noisy_all_thermometers_are(reading_K: float) -> None:
    made = made_outlet(reading_K, reading_K)
    # Between readings of the inputs their noise is smaller than at them, so a little more is within.
    assert 0.87 <= made.within() <= 0.97


def test_the_noise_of_the_outlets_own_thermometer_is_taken_off() -> None:
    noisy = made_outlet(0.08, 0.03)
    naive = np.nanquantile(np.abs(noisy.minutes.outlet - noisy.t_out), 0.9)
    # Differences are divided as if all thermometers were alike, so some of this noise counts as the inputs'.
    assert noisy.half().mean() < 0.75 * naive
    assert noisy.within() >= 0.9


def test_the_noise_of_the_inputs_stays_in_the_interval() -> None:
    made = made_outlet(0.05, 0.08)
    error = np.abs(made.truth - made.t_out)
    assert made.half().mean() > 0.85 * np.quantile(error, 0.9)


def test_an_archive_that_stores_only_what_has_moved_gives_the_same_interval() -> None:
    made = made_outlet(0.05, 0.05)
    every = made.half().mean()
    outlet, last = made.minutes.outlet, np.inf
    for i in np.flatnonzero(np.isfinite(outlet)):
        if abs(outlet[i] - last) < 0.1:
            outlet[i] = np.nan
        else:
            last = outlet[i]
    assert np.isfinite(outlet).mean() < 0.2
    assert made.half().mean() == pytest.approx(every, rel=0.25)


def test_the_uncertainty_of_the_bias_widens_the_interval_in_quadrature() -> None:
    sharp, open_ = made_outlet(0.03, 0.03).half(), made_outlet(0.03, 0.03, bias_sd=0.1).half()
    assert np.allclose(open_**2 - sharp**2, (1.6449 * 0.1) ** 2)


def test_a_regime_of_few_windows_takes_the_interval_of_all_steady_minutes() -> None:
    regime = np.full(N, 3.0)
    regime[600:960] = 6.0  # three windows
    usual = made_outlet(0.03, 0.03)
    made = made_outlet(0.03, 0.03, regime=regime)
    few = made.half()[regime == 6.0]
    assert np.allclose(few, usual.half()[regime == 6.0], rtol=0.05)


def test_a_regime_with_larger_errors_has_its_own_interval() -> None:
    regime = np.where(np.arange(N) % 2880 < 720, 6.0, 3.0)
    made = made_outlet(0.03, 0.03, regime=regime)
    made.t_out[regime == 6.0] += np.where(np.arange(N)[regime == 6.0] // 120 % 2, 0.3, -0.3)
    half = made.half()
    assert half[regime == 6.0].min() > 0.25 > 0.15 > half[regime == 3.0].max()
    for one in (3.0, 6.0):
        assert made.within(regime == one) >= 0.85


def test_a_record_of_few_readings_keeps_its_largest_residual() -> None:
    made = made_outlet(0.03, 0.03)
    made.minutes.outlet[60:] = np.nan  # 20 readings of one window
    residual = np.abs(made.minutes.outlet - made.t_out)
    noise = made.half().max() ** 2 - np.nanmax(residual) ** 2
    assert -((1.6449 * 0.03) ** 2) * 1.5 < noise <= 0.0


def test_too_few_pairs_take_no_noise_off() -> None:
    made = made_outlet(0.03, 0.03)
    made.minutes.outlet[np.arange(N) % 60 != 0] = np.nan  # one an hour: none is close to another
    half = made.half()
    size = np.abs(made.minutes.outlet - made.t_out)
    assert half.min() >= np.nanquantile(size, 0.9) - 1e-9
