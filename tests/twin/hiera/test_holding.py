"""What may move of a proposal takes on what may not, as far as readings tell."""

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed: the network calibrator is left out")

from tests.twin.hiera.records import NETWORK, deviation, features, made  # noqa: E402
from twin.calibrators.hiera_unet.features import CONTEXT  # noqa: E402
from twin.calibrators.hiera_unet.holding import given  # noqa: E402

IDS = features().deviations.ids


def held(*names: str) -> np.ndarray:
    return np.array([name in names for name in IDS])


def readings(frame, theta: np.ndarray) -> np.ndarray:
    kernel, full = features().kernel, features().deviations.full(theta, NETWORK.values)
    return kernel.trace(full, frame.start, frame.time, frame.held)[0][0]


@pytest.mark.parametrize("name", ["modules_loss.hA", "tank_loss.hA"])
@pytest.mark.parametrize("now", [0.0, 0.05])
def test_a_twin_with_something_held_reads_what_the_whole_proposal_would(name: str, now: float) -> None:
    """A loss that the network proposes beside heat: where it is held, the heat goes without what the loss takes."""
    frame = features().frame(made(CONTEXT), CONTEXT, NETWORK.values)
    loss = name.replace(".", "__")
    said, live = deviation(modules_power__power=0.4, **{loss: 0.1}), deviation(**{loss: now})
    stay = held(name)
    theta = given(features(), frame, NETWORK.values, said, stay, live)
    assert theta[stay] == live[stay]
    wanted = readings(frame, said)
    naive, taken = (
        float(np.sqrt(np.mean((readings(frame, found) - wanted) ** 2))) for found in (np.where(stay, live, said), theta)
    )
    assert taken < 0.2 * naive
    power = IDS.index("modules_power.power")
    assert theta[power] < said[power] - 0.005


def test_all_or_nothing_held_asks_no_simulation(monkeypatch: pytest.MonkeyPatch) -> None:
    frame = features().frame(made(CONTEXT), CONTEXT, NETWORK.values)
    said, live = deviation(modules_power__power=0.4), deviation(tank_loss__hA=0.3)
    monkeypatch.setattr(type(features().kernel), "trace", None)
    for names, wanted in (((), said), (IDS, live)):
        np.testing.assert_array_equal(given(features(), frame, NETWORK.values, said, held(*names), live), wanted)
