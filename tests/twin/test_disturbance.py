"""The disturbed volume is named in the first window after a change, and only then."""

import numpy as np
import pytest

from tests.twin.conftest import START, drive
from twin.calibrators.base import Calibration
from twin.calibrators.disturbance import with_power_probes
from twin.kernel import simulate
from twin.network import Network, TwinFileError
from twin.tracking import TwinTracker


def campaign(net: Network, change: dict[str, float], onset: int, n: int = 3600) -> tuple[np.ndarray, ...]:
    t, u = drive(n)
    before = simulate(net, t[: onset + 1], u[: onset + 1], START)
    after = simulate(net.with_values(change), t[onset:], u[onset:], before[-1])
    y = np.vstack([before[:-1], after])
    return t, u, y + np.random.default_rng(0).normal(0.0, 1.0, y.shape) * net.sigma


def track(net: Network, record: tuple[np.ndarray, ...], name: str = "least_squares") -> tuple[Calibration, ...]:
    return TwinTracker(net, name).push(*record).calibrations


@pytest.mark.parametrize("name", ["least_squares", "pso", "pso_paper"])
@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"modules_power.power": 150.0}, "modules"),
        ({"tank_loss.hA": 8.5}, "tank"),
        ({"heater_power.factor": 0.93}, "heater"),
        ({"fins.UA_100": 50.0}, "radiator"),
    ],
)
def test_the_disturbed_volume_in_the_first_window_after(loop: Network, name: str, change: dict, where: str) -> None:
    done = track(loop, campaign(loop, change, 1800), name)
    assert [c.disturbed for c in done[:3]] == [None] * 3
    assert done[3].disturbed == where
    assert any(where in flag for flag in done[3].flags)


def test_power_interval_and_onset(loop: Network) -> None:
    found = track(loop, campaign(loop, {"modules_power.power": 150.0}, 1950))[3]
    assert found.disturbed == "modules"
    assert found.disturbed_since_s == pytest.approx(1950.0, abs=1.0)
    assert found.disturbed_interval90_W is not None
    low, high = found.disturbed_interval90_W
    assert low < 150.0 < high
    assert high - low < 60.0
    assert max(found.explains, key=lambda k: found.explains[k]) == "modules"


def test_a_healthy_loop_has_no_place(loop: Network) -> None:
    for done in track(loop, campaign(loop, {}, 1800)):
        assert done.disturbed is None
        assert done.disturbed_W is None


def test_two_changes_at_once_are_not_one_place(loop: Network) -> None:
    change = {"modules_power.power": 150.0, "tank_loss.hA": 20.0}
    assert track(loop, campaign(loop, change, 1800))[3].disturbed is None


def test_nothing_measured(loop: Network) -> None:
    t, u, y = campaign(loop, {}, 600, 1800)
    y[:] = np.nan
    assert all(c.disturbed is None and not c.explains for c in track(loop, (t, u, y)))


def test_probes_change_nothing(loop: Network) -> None:
    probed, ids = with_power_probes(loop)
    t, u = drive(300)
    assert ids == tuple(f"unknown_power_in_{node}.power" for node in loop.nodes)
    assert np.allclose(simulate(probed, t, u, START), simulate(loop, t, u, START), atol=1e-9)
    with pytest.raises(TwinFileError, match="is a name that localisation needs"):
        with_power_probes(probed)
