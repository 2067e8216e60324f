"""The swarm: the paper's numbers, its window logic, and that it finds what it can."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from tests.twin.conftest import START, drive
from tests.twin.two_nodes import TWO
from twin.calibrators import ANY_TWIN_CALIBRATORS, CALIBRATOR_NAMES, make_calibrator
from twin.calibrators.base import Calibrator, Window
from twin.calibrators.least_squares import LeastSquares
from twin.calibrators.pso import PAPER, TUNED, ParticleSwarm
from twin.calibrators.windows import WindowSamples, classify_window, initial_mismatch, last_row_of_window, make_window
from twin.kernel import simulate
from twin.network import Network, TwinFileError, WindowRules
from twin.tracking import TwinTracker
from twin.twinfile import parse

RULES = WindowRules()


def window(net: Network, truth: Network, number: int = 0, n: int = 600, offset: float = 0.0, seed: int = 1) -> Window:
    """A window measured on `truth`, with `net` as the live twin, `offset` K off at its start."""
    t, u = drive(n, seed)
    y = simulate(truth, t, u, START) + np.random.default_rng(seed).normal(0.0, 1.0, (n, 4)) * net.sigma
    live = simulate(net, t, u, START + offset)
    return make_window(
        number, WindowSamples(t + 600.0 * number, u, y), START + offset, net.values.copy(), live, net.rules
    )


def test_table_2() -> None:
    assert (PAPER.particles, PAPER.iterations) == (5, 5)
    assert (PAPER.inertia, PAPER.damping, PAPER.cognitive, PAPER.social) == (1.0, 0.99, 0.5, 0.7)
    assert (PAPER.velocity, PAPER.perturbation) == (1.6, 1.0)
    assert not (PAPER.own_range or PAPER.scaled or PAPER.realign)


@pytest.mark.parametrize(
    ("mismatch", "error", "kind"),
    [
        (0.05, 0.05, "calibrated"),
        (0.05, 3.0, "calibrated"),
        (0.2, 0.05, "calibrated"),
        (0.2, 0.3, "stall"),
        (0.6, 0.05, "recovery"),
        (5.0, 5.0, "recovery"),
    ],
)
def test_which_cost_a_window_gets(mismatch: float, error: float, kind: str) -> None:
    assert classify_window(mismatch, error, RULES) == kind


def test_noise_alone_is_no_mismatch() -> None:
    noise = np.random.default_rng(0).normal(0.0, 0.08, (60, 4))
    assert initial_mismatch(noise) < 0.05
    assert initial_mismatch(np.full((60, 4), np.nan)) == 0.0


def test_when_a_window_is_complete() -> None:
    t = np.arange(700.0)
    assert last_row_of_window(t, np.ones(700), 600.0) == 599
    assert last_row_of_window(t[:599], np.ones(599), 600.0) is None
    assert last_row_of_window(t, np.full(700, 3.0), 600.0) == 597


def test_a_window_with_too_little_data_is_skipped(loop: Network) -> None:
    t, u = drive(600)
    y = np.full((600, 4), np.nan)
    live = simulate(loop, t, u, START)
    assert make_window(0, WindowSamples(t, u, y), START, loop.values, live, RULES).kind == "skipped"
    y[:20] = 30.0
    assert make_window(0, WindowSamples(t, u, y), START, loop.values, live, RULES).kind == "skipped"


@pytest.mark.parametrize("name", ["pso", "pso_paper", "least_squares", "kalman"])
def test_same_seed_same_answer_and_a_saved_state_goes_on(loop: Network, name: str) -> None:
    truth = loop.with_values({"fins.UA_100": 75.0, "heater_power.factor": 0.95})
    a, b = make_calibrator(name, loop, seed=3), make_calibrator(name, loop, seed=3)
    for number in range(2):
        w = window(loop, truth, number)
        assert a.calibrate(w).values == b.calibrate(w).values
    c = make_calibrator(name, loop, seed=99)
    c.restore(json.loads(json.dumps(a.state())))
    w = window(loop, truth, 2, offset=0.8)
    assert w.kind == "recovery"
    assert a.calibrate(w).values == c.calibrate(w).values


def test_a_swarm_s_state_of_an_older_run_goes_on_with_its_swarm(loop: Network) -> None:
    first, second = make_calibrator("pso", loop, seed=3), make_calibrator("pso", loop, seed=99)
    truth = loop.with_values({"fins.UA_100": 75.0})
    first.calibrate(window(loop, truth, 0))
    saved = first.state()
    older = {key: value for key, value in saved.items() if key != "belief"}
    second.restore(json.loads(json.dumps(older)))
    assert {**second.state(), "belief": None} == {**saved, "belief": None}
    assert second.calibrate(window(loop, truth, 1)).covariance is not None


@pytest.mark.parametrize("settings", [PAPER, replace(PAPER, run_up=False), TUNED])
def test_never_worse_than_what_it_had(loop: Network, settings) -> None:  # type: ignore[no-untyped-def]
    truth = loop.with_values({"fins.UA_100": 64.0})
    swarm = ParticleSwarm(loop, "paper4", settings, seed=1)
    w = window(loop, truth)
    done = swarm.calibrate(w)
    assert w.kind == "calibrated"
    assert done.error_K <= w.error_K * (1.0 + 1e-9)
    low, high = loop.bounds(swarm.ids)
    assert ((np.array(list(done.values.values())) >= low) & (np.array(list(done.values.values())) <= high)).all()


@pytest.mark.parametrize("name", ["pso", "least_squares", "kalman"])
def test_reaches_the_noise_when_the_truth_is_within_reach(loop: Network, name: str) -> None:
    truth = loop.with_values({"fins.UA_100": 80.0, "modules_power.power": 120.0})
    calibrator: Calibrator = make_calibrator(name, loop, "nine", seed=0)
    done = calibrator.calibrate(window(loop, truth))
    assert done.calibrated
    floor = float(np.sqrt(np.mean(loop.sigma**2)))
    assert done.error_K < 1.05 * floor
    assert done.error_before_K > 5.0 * floor
    assert done.fitted.shape == (600, 4)


@pytest.mark.parametrize("name", ["pso", "pso_paper", "least_squares", "kalman"])
def test_a_wrong_state_is_corrected(loop: Network, name: str) -> None:
    w = window(loop, loop, offset=2.0)
    assert w.kind == "recovery"
    done = make_calibrator(name, loop, seed=0).calibrate(w)
    assert np.isfinite(done.error_K)
    if name != "pso_paper":  # the literal swarm has no window before this one to start from
        assert done.error_K < 0.1


def test_least_squares_names_what_a_window_cannot_tell(loop: Network) -> None:
    calibrator = LeastSquares(loop, "nine")
    for number in range(4):
        done = calibrator.calibrate(window(loop, loop.with_values({"fins.UA_100": 90.0}), number))
    assert done.covariance is not None
    assert np.linalg.eigvalsh(done.covariance).min() > -1e-9
    # one ten-minute window of one loop cannot hold nine parameters: R_rt and the like stay unsaid
    assert any("is not identifiable" in flag for flag in done.flags)


def test_unknown_names() -> None:
    with pytest.raises(TwinFileError, match="no calibrator 'psoo'"):
        make_calibrator("psoo", None)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("sets", "expected"),
    [
        (
            '[sets.other]\nmembers = ["link.resistance"]\n[sets.commission]\nmembers = ["a.capacitance"]\n',
            ("a.capacitance",),
        ),
        (
            '[sets.mine]\nmembers = [{ parameter = "link.resistance", scale = 2.0, initial = [1.0, 2.0] }]\n',
            ("link.resistance",),
        ),
        ("", ("link.resistance",)),
    ],
)
def test_a_twin_that_is_no_loop_is_calibrated_by_what_it_has(sets: str, expected: tuple[str, ...]) -> None:
    network = parse(TWO + sets)
    for name in ANY_TWIN_CALIBRATORS:
        assert make_calibrator(name, network).ids == expected
    for name in sorted({*CALIBRATOR_NAMES} - {*ANY_TWIN_CALIBRATORS}):
        with pytest.raises(
            TwinFileError, match=rf"{name} is of the coolant loop only.*pso, .* and kalman take any twin"
        ):
            make_calibrator(name, network)
    done = TwinTracker(network, "pso").push(*_two_nodes_of_another_rig(network)).calibrations
    assert done and done[-1].error_K < 0.5 * done[-1].error_before_K


def _two_nodes_of_another_rig(network: Network) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Twenty minutes after a step at node a, of a rig with half the masses."""
    t = np.arange(1200.0)
    u = np.tile(network.nominal_inputs, (1200, 1))
    truth = network.with_values({"a.capacitance": 500.0, "link.resistance": 0.7})
    return t, u, simulate(truth, t, u, np.array([60.0, 20.0]))


def test_a_twin_without_tunables_is_refused_by_every_calibrator() -> None:
    fixed = re.sub(r"^(capacitance|resistance) = (.*)$", r'\1 = { value = \2, status = "fixed" }', TWO, flags=re.M)
    with pytest.raises(TwinFileError, match="has nothing to calibrate; give a parameter the status 'tunable'"):
        make_calibrator("kalman", parse(fixed))


def test_a_set_without_bounds_cannot_be_swarmed_in_the_papers_units(loop: Network) -> None:
    with pytest.raises(TwinFileError, match="has no bounds"):
        ParticleSwarm(loop, "commission", "paper")
    with pytest.raises(TwinFileError, match="no swarm preset"):
        ParticleSwarm(loop, "paper4", "best")
