"""Training: it learns, it hides the answer, it goes on where it was cut."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed: the network calibrator is left out")

from tests.twin.hiera import fake  # noqa: E402
from twin.calibrators.hiera_unet.model.config import HieraError  # noqa: E402
from twin.calibrators.hiera_unet.training import losses  # noqa: E402
from twin.calibrators.hiera_unet.training.hiding import blind, hide  # noqa: E402
from twin.calibrators.hiera_unet.training.plan import Hiding, TrainingPlan  # noqa: E402
from twin.calibrators.hiera_unet.training.sampling import Sampler, neighbours  # noqa: E402
from twin.calibrators.hiera_unet.training.score import outcome  # noqa: E402
from twin.calibrators.hiera_unet.training.train import Physics, Trainer  # noqa: E402

PHYSICS = Physics(fake.simulate, fake.TOLD)


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def test_eight_windows_are_learned_by_heart() -> None:
    windows = fake.windows(8)
    plan = TrainingPlan(
        steps=80,
        batch=8,
        rate=4e-3,
        warmup=0.1,
        ema=0.9,
        structure=0.0,
        pairs=0,
        hiding=Hiding(whole=1.0, dropped=0.0, burst=0.0),
    )
    trainer = Trainer(fake.config(), windows, PHYSICS, plan)
    before = outcome(trainer.network, windows, fake.simulate, fake.TOLD).metrics()
    for _ in range(plan.steps):
        parts = trainer.step()
    assert np.isfinite(list(parts.values())).all()
    after = outcome(trainer.average, windows, fake.simulate, fake.TOLD).metrics()
    assert np.mean(after["mae"]) < 0.3 * np.mean(before["mae"])
    assert np.mean(after["theta_mae"]) < 0.8 * np.mean(after["theta_mae_evidence"])


def test_a_training_that_was_cut_goes_on_as_if_it_had_not_been(tmp_path: Path) -> None:
    windows, plan = fake.windows(10), TrainingPlan(steps=6, batch=4, pairs=1, structure=0.4, sure=0.3)

    def fresh() -> Trainer:
        return Trainer(fake.config(), windows, PHYSICS, plan)

    whole, first, second = fresh(), fresh(), fresh()
    expected = [whole.step() for _ in range(6)]
    assert "parameter" not in expected[0] and {"parameter", "gaussian", "smooth"} <= expected[-1].keys()
    for _ in range(3):
        first.step()
    torch.save(first.state(), tmp_path / "training.pt")
    second.restore(torch.load(tmp_path / "training.pt", weights_only=True))
    assert [second.step() for _ in range(3)] == expected[3:]
    for a, b in zip(whole.average.parameters(), second.average.parameters(), strict=True):
        assert torch.equal(a, b)
    other = Trainer(fake.config(), windows, PHYSICS, replace(plan, rate=5e-3))
    with pytest.raises(HieraError, match="another configuration, plan or data"):
        other.restore(first.state())


def test_windows_of_another_table_are_refused() -> None:
    with pytest.raises(HieraError, match="do not fit configuration"):
        Trainer(fake.config(groups=(2, 4)), fake.windows(4), PHYSICS, TrainingPlan())


def test_the_structure_is_learned_on_healthy_windows_only() -> None:
    windows = fake.windows(12)
    windows.changed[:3] = True
    sampler = Sampler(windows, fake.config(), TrainingPlan(batch=50))
    rows, pairs = sampler.draw(structural=True)
    assert not windows.changed[rows].any() and (windows.theta[rows] == 0).all() and len(pairs) == 0


def test_pairs_are_windows_of_one_rig_in_one_condition() -> None:
    windows = fake.windows(12)
    found = neighbours(windows)
    assert len(found)
    for i, j in found:
        assert windows.nominal[i, 0] == windows.nominal[j, 0]
        assert np.abs(windows.theta[i] - windows.theta[j]).max() < 1e-2
    rows, pairs = Sampler(windows, fake.config(), TrainingPlan()).draw(structural=False)
    assert len(rows) == 12
    assert all(tuple(rows[p]) in {tuple(f) for f in found} for p in pairs.numpy())


def hidden(rules: Hiding) -> Any:
    mask = torch.ones(200, 1440, 5, dtype=torch.bool)
    told = torch.from_numpy(fake.TOLD)
    return hide(mask, told, 120, rules, torch.Generator().manual_seed(0)), told


def test_hiding_takes_the_answer_and_nothing_else() -> None:
    out, told = hidden(Hiding(whole=1.0, dropped=0.0, burst=0.0))
    assert out[..., ~told].all()
    assert out[:, :-120].all() and not out[:, -120:, told].any()
    assert torch.equal(blind(torch.ones_like(out), told, 120), out)


def test_without_hiding_it_all_blocks_of_many_sizes_are_hidden() -> None:
    out, told = hidden(Hiding(whole=0.0, dropped=0.0, burst=0.0))
    share = out[:, -120:, told][..., 0].float().mean(1)
    assert out[:, :-120].all()
    assert share.min() < 0.2 and share.max() > 0.8 and 0.4 < share.mean() < 0.6
    assert torch.equal(out[:, -120:-100, told].all(1), out[:, -120:-100, told].any(1))


def test_bursts_and_lost_channels_leave_commands_alone() -> None:
    out, told = hidden(Hiding(whole=0.0, dropped=1.0, each=0.5, burst=1.0))
    assert out[..., ~told].all()
    assert 0.3 < (~out[:, 0, told]).float().mean() < 0.7


def test_losses_judge_only_what_is_known() -> None:
    nan = float("nan")
    error = torch.tensor([[[0.3, nan], [-0.6, nan]]])
    tolerances = torch.tensor([0.3, 0.3])
    torch.testing.assert_close(losses.data_loss(error, tolerances), torch.tensor(1.5))
    theta, true = torch.tensor([[0.5, 0.1]], requires_grad=True), torch.tensor([[nan, 0.2]])
    known = torch.tensor([[False, True]])
    loss = losses.parameter_loss(theta, true, known, torch.ones(2))
    loss.backward()
    torch.testing.assert_close(loss.detach(), torch.tensor(0.01))
    assert theta.grad is not None and theta.grad[0, 0] == 0 and torch.isfinite(theta.grad).all()


def test_what_is_not_known_spoils_no_gradient() -> None:
    nan = float("nan")
    theta, spread = torch.zeros(1, 2, requires_grad=True), torch.zeros(1, 2, requires_grad=True)
    true, known = torch.tensor([[nan, 0.2]]), torch.tensor([[True, True]])
    bounds = torch.ones(2)
    both = losses.gaussian_loss(theta - true, spread, bounds, known) + losses.parameter_loss(theta, true, known, bounds)
    rows = (theta - true)[:, None]
    (both + losses.laplace_loss(rows, spread[:, None], bounds) + losses.data_loss(rows, bounds)).backward()
    for leaf in (theta, spread):
        assert leaf.grad is not None and torch.isfinite(leaf.grad).all()
        assert leaf.grad[0, 0] == 0.0 and leaf.grad[0, 1] != 0.0


def test_the_likeliest_scale_is_that_of_the_errors() -> None:
    generator = torch.Generator().manual_seed(0)
    error = torch.distributions.Laplace(0.0, 0.15).icdf(torch.rand(1, 4000, 1, generator=generator) * 0.998 + 0.001)
    tolerances = torch.tensor([0.3])
    scales = torch.linspace(-2.0, 1.0, 61)

    def nll(s: float) -> float:
        b = torch.exp(torch.tensor(s)) + losses.RESOLUTION
        return float(losses.laplace_loss(error, torch.full_like(error, s), tolerances) / b**losses.BETA)

    best = scales[int(np.argmin([nll(float(s)) for s in scales]))]
    assert abs(float(torch.exp(best)) * 0.3 - 0.15) < 0.02


def test_a_correction_that_conserves_energy_has_no_price() -> None:
    storage, exchange = torch.tensor([[1000.0, 1000.0]]), torch.tensor([[2.0, 0.0]])
    judged = torch.tensor([True])
    apart = torch.zeros(1, 120, 2)
    apart[..., 1] = torch.linspace(0.0, 1.0, 120)
    warmer = torch.full((1, 120, 2), 0.5)
    moved = torch.stack([apart[..., 1], -apart[..., 1]], -1)

    def price(delta: Any, lost: Any = exchange) -> float:
        return float(losses.balance_loss(delta, storage, lost, 700.0, judged, 5.0))

    assert price(torch.zeros(1, 120, 2)) == 0.0
    assert price(moved, torch.zeros(1, 2)) < 1e-5
    # 1 K in 600 s in 1000 J/K are 1.68 W a sample interval from first to last, of 17.5 W.
    np.testing.assert_allclose(price(apart), 1000.0 / (119 * 5.0) / 17.5, rtol=1e-3)
    np.testing.assert_allclose(price(warmer), 1.0 / 17.5, rtol=1e-5)
    assert float(losses.balance_loss(apart, storage, exchange, 700.0, ~judged, 5.0)) == 0.0


def test_what_is_said_to_be_sure_and_is_far_off_pulls_no_harder_than_the_rest() -> None:
    bounds, known = torch.ones(1), torch.ones(1, 1, dtype=torch.bool)
    for sure in (-11.0, -6.0, -2.0):
        theta, spread = torch.zeros(1, 1, requires_grad=True), torch.full((1, 1), sure, requires_grad=True)
        losses.gaussian_loss(theta - 0.5, spread, bounds, known).backward()
        assert theta.grad is not None and spread.grad is not None
        assert abs(float(theta.grad)) <= losses.FAR and abs(float(spread.grad)) <= losses.FAR
        near = torch.zeros(1, 1, requires_grad=True)
        losses.gaussian_loss(near - 0.01 * torch.exp(0.5 * spread.detach()), spread.detach(), bounds, known).backward()
        assert near.grad is not None and abs(float(near.grad)) < abs(float(theta.grad))
