"""Least squares led by the network: it follows a change early, and answers alone where the network does not lead."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed: the network calibrator is left out")
pytest.importorskip("safetensors", reason="safetensors is not installed: trained networks cannot be read")

from tests.twin.hiera.loop_ensemble import LOOP, TANK, calibrator, fouling, lying
from twin.calibrators.hiera_unet.serve.members import Ensemble
from twin.calibrators.hiera_unet.serve.refined import RefinedCalibrator
from twin.tracking import TwinTracker


def refined(ensemble: Ensemble) -> TwinTracker:
    return TwinTracker(LOOP, RefinedCalibrator(LOOP, calibrator(ensemble)))


@pytest.fixture(scope="module")
def fouled(ensemble: Ensemble) -> tuple[Any, Any]:
    """Calibrations of least squares alone, and led by the network, where the radiator fouls at 3,330 s."""
    whole = fouling(3330)
    both = TwinTracker(LOOP, "least_squares"), refined(ensemble)
    return both[0].push(*whole).calibrations, both[1].push(*whole).calibrations


def test_a_change_inside_a_window_is_followed_before_the_next_where_least_squares_alone_lags(
    fouled: tuple[Any, Any],
) -> None:
    alone, led = fouled
    assert led[5].flags[-1] == "led by the network"
    assert alone[6].error_before_K > 0.1 > led[6].error_before_K
    assert abs(led[5].values["fins.UA_100"] - 45.0) < 3.0 < abs(alone[5].values["fins.UA_100"] - 45.0)
    assert led[5].error_K < alone[5].error_K


def test_a_change_early_in_a_window_is_followed_from_its_middle_on(ensemble: Ensemble) -> None:
    """What least squares alone makes of the window at its end, where nothing is far better, is the answer still."""
    t, u, y = fouling(3030)
    alone, led = (tracker.push(t, u, y) for tracker in (TwinTracker(LOOP, "least_squares"), refined(ensemble)))
    late = (t > 3300.0) & (t < 3600.0)
    missed, less = (np.sqrt(np.mean((update.tracked - y)[late] ** 2)) for update in (alone, led))
    assert missed > 0.1 > less  # noise of 0.05 K included
    assert np.array_equal(led.tracked[t < 3300.0], alone.tracked[t < 3300.0]) and not led.proposals
    assert all(c.flags[-1].startswith("on its own") for c in led.calibrations[:5])


def test_where_the_network_does_not_lead_least_squares_answers_as_if_it_were_alone(fouled: tuple[Any, Any]) -> None:
    """To the last bit, before a change and, once both have seen it, nearly so after it."""
    alone, led = fouled
    for first, second in zip(alone[:5], led[:5], strict=True):
        assert second.flags[-1].startswith("on its own") and second.values == pytest.approx(first.values, rel=1e-9)
        assert np.allclose(second.fitted, first.fitted, atol=1e-6)
    assert led[6].flags[-1].startswith("on its own")
    assert led[6].values == pytest.approx(alone[6].values, rel=1e-6)


def test_least_squares_and_network_go_on_from_their_saved_state(ensemble: Ensemble, fouled: tuple[Any, Any]) -> None:
    t, u, y = fouling(3330)
    first, second = (refined(ensemble) for _ in range(2))
    expected = fouled[1][-1]
    first.push(t[:3500], u[:3500], y[:3500])
    second.restore(json.loads(json.dumps(first.state())))
    found = second.push(t[3500:], u[3500:], y[3500:]).calibrations[-1]
    assert found.values == expected.values and found.flags == expected.flags


def test_least_squares_after_the_network_leaves_aside_what_the_network_does(ensemble: Ensemble) -> None:
    t, u, y, true = lying()
    done = TwinTracker(LOOP, RefinedCalibrator(LOOP, calibrator(ensemble))).push(t, u, y)
    assert np.abs((done.tracked - true)[t >= 6000.0 + 1200.0, TANK]).mean() < 0.12
    last = done.calibrations[-1].flags
    assert [f[:24] for f in last if "SENSOR" in f] == ["DOUBTED_SENSOR: T_tank_C"], last
