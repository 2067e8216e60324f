"""The twin inside the network: its readings are the kernel's and its gradients those of finite differences."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from twin.calibrators.hiera_unet.data.parameters import REACH, Deviations, kernel_of  # noqa: E402
from twin.calibrators.hiera_unet.training.twin_layer import TwinLayer  # noqa: E402
from twin.kernel import simulate  # noqa: E402
from twin.twinfile import load  # noqa: E402

NETWORK = load("profiles/twins/virtual.toml")
DEVIATIONS = Deviations.of(NETWORK)
STEPS = 40


@pytest.fixture(scope="module")
def layer():
    return TwinLayer(kernel_of(NETWORK, DEVIATIONS.ids), DEVIATIONS)


def windows(count: int, seed: int = 0):
    rng = np.random.default_rng(seed)
    theta = rng.uniform(-0.3, 0.3, (count, len(DEVIATIONS)))
    # A loss that is next to nothing bends sharply just below zero; gradients there are tested on their own.
    theta[:, DEVIATIONS.law == 1] = np.abs(theta[:, DEVIATIONS.law == 1])
    state = rng.uniform(28.0, 40.0, (count, len(NETWORK.nodes)))
    inputs = np.tile(NETWORK.nominal_inputs, (count, STEPS, 1))
    inputs[:, STEPS // 2 :, 0] -= 200.0
    return (torch.tensor(a) for a in (theta, state, inputs))


def test_readings_are_those_of_the_twin_with_the_deviations_entered(layer):
    theta, state, inputs = windows(2)
    with torch.no_grad():
        out = layer(theta, state, inputs).numpy()
    for row in range(2):
        full = DEVIATIONS.full(theta[row].numpy(), NETWORK.values)
        expected = simulate(NETWORK, np.arange(STEPS) * 5.0, inputs[row].numpy(), state[row].numpy(), full)
        assert out[row] == pytest.approx(expected, abs=1e-9)


def test_gradients_agree_with_finite_differences(layer):
    theta, state, inputs = windows(2)
    theta.requires_grad_(True)
    state.requires_grad_(True)
    assert torch.autograd.gradcheck(
        lambda t, s: layer(t, s, inputs), (theta, state), eps=1e-4, atol=1e-4, rtol=1e-3, fast_mode=True
    )


def test_a_loss_stays_positive_and_its_gradient_finite_far_below_zero(layer):
    _, state, inputs = windows(1)
    theta = torch.full((1, len(DEVIATIONS)), -REACH, dtype=torch.float64, requires_grad=True)
    layer(theta, state, inputs).sum().backward()
    assert torch.isfinite(theta.grad).all()
    assert (DEVIATIONS.values(theta.detach().numpy()[0], NETWORK.values) >= DEVIATIONS.lower).all()


def test_every_window_has_a_twin_of_its_own(layer):
    theta, state, inputs = windows(2)
    other = NETWORK.values.copy()
    other[NETWORK.index(["fins.UA_100"])] *= 0.5
    nominal = torch.tensor(np.stack([NETWORK.values, other]))
    with torch.no_grad():
        both, own = layer(theta, state, inputs, nominal), layer(theta, state, inputs)
    assert torch.equal(both[0], own[0])
    assert (both[1] - own[1]).abs().max() > 0.1


def test_a_step_of_single_precision_training_follows_the_gradient_downhill(layer):
    theta, state, inputs = windows(1)
    with torch.no_grad():
        goal = layer(theta, state, inputs).float()
    guess = torch.zeros(1, len(DEVIATIONS), requires_grad=True)
    before = (layer(guess, state, inputs) - goal).square().mean()
    before.backward()
    with torch.no_grad():
        after = (layer(guess - 1e-3 * guess.grad / guess.grad.norm(), state, inputs) - goal).square().mean()
    assert after < before
