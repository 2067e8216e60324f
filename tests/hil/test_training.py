"""`hil train`: in pieces to a card, a picture and an ensemble; refusals in plain sentences."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

torch = pytest.importorskip("torch", reason="torch is not installed: the network calibrator is left out")
pytest.importorskip("safetensors", reason="safetensors is not installed: trained networks cannot be written")

from hil.commands.train import PIECES as command_pieces  # noqa: E402
from hil.commands.train import command  # noqa: E402
from hil.training import session  # noqa: E402
from hil.training.ablation import PIECES, without  # noqa: E402
from hil.training.data import Data, read  # noqa: E402
from hil.training.ensemble import assemble  # noqa: E402
from hil.training.generate import features_of  # noqa: E402
from tests.twin.hiera import fake  # noqa: E402
from twin.calibrators.hiera_unet import binding  # noqa: E402
from twin.calibrators.hiera_unet.checkpoint import Identity, load  # noqa: E402
from twin.calibrators.hiera_unet.config import HieraError  # noqa: E402
from twin.calibrators.hiera_unet.device import ready  # noqa: E402
from twin.calibrators.hiera_unet.hiding import hide  # noqa: E402
from twin.calibrators.hiera_unet.network import HieraUNet  # noqa: E402
from twin.calibrators.hiera_unet.plan import Plan  # noqa: E402
from twin.calibrators.hiera_unet.train import Physics  # noqa: E402
from twin.network import TwinFileError  # noqa: E402

IDENTITY = Identity("t", "c", ("a", "b"), ("T_a_C", "T_b_C"))


@pytest.fixture
def data(monkeypatch: pytest.MonkeyPatch) -> Data:
    """Fake windows, and a binding to their fake twin."""
    monkeypatch.setattr(binding, "config_for", lambda *_: fake.config())
    monkeypatch.setattr(binding, "physics_of", lambda *_: Physics(fake.simulate, fake.TOLD))
    monkeypatch.setattr(binding, "identity_of", lambda *_: IDENTITY)
    monkeypatch.setattr(session, "LOOK_EVERY", 2)
    table = type("Table", (), {"name": "fake"})()
    parts = [fake.windows(n, seed) for seed, n in enumerate((12, 6, 30, 6))]
    return Data(None, table, None, *parts, manifest={"seed": 0}, digest="d")  # type: ignore[arg-type]


def trained(data: Data, folder: Path, seed: int, minutes: float | None = None) -> session.Outcome:
    plan = Plan(steps=4, batch=5, pairs=1, seed=seed)
    return session.train(
        data, "small", plan, folder / f"fake_small_{seed}", folder / f"fake_small_{seed}.safetensors",
        minutes=minutes, command="hil train", say=lambda *_: None,
    )  # fmt: skip


def test_a_training_in_pieces_ends_with_card_picture_and_ensemble(data: Data, tmp_path: Path) -> None:
    cut = trained(data, tmp_path, 0, minutes=0.0)
    assert (cut.done, cut.card) == (0, None)
    done = trained(data, tmp_path, 0)
    assert done.done == 4 and done.card is not None and done.picture is not None and done.picture.stat().st_size > 1000
    card = json.loads(done.card.read_text(), parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    assert [c["step"] for c in card["curves"]] == [2, 4] and card["data"] == {"seed": 0, "sha256": "d"}
    assert card["command"] == "hil train" and card["seed"] == 0 and len(card["metrics"]["blind"]["mae"]) == 2
    load(tmp_path / "fake_small_0.safetensors", IDENTITY, fake.config())
    assert any("unseen windows" in line for line in done.lines)
    trained(data, tmp_path, 1)
    ensemble = json.loads((tmp_path / "fake_small.json").read_text())
    assert list(ensemble["members"]) == ["fake_small_0.safetensors", "fake_small_1.safetensors"]
    told = ensemble["modes"]["online"]
    assert len(told["outputs"]["overall"]) == 2 and 0.5 < told["test"]["interval90"]["share"] <= 1.0
    assert told["parameters"] == [None, None]  # fewer scores than an interval needs


def test_members_of_other_data_and_leaking_ones_are_left_out(data: Data, tmp_path: Path) -> None:
    trained(data, tmp_path, 0)
    for change in ({"data": {"sha256": "other"}}, {"leakage": 0.2}):
        card = tmp_path / "fake_small_0.json"
        document: dict[str, Any] = json.loads(card.read_text())
        card.write_text(json.dumps(document | change))
        assert assemble(data, tmp_path, "fake_small") is None
        card.write_text(json.dumps(document))
    assert assemble(data, tmp_path, "fake_small") is not None


def test_what_is_left_out_is_gone_and_the_rest_is_not() -> None:
    features = features_of()
    config, plan = binding.config_for("small", features.network, features.table, features.deviations), Plan()
    rng = np.random.default_rng(0)
    n = len(features.table)
    base = fake.windows(2)
    some = replace(base, x=rng.normal(size=(2, 1440, n)), m=np.ones((2, 1440, n), dtype=bool),
                   meta=np.ones((2, config.meta)))  # fmt: skip
    data = Data(features.network, features.table, features.deviations, some, some, some, some, {}, "d")
    same = without((), config, plan, data)
    assert same == (config, plan, data)
    one, two, less = without(tuple(PIECES), config, plan, data)
    assert (
        one.strides == (1, 1, 1, 1)
        and not one.gated
        and not one.evidence
        and two.structure == 0.0
        and two.weights.balance == 0.0
    )
    residual = features.table.indices("r")
    assert not less.test.m[..., residual].any() and less.test.m.sum() == 2 * 1440 * (n - len(residual))
    assert less.train.meta[:, : len(features.table.figures)].all() and not less.train.meta[:, -19:].any()
    mask = torch.ones(3, 1440, n, dtype=torch.bool)
    calm = replace(two.hiding, dropped=0.0, burst=0.0)
    assert hide(mask, torch.ones(n, dtype=torch.bool), 120, calm, torch.Generator()).all()
    assert set(PIECES) == set(command_pieces)


def test_without_the_hierarchy_everything_is_at_the_steps_of_the_record_and_still_causal(data: Data) -> None:
    config, _, _ = without(("hierarchy",), fake.config(), Plan(), data)
    torch.manual_seed(0)
    network = HieraUNet(config).eval()
    torch.nn.init.normal_(network.output_head.out.weight)
    w = fake.windows(1)
    told = [torch.from_numpy(a) for a in (w.x, w.m, w.regime, w.clock, w.meta)]
    later = [told[0].clone(), *told[1:]]
    later[0][:, 1400:] += 1.0
    with torch.inference_mode():
        scales = network.encoder(told[0], told[1].float(), told[2].long(), *told[3:], True)
        one, other = (network(*parts, causal=True).delta for parts in (told, later))
    assert [scale.h.shape[1] for scale in scales] == [1440] * 4
    assert torch.equal(one[:, :80], other[:, :80]) and not torch.equal(one[:, 80:], other[:, 80:])


def test_a_folder_without_data_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TwinFileError, match="no training data there"):
        read(tmp_path, features_of())


def test_what_cannot_run_is_refused_in_plain_words(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(HieraError, match="no device 'tpu'"):
        ready("tpu")
    if not torch.cuda.is_available():
        with pytest.raises(HieraError, match="no GPU"):
            ready("cuda")
    monkeypatch.setattr("twin.calibrators.hiera_unet.device.NEEDED", ("no_such_package",))
    with pytest.raises(HieraError, match=r"needs no_such_package.*\[ml\]"):
        ready()
    monkeypatch.undo()
    found = CliRunner().invoke(command, ["loop", "--config", "huge"])
    assert found.exit_code == 2 and "small" in found.output


def test_curves_of_a_training_never_hold_what_json_does_not_know(data: Data, tmp_path: Path) -> None:
    data.validation.known[:] = False
    trained(data, tmp_path, 0)
    lines = (tmp_path / "fake_small_0" / "curves.jsonl").read_text().splitlines()
    looked = [json.loads(line, parse_constant=lambda name: pytest.fail(f"{name} is no JSON")) for line in lines]
    assert looked[0]["unseen"]["theta_mae"] == [None, None] and np.isfinite(looked[0]["loss"])
