"""What a single window can tell, and that nothing else is reported as if it could."""

import numpy as np
import pytest

from tests.twin.conftest import START, drive
from twin.calibrators import make_calibrator
from twin.calibrators.base import Window
from twin.calibrators.identifiability import UNIDENTIFIABLE_SHARE, condition_number, window_information
from twin.calibrators.windows import WindowSamples, make_window
from twin.kernel import simulate
from twin.network import Network

R_RT = "radiator_to_tank.resistance"
NAMES = ["pso", "least_squares"]


def window(net: Network, truth: Network, inputs: np.ndarray | None = None, number: int = 0) -> Window:
    t, u = drive(600, 1)
    u = u if inputs is None else inputs
    y = simulate(truth, t, u, START) + np.random.default_rng(number).normal(0.0, 1.0, (600, 4)) * net.sigma
    live = simulate(net, t, u, START)
    return make_window(number, WindowSamples(t + 600.0 * number, u, y), START, net.values.copy(), live, net.rules)


@pytest.mark.parametrize("name", ["pso", "pso_paper", "least_squares"])
def test_the_papers_four_are_not_separable_in_one_window(loop: Network, name: str) -> None:
    """R_rt of Table 2: its standard error from one ten-minute window alone is a large part of its range [0, 3]."""
    done = make_calibrator(name, loop, "paper4", seed=0).calibrate(window(loop, loop))
    spread = {k: done.window_errors[k] for k in done.values}
    assert spread[R_RT] > 0.15 * 3.0
    assert spread["heater_power.factor"] < 0.01
    assert spread["fins.UA_100"] < 0.01 * 100.0
    assert any(flag.startswith(f"{R_RT} is not identifiable") for flag in done.flags)
    assert done.condition is not None
    assert done.condition > 3.0


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("tunables", ["paper4", "nine", "twelve"])
def test_what_is_frozen_has_not_moved_and_is_named(loop: Network, name: str, tunables: str) -> None:
    done = make_calibrator(name, loop, tunables, seed=0).calibrate(window(loop, loop))
    assert R_RT in done.frozen
    for frozen in done.frozen:
        assert done.values[frozen] == pytest.approx(loop.parameters[frozen].value, rel=1e-12)
        assert f"{frozen} is not identifiable: held" in done.flags


def test_every_number_that_moves_is_told_or_comes_with_a_warning(loop: Network) -> None:
    truth = loop.with_values({R_RT: 0.05, "fins.UA_100": 75.0, "tank_loss.hA": 8.0})
    calibrator = make_calibrator("least_squares", loop, "nine")
    for number in range(3):
        done = calibrator.calibrate(window(loop, truth, number=number))
        moved = {k for k in done.values if k not in done.frozen}
        warned = {flag.split()[0] for flag in done.flags if "not identifiable by itself" in flag}
        assert warned <= moved
        assert not warned & set(done.frozen)


@pytest.mark.parametrize("name", NAMES)
def test_a_held_value_that_the_window_contradicts_is_released(loop: Network, name: str) -> None:
    truth = loop.with_values({"tank_loss.hA": 20.0, "modules_power.power": 200.0, "heater_loss.hA": 6.0})
    done = make_calibrator(name, loop, "twelve", seed=0).calibrate(window(loop, truth))
    assert "heater_loss.hA" not in done.frozen
    assert "heater_loss.hA is not identifiable by itself: it stands for others too" in done.flags
    assert done.error_K < 1.05 * float(np.sqrt(np.mean(loop.sigma**2)))


@pytest.mark.parametrize("name", [*NAMES, "pso_paper"])
def test_constant_inputs_are_fitted_and_finite(loop: Network, name: str) -> None:
    u = np.tile([700.0, 100.0, 70.0, 22.0], (600, 1))
    done = make_calibrator(name, loop, "nine", seed=0).calibrate(window(loop, loop, u))
    assert np.isfinite(list(done.values.values())).all()
    assert np.isfinite(list(done.window_errors.values())).all()
    assert np.isfinite(done.error_K)
    assert done.flags


def test_backward_elimination_keeps_what_can_be_told() -> None:
    """Two parameters with one effect: one of them goes, the other stays; a third is on its own."""
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 500))
    told = window_information(np.atleast_2d(np.cov(np.stack([a, a, b]))) * 500.0, np.ones(3))
    assert told.unidentifiable.sum() == 1
    assert not told.unidentifiable[2]
    assert told.condition > 1e6
    assert told.spread[2] < UNIDENTIFIABLE_SHARE < told.spread[0]


def test_no_information_at_all() -> None:
    told = window_information(np.zeros((6, 6)), np.full(4, 0.5))
    assert told.unidentifiable.all()
    assert np.isfinite(told.spread).all()
    assert condition_number(np.zeros((0, 0))) == 1.0
