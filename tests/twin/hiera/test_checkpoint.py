"""Networks on disk: what comes back, what is refused, and several networks as one."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed: the network calibrator is left out")
pytest.importorskip("safetensors", reason="safetensors is not installed: trained networks cannot be read")

from tests.twin.hiera import fake  # noqa: E402
from twin.calibrators.hiera_unet.model.config import HieraError  # noqa: E402
from twin.calibrators.hiera_unet.model.network import HieraUNet  # noqa: E402
from twin.calibrators.hiera_unet.simulated.store import structure  # noqa: E402
from twin.calibrators.hiera_unet.training.batches import Batch  # noqa: E402
from twin.calibrators.hiera_unet.training.score import outcome  # noqa: E402
from twin.calibrators.hiera_unet.weights.checkpoint import Identity, Member, load, save  # noqa: E402
from twin.calibrators.hiera_unet.weights.ensemble import mixed, together  # noqa: E402
from twin.calibrators.hiera_unet.weights.envelope import Envelope  # noqa: E402
from twin.calibrators.hiera_unet.weights.leakage import leakage  # noqa: E402
from twin.twinfile import load as load_twin  # noqa: E402

TWINS = Path(__file__).resolve().parents[3] / "profiles" / "twins"
IDENTITY = Identity("t", "c", ("a", "b"), ("T_a_C", "T_b_C"))


def member(seed: int = 0) -> Member:
    torch.manual_seed(seed)
    net = HieraUNet(fake.config()).eval()
    with torch.no_grad():
        for p in net.parameters():
            p.add_(0.03 * torch.randn_like(p))
    width = 2 * net.config.channels
    hull = Envelope(np.zeros(width), np.eye(width), 2.0)
    return Member(net, IDENTITY, hull, {"seed": seed, "command": "hil train"})


@pytest.mark.parametrize(("half", "most"), [(False, 0.0), (True, 2e-2)])
def test_what_was_saved_comes_back(tmp_path: Path, half: bool, most: float) -> None:
    saved = member()
    save(saved, tmp_path / "m.safetensors", half=half)
    back = load(tmp_path / "m.safetensors", IDENTITY, fake.config())
    b = Batch.of(fake.windows(2))
    with torch.inference_mode():
        one, two = (m.network(b.x, b.m, b.regime, b.clock, b.meta) for m in (saved, back))
    assert float((one.delta - two.delta).abs().max()) <= most
    assert float((one.theta - two.theta).abs().max()) <= most
    assert back.card["seed"] == 0 and back.envelope.limit == 2.0 and back.card["weights"]["count"] == one_count(saved)


def one_count(m: Member) -> int:
    return m.network.count()


def test_a_checkpoint_of_something_else_is_refused_with_the_reason(tmp_path: Path) -> None:
    path = tmp_path / "m.safetensors"
    with pytest.raises(HieraError, match="no model card"):
        load(path)
    save(member(), path)
    with pytest.raises(HieraError, match="twin of another structure"):
        load(path, replace(IDENTITY, twin="other"))
    with pytest.raises(HieraError, match="another channel table"):
        load(path, replace(IDENTITY, table="other"))
    with pytest.raises(HieraError, match="tell a, b, not a, c"):
        load(path, replace(IDENTITY, parameters=("a", "c")))
    with pytest.raises(HieraError, match="of configuration 'small' with other sizes"):
        load(path, config=fake.config(depths=(1, 1, 2, 1)))


def test_weights_that_are_not_the_cards_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "m.safetensors"
    card = save(member(), path)
    save(member(1), tmp_path / "other.safetensors")
    path.write_bytes((tmp_path / "other.safetensors").read_bytes())
    with pytest.raises(HieraError, match="checksum differs"):
        load(path)
    path.unlink()
    with pytest.raises(HieraError, match="are missing"):
        load(path)
    document = json.loads(card.read_text())
    card.write_text(json.dumps({**document, "format": 99}))
    with pytest.raises(HieraError, match="format 99"):
        load(path)
    card.write_text("{")
    with pytest.raises(HieraError, match="cannot be read"):
        load(path)


def test_a_twin_is_known_by_its_structure_and_not_by_its_values() -> None:
    loop = load_twin(TWINS / "loop.toml")
    other = loop.with_values({"tank_loss.hA": 4.0})
    assert structure(loop) == structure(other)
    assert structure(loop) != structure(load_twin(TWINS / "loop_six.toml"))


def test_an_ensemble_adds_disagreement_to_the_variance() -> None:
    mean, variance = mixed([np.array([1.0]), np.array([3.0])], [np.array([0.5]), np.array([1.5])])
    assert (mean, variance) == (2.0, 2.0)
    windows, told = fake.windows(3), fake.TOLD
    single = [outcome(member(s).network, windows, fake.simulate, told) for s in (0, 1)]
    both = together(single)
    np.testing.assert_allclose(both.error, (single[0].error + single[1].error) / 2.0)
    assert (both.scale >= np.minimum(single[0].scale, single[1].scale)).all()
    np.testing.assert_allclose(
        2.0 * both.scale**2,
        single[0].scale ** 2 + single[1].scale ** 2 + (single[0].error - single[1].error) ** 2 / 4.0,
    )
    np.testing.assert_allclose(both.theta_error, both.theta - windows.theta, atol=1e-6)


def test_parameters_that_hang_on_the_last_steps_leak() -> None:
    b = Batch.of(fake.windows(2))
    untrained = HieraUNet(fake.config()).eval()
    assert leakage(untrained, b.x, b.m, b.regime, b.clock, b.meta) == 0.0
    stirred = member().network
    assert leakage(stirred, b.x, b.m, b.regime, b.clock, b.meta) > 0.0
