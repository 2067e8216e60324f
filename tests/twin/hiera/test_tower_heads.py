"""Heads of the tower's network in mixed precision: their steps stay finite and differ from single precision little."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed: the network calibrator is left out")

from tests.twin.hiera.tower_tables import made_table  # noqa: E402
from twin.calibrators.hiera_unet.model.heads import OutputHead, ParameterHead, recent_of  # noqa: E402
from twin.calibrators.hiera_unet.tower.plan import TowerPlan  # noqa: E402
from twin.calibrators.hiera_unet.tower.table import SUBJECT  # noqa: E402
from twin.calibrators.hiera_unet.tower.train import TowerTrainer  # noqa: E402
from twin.calibrators.hiera_unet.tower.windows import Fleet  # noqa: E402

CONFIG = SUBJECT.config("small")
TOKENS = 48


def evidence(generator: torch.Generator) -> tuple[torch.Tensor, ...]:
    """Features, validity, answers, static numbers and channel means of two windows, with a residual and slopes."""
    d3, answers = torch.randn(2, TOKENS, CONFIG.dims[2]), torch.randn(2, len(CONFIG.queries), CONFIG.dims[-1])
    meta = torch.rand(2, CONFIG.meta, generator=generator) * 0.02 + 0.01
    values = torch.randn(2, TOKENS, CONFIG.channels, generator=generator).abs()
    raw = torch.cat([values, torch.ones_like(values)], -1)
    return d3, torch.ones(2, TOKENS), answers, meta, raw


def heads() -> tuple[ParameterHead, OutputHead]:
    torch.manual_seed(0)
    parameters, outputs = ParameterHead(CONFIG), OutputHead(CONFIG)
    assert parameters.step is not None
    parameters.step.start()
    with torch.no_grad():
        parameters.step.share += 0.05  # a step is taken, which an untrained head leaves out
    return parameters, outputs


@torch.no_grad()
def test_the_learned_step_is_solved_in_single_precision_under_autocast() -> None:
    parameters, _ = heads()
    assert parameters.step is not None
    d3, _, _, _, raw = evidence(torch.Generator().manual_seed(1))
    hidden, sd = torch.randn(2, CONFIG.head_hidden), torch.full((2, CONFIG.parameters), 0.1)
    plain = parameters.step(d3, raw, hidden, sd)
    with torch.autocast("cpu", torch.bfloat16):
        half = parameters.step(d3, raw, hidden, sd)
    assert half.dtype == torch.float32
    # Weights of tokens come from products in bfloat16, of three digits.
    assert float((half - plain).abs().max()) < 0.02 * float(plain.abs().max())


def test_both_heads_have_finite_gradients_under_autocast() -> None:
    parameters, outputs = heads()
    given = evidence(torch.Generator().manual_seed(2))
    x = torch.randn(2, CONFIG.context, CONFIG.channels)
    with torch.autocast("cpu", torch.bfloat16):
        theta, log_variance = parameters(*given)
        recent, statics = recent_of(CONFIG, x, x > -1.0), torch.randn(2, CONFIG.meta)
        delta, log_scale = outputs(torch.randn(2, CONFIG.target, CONFIG.dims[0]), recent, statics)
    (theta.sum() + log_variance.sum() + delta.abs().sum() + log_scale.sum()).backward()
    for head in (parameters, outputs):
        for name, one in head.named_parameters():
            assert one.grad is not None and torch.isfinite(one.grad).all(), name
    assert parameters.step is not None and parameters.step.share.grad is not None
    assert (parameters.step.share.grad != 0.0).all()


def test_a_window_without_readings_has_no_learned_step() -> None:
    parameters, _ = heads()
    d3, valid, answers, meta, raw = evidence(torch.Generator().manual_seed(3))
    raw[..., CONFIG.channels :] = 0.0
    taken, _ = parameters(d3, valid, answers, meta, raw)
    without, _ = parameters(d3, valid, answers, meta, None)
    assert torch.allclose(taken, without)


def test_steps_in_mixed_precision_move_weights_that_stay_in_single_precision() -> None:
    fleet = Fleet([made_table()])
    trainer = TowerTrainer(CONFIG, fleet, replace(TowerPlan(steps=3, batch=2, even_every=1), half=True))
    before = [p.detach().clone() for p in trainer.network.parameters()]
    for _ in range(3):
        trainer.step()
    after = list(trainer.network.parameters())
    assert all(p.dtype == torch.float32 and torch.isfinite(p).all() for p in after)
    assert sum(not torch.equal(a, b) for a, b in zip(before, after, strict=True)) > 0.9 * len(after)
    assert np.isfinite(trainer.even)
