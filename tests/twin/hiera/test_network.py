"""The network: its size, what may and what may not influence what, and where it starts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed: the network calibrator is left out")

from twin.calibrators.hiera_unet.model.config import PAPER, Config, HieraError, named  # noqa: E402
from twin.calibrators.hiera_unet.model.encoder import Merge  # noqa: E402
from twin.calibrators.hiera_unet.model.heads import LEAST_SD  # noqa: E402
from twin.calibrators.hiera_unet.model.network import HieraUNet, Prediction, decayed  # noqa: E402

SMALL = named("small", **PAPER)


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def stirred(config: Config = SMALL, seed: int = 0) -> HieraUNet:
    """A network whose every weight matters: heads and biases away from zero."""
    torch.manual_seed(seed)
    net = HieraUNet(config)
    with torch.no_grad():
        for p in net.parameters():
            p.add_(0.05 * torch.randn_like(p))
    return net.eval()


def batch(config: Config = SMALL, seed: int = 1, missing: float = 0.2) -> dict[str, Any]:
    g = torch.Generator().manual_seed(seed)
    n = config.context
    return {
        "x": torch.randn(2, n, config.channels, generator=g),
        "m": torch.rand(2, n, config.channels, generator=g) > missing,
        "regime": torch.randint(0, config.regimes, (2, n), generator=g, dtype=torch.int8),
        "clock": torch.randn(2, n, config.clock, generator=g),
        "meta": 0.1 * torch.randn(2, config.meta, generator=g),
    }


def run(net: HieraUNet, inputs: dict[str, Any], **how: Any) -> Prediction:
    with torch.inference_mode():
        return net(**inputs, **how)


@pytest.mark.parametrize(("name", "count"), [("full", 18_623_359), ("small", 1_055_362)])
def test_the_weights_are_as_many_as_the_layer_table_says(name: str, count: int) -> None:
    net = HieraUNet(named(name, **PAPER))
    assert net.count() == count
    assert sum(p.numel() for part in decayed(net) for p in part) == count


def changed_after(inputs: dict[str, Any], step: int) -> dict[str, Any]:
    """Everything that has a time is something else from `step` on."""
    out = {key: value.clone() for key, value in inputs.items()}
    out["x"][:, step:] += 3.0
    out["m"][:, step:] = ~out["m"][:, step:]
    out["regime"][:, step:] = (out["regime"][:, step:] + 1) % 8
    out["clock"][:, step:] -= 2.0
    return out


@pytest.mark.parametrize("ago", [1, 7, 31, 119])
def test_a_causal_correction_knows_nothing_of_later_steps(ago: int) -> None:
    net, inputs = stirred(), batch()
    step = SMALL.context - ago
    a, b = run(net, inputs, causal=True), run(net, changed_after(inputs, step), causal=True)
    before = SMALL.target - ago
    assert torch.equal(a.delta[:, :before], b.delta[:, :before])
    assert torch.equal(a.log_scale[:, :before], b.log_scale[:, :before])
    assert not torch.equal(a.delta[:, before:], b.delta[:, before:])


def test_a_causal_correction_without_any_valid_past_does_not_look_ahead() -> None:
    net, inputs = stirred(), batch(missing=0.0)
    step = SMALL.context - 40
    inputs["m"][:, :step] = False
    a, b = run(net, inputs, causal=True), run(net, {**inputs, "x": inputs["x"] + 1.0}, causal=True)
    before = SMALL.target - 40
    assert torch.equal(a.delta[:, :before], b.delta[:, :before])


def test_the_symmetric_branch_uses_the_whole_interval() -> None:
    net, inputs = stirred(), batch()
    a, b = run(net, inputs), run(net, changed_after(inputs, SMALL.context - 1))
    assert not torch.equal(a.delta[:, :-5], b.delta[:, :-5])


def test_groups_do_not_mix_before_they_are_fused() -> None:
    net, inputs = stirred(), batch()
    encoder = net.encoder
    x, m = inputs["x"], inputs["m"].float()
    other = x.clone()
    other[..., : SMALL.groups[0]] += 5.0
    with torch.inference_mode():
        a, b = (encoder.local(*encoder.embed(v, m), causal=False) for v in (x, other))
    assert all(torch.equal(one, other) for one, other in zip(a[1:], b[1:], strict=True))
    assert not torch.equal(a[0], b[0])


@pytest.mark.parametrize("causal", [False, True])
def test_a_record_of_nothing_gives_finite_numbers(causal: bool) -> None:
    inputs = batch()
    inputs["m"][:] = False
    inputs["x"][:] = torch.nan
    inputs["x"] = torch.where(inputs["m"], inputs["x"], 0.0)
    out = run(stirred(), inputs, causal=causal)
    assert all(torch.isfinite(getattr(out, name)).all() for name in Prediction.__dataclass_fields__)


def test_what_is_masked_has_no_influence() -> None:
    net, inputs = stirred(), batch()
    other = torch.where(inputs["m"], inputs["x"], 99.0)
    assert torch.equal(run(net, inputs).delta, run(net, {**inputs, "x": other}).delta)


def test_an_untrained_network_is_the_commissioned_twin() -> None:
    torch.manual_seed(0)
    out = run(HieraUNet(SMALL), batch())
    assert (out.theta == 0).all() and (out.delta == 0).all() and (out.log_scale == 0).all()


def test_with_evidence_it_starts_from_that() -> None:
    config = replace(SMALL, meta=2 + 5 * 4 + 1, evidence=True)
    torch.manual_seed(0)
    inputs = batch(config)
    inputs["meta"][:, 10:14] = torch.tensor([0.1, -0.05, 0.0, 0.3])
    inputs["meta"][:, 14:18] = sd = torch.tensor([0.02, 0.01, 0.1, 0.05])
    found = run(HieraUNet(config), inputs)
    np.testing.assert_allclose(found.theta[0].numpy(), [0.1, -0.05, 0.0, 0.3], atol=1e-6)
    least = LEAST_SD * np.array(config.bounds)
    np.testing.assert_allclose(
        np.exp(0.5 * found.log_variance[0].numpy()) * config.bounds, np.hypot(sd.numpy(), least), rtol=1e-5
    )


def test_deviations_stay_within_reach_of_their_bounds() -> None:
    net = stirred()
    with torch.no_grad():
        net.parameter_head.out.bias.fill_(50.0)
    top = 1.25 * torch.tensor(SMALL.bounds)
    assert (run(net, batch()).theta.abs() <= top + 1e-6).all()


def test_merging_weighs_tokens_by_their_validity() -> None:
    torch.manual_seed(0)
    merge = Merge(2, 4, 3, 1)
    h, raw, other = torch.randn(1, 4, 4), torch.zeros(1, 2, 2), torch.randn(1, 4, 4)
    valid = torch.tensor([[1.0, 0.0, 0.0, 0.0]])
    with torch.inference_mode():
        y, mean = merge(h, valid, raw)
        again, _ = merge(torch.where(valid[..., None] > 0, h, other), valid, raw)
        assert torch.equal(y, again)
        torch.testing.assert_close(mean, torch.tensor([[0.5, 0.0]]))
        torch.testing.assert_close(y[0, 1], merge.validity.bias + merge.link.bias)
        # Equal validity everywhere: the same sum, and only the embedding of the mean tells it apart.
        full, half = (merge(h, torch.full((1, 4), v), raw)[0] for v in (1.0, 0.5))
        told = merge.validity(torch.tensor([1.0])) - merge.validity(torch.tensor([0.5]))
        torch.testing.assert_close(full - half, told.expand(1, 2, 3))


def test_the_crop_alters_nothing_in_the_target() -> None:
    net, inputs = stirred(), batch()
    for causal in (False, True):
        cropped, whole = run(net, inputs, causal=causal), run(net, inputs, causal=causal, crop=False)
        torch.testing.assert_close(cropped.delta, whole.delta, atol=1e-5, rtol=1e-5)


def test_the_audit_of_each_query_is_a_distribution_over_the_day() -> None:
    out = run(stirred(), batch())
    assert out.attention.shape == (2, 4, 12)
    torch.testing.assert_close(out.attention.sum(-1), torch.ones(2, 4))


def test_a_configuration_survives_its_document_and_refuses_what_does_not_fit() -> None:
    assert Config.of(SMALL.document()) == SMALL
    with pytest.raises(HieraError, match="another version"):
        Config.of({**SMALL.document(), "wings": 2})
    with pytest.raises(HieraError, match="no configuration 'huge'"):
        named("huge", **PAPER)
    with pytest.raises(HieraError, match="do not divide"):
        replace(SMALL, windows=(17, 24, 16, 12))
    with pytest.raises(HieraError, match="cannot hold the evidence"):
        replace(SMALL, evidence=True)


def test_other_tables_and_twins_need_only_other_sizes() -> None:
    config = named("small", groups=(3, 1, 5), bounds=(1.1,) * 9, tolerances=(0.3,) * 3, meta=4)
    out = run(stirred(config), batch(config))
    assert out.theta.shape == (2, 9) and out.delta.shape == (2, 120, 3)
