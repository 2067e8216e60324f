"""What may move of a proposal is fitted to the record, and takes on what may not."""

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed: the network calibrator is left out")

from tests.twin.hiera.records import NETWORK, deviation, features, made  # noqa: E402
from twin.calibrators.hiera_unet.context_fit.holding import taken  # noqa: E402
from twin.calibrators.hiera_unet.data.features import CONTEXT, Frame  # noqa: E402
from twin.calibrators.hiera_unet.data.windows import TARGET  # noqa: E402

IDS = features().deviations.ids
VAGUELY = 0.5 * features().deviations.prior_sd


def held(*names: str) -> np.ndarray:
    return np.array([name in names for name in IDS])


def misses(frame: Frame, theta: np.ndarray) -> float:
    """Of the ten minutes to come, foretold from where the readings stand, root mean square, K."""
    kernel, full = features().kernel, features().deviations.full(theta, NETWORK.values)
    foretold = kernel.trace(full, frame.state, frame.time[-TARGET:], frame.held[-TARGET:])[0][0]
    return float(np.sqrt(np.mean((foretold - frame.target) ** 2)))


@pytest.mark.parametrize("now", [0.0, 0.05])
def test_a_twin_with_something_held_foretells_what_comes(now: float) -> None:
    """A loss beside heat: where it is held, the heat goes without what the loss takes."""
    truth = deviation(modules_power__power=0.4, modules_loss__hA=0.2)
    frame = features().frame(made(CONTEXT, truth), CONTEXT, NETWORK.values)
    live, stay = deviation(modules_loss__hA=now), held("modules_loss.hA")
    theta = taken(features(), frame, NETWORK.values, truth, VAGUELY, stay, live).theta
    assert theta[stay] == live[stay]
    assert misses(frame, theta) < 0.7 * misses(frame, np.where(stay, live, truth))
    power = IDS.index("modules_power.power")
    assert theta[power] < truth[power] - 0.005


def test_what_is_proposed_by_half_goes_where_the_record_has_it() -> None:
    truth = deviation(modules_power__power=0.4)
    frame = features().frame(made(CONTEXT, truth), CONTEXT, NETWORK.values)
    theta = taken(features(), frame, NETWORK.values, 0.5 * truth, VAGUELY, held(), 0.0 * truth).theta
    assert theta[IDS.index("modules_power.power")] == pytest.approx(0.4, abs=0.04)


def test_where_all_is_held_nothing_is_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    frame = features().frame(made(CONTEXT), CONTEXT, NETWORK.values)
    said, live = deviation(modules_power__power=0.4), deviation(tank_loss__hA=0.3)
    monkeypatch.setattr(type(features().kernel), "trace", None)
    found = taken(features(), frame, NETWORK.values, said, VAGUELY, held(*IDS), live)
    np.testing.assert_array_equal(found.theta, live)
    assert found.evaluations == 0
