"""Noise of one record: from its own residual, and errors after fast changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twin.discovery.evidence.priors import FORM_ERRORS
from twin.discovery.records.change_errors import SHARES, ChangeErrors
from twin.discovery.records.grid import Grid
from twin.discovery.records.noise import CAUTION, Noise, learn

STEP_S = 10.0
ROWS, SENSORS = 3600, 3


def _grid(measured: np.ndarray) -> Grid:
    time = STEP_S * np.arange(len(measured))
    return Grid(time, np.zeros((len(measured), 1)), measured, np.full(SENSORS, 0.02), STEP_S)


def _readings(jumps: bool) -> np.ndarray:
    """Return readings (n, m), degC, that rise by 10 K over the record, or step by 2 K every hour."""
    ramp = np.linspace(30.0, 40.0, ROWS)
    steps = 30.0 + 2.0 * ((np.arange(ROWS) // 360) % 2)
    return np.repeat((steps if jumps else ramp)[:, None], SENSORS, axis=1)


def _with_errors(twin: np.ndarray, share: float) -> np.ndarray:
    """Return readings (n, m), degC, off by a share of 2 K for 200 s after each jump of the twin's."""
    rng = np.random.default_rng(1)
    measured = twin + rng.normal(0.0, 0.02, twin.shape)
    for row in range(360, ROWS, 360):
        measured[row : row + 20] += share * 2.0 * rng.choice([-1.0, 1.0], SENSORS)
    return measured


@pytest.mark.parametrize("share", [0.0, 0.1])
@pytest.mark.parametrize("jumps", [True, False])
def test_the_error_after_a_jump_is_that_of_health_or_for_larger_jumps_the_records_own(
    share: float, jumps: bool
) -> None:
    twin = _readings(jumps=True)
    there, none = _grid(_with_errors(twin, share)), _grid(_with_errors(twin, 0.0))
    calm = _readings(jumps=False)
    health = ChangeErrors.of(there, twin) if jumps else ChangeErrors.of(_grid(_with_errors(calm, 0.0)), calm)
    found = health.errors(none if jumps else there, twin)
    after, later = (0.0, 0.0) if found is None else (found[365:375].mean(), found[500:700].mean())
    assert later < 0.005
    assert 0.1 < after < 0.4 if share else after < 0.03


def test_what_health_shows_to_be_exact_is_not_excused_in_a_record() -> None:
    twin = _readings(jumps=True)
    found = ChangeErrors.of(_grid(_with_errors(twin, 0.0)), twin).errors(_grid(_with_errors(twin, 0.1)), twin)
    assert found is None or found.max() < 0.03


def test_a_steady_rise_is_no_fast_change() -> None:
    rng = np.random.default_rng(2)
    twin = _readings(jumps=False)
    grid = _grid(twin + rng.normal(0.0, 0.5, twin.shape))
    found = ChangeErrors.of(grid, twin).errors(grid, twin)
    assert found is None or found[100:-100].max() < 0.01


def _healthy() -> Noise:
    rng = np.random.default_rng(3)
    slow = np.cumsum(rng.normal(0.0, 0.01, (ROWS, SENSORS)), axis=0)
    twin = _readings(jumps=True)
    return learn(slow + rng.normal(0.0, 0.02, slow.shape), np.full(SENSORS, 0.02), STEP_S, twin)


def test_a_record_leaves_a_share_of_the_noise_but_not_less_than_the_thermometers_have() -> None:
    noise, twin = _healthy(), _readings(jumps=True)
    count = len(noise.roots)
    usual = noise.where_moved(twin, STEP_S)
    quieter = replace(noise, relative=np.repeat(0.25 * np.eye(SENSORS)[None], count, axis=0)).where_moved(twin, STEP_S)
    silent = replace(noise, relative=np.repeat(1e-6 * np.eye(SENSORS)[None], count, axis=0)).where_moved(twin, STEP_S)
    assert np.allclose(quieter.sd[0], 0.5 * usual.sd[0], rtol=0.01)
    assert (silent.sd >= noise.white - 1e-12).all() and np.allclose(silent.sd[0], noise.white, rtol=0.01)


def test_caution_is_used_up_before_less_is_expected() -> None:
    noise = _healthy()
    relative = np.repeat(0.5 * np.eye(SENSORS)[None], len(noise.roots), axis=0)
    known = replace(noise, relative=relative)
    assert np.allclose(noise.expected, 1.0 / np.array(CAUTION))
    assert np.allclose(known.expected, np.minimum(2.0 / np.array(CAUTION), 1.0))


def test_the_whitening_matrix_is_symmetric() -> None:
    roots = _healthy().roots
    assert np.allclose(roots, np.swapaxes(roots, 1, 2))


def test_shares_of_a_change_are_those_of_a_form_error() -> None:
    assert (0.0, *FORM_ERRORS) == SHARES
