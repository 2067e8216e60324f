"""`hil train`: in pieces to a card, a picture and an ensemble; refusals in plain sentences."""

from __future__ import annotations

import json
import os
import shlex
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

torch = pytest.importorskip("torch", reason="torch is not installed: the network calibrator is left out")
pytest.importorskip("safetensors", reason="safetensors is not installed: trained networks cannot be written")

import hil.training  # noqa: E402
from hil.cli.twin_commands.train import PIECES as command_pieces  # noqa: E402
from hil.cli.twin_commands.train import again, anywhere, command, loop_command, wanted  # noqa: E402
from hil.fleet.kinds import GivenJob, perform_job, subcommand  # noqa: E402
from hil.fleet.kinds.job_folder import JobFolder  # noqa: E402
from hil.training import generate, session  # noqa: E402
from hil.training.ablation import PIECES, without  # noqa: E402
from hil.training.data import TrainingData, least_windows, read  # noqa: E402
from hil.training.ensemble import assemble  # noqa: E402
from hil.training.generate import features_of  # noqa: E402
from hil.training.stopping import Stop  # noqa: E402
from tests.twin.hiera import fake  # noqa: E402
from twin.calibrators.hiera_unet.model.config import HieraError  # noqa: E402
from twin.calibrators.hiera_unet.model.network import HieraUNet  # noqa: E402
from twin.calibrators.hiera_unet.training.hiding import hide  # noqa: E402
from twin.calibrators.hiera_unet.training.plan import TrainingPlan  # noqa: E402
from twin.calibrators.hiera_unet.training.train import Physics  # noqa: E402
from twin.calibrators.hiera_unet.weights import binding  # noqa: E402
from twin.calibrators.hiera_unet.weights.checkpoint import Identity, load  # noqa: E402
from twin.calibrators.hiera_unet.weights.device import ready  # noqa: E402
from twin.network import TwinFileError  # noqa: E402

IDENTITY = Identity("t", "c", ("a", "b"), ("T_a_C", "T_b_C"))


@pytest.fixture
def data(monkeypatch: pytest.MonkeyPatch) -> TrainingData:
    """Fake windows, and a binding to their fake twin."""
    monkeypatch.setattr(binding, "config_for", lambda *_: fake.config())
    monkeypatch.setattr(binding, "physics_of", lambda *_: Physics(fake.simulate, fake.TOLD))
    monkeypatch.setattr(binding, "identity_of", lambda *_: IDENTITY)
    monkeypatch.setattr(session, "LOOK_EVERY", 2)
    table = type("Table", (), {"name": "fake"})()
    parts = [fake.windows(n, seed) for seed, n in enumerate((12, 6, 30, 6))]
    return TrainingData(None, table, None, *parts, manifest={"seed": 0}, digest="d")  # type: ignore[arg-type]


def trained(
    data: TrainingData,
    folder: Path,
    seed: int,
    minutes: float | None = None,
    say: Callable[[int, Stop], None] | None = None,
) -> session.TrainingProgress:
    stop = Stop(minutes)
    plan = TrainingPlan(steps=4, batch=5, pairs=1, seed=seed)
    state, weights = folder / f"fake_small_{seed}", folder / f"fake_small_{seed}.safetensors"
    request = session.TrainingRequest("small", plan, state, weights, "hil train")
    return session.train(data, request, stop=stop, say=lambda done, _: None if say is None else say(done, stop))


def test_a_training_in_pieces_ends_with_card_picture_and_ensemble(data: TrainingData, tmp_path: Path) -> None:
    cut = trained(data, tmp_path, 0, minutes=0.0)
    assert (cut.done, cut.card) == (0, None)
    assert session.begun(tmp_path / "fake_small_0") == 0
    done = trained(data, tmp_path, 0)
    assert done.done == 4 and done.card is not None and done.picture is not None and done.picture.stat().st_size > 1000
    card = json.loads(done.card.read_text(), parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    assert [c["step"] for c in card["curves"]] == [2, 4] and card["data"] == {"seed": 0, "sha256": "d"}
    assert {"hil", "torch", "numpy"} == card["versions"].keys()
    assert card["command"] == "hil train" and card["seed"] == 0 and len(card["metrics"]["blind"]["mae"]) == 2
    load(tmp_path / "fake_small_0.safetensors", IDENTITY, fake.config())
    assert any("held-out windows" in line for line in done.lines)
    trained(data, tmp_path, 1)
    ensemble = json.loads((tmp_path / "fake_small.json").read_text())
    assert list(ensemble["members"]) == ["fake_small_0.safetensors", "fake_small_1.safetensors"]
    told = ensemble["modes"]["online"]
    assert len(told["outputs"]["overall"]) == 2 and 0.5 < told["test"]["interval90"]["share"] <= 1.0
    assert told["parameters"]["overall"][0] > 0.0 and told["test"]["parameter_interval90"]["all"]["windows"] > 0
    rivals = ensemble["rivals"]
    assert {"commissioned", "Gauss-Newton, shrunk", "network", "channels noise"} <= rivals.keys()
    assert all(r["outputs"] > 0.0 and r["parameters"] >= 0.0 for r in rivals.values())


def test_an_interrupt_in_the_first_step_keeps_that_step(data: TrainingData, tmp_path: Path) -> None:
    def interrupt(done: int, stop: Stop) -> None:
        with stop:
            os.kill(os.getpid(), signal.SIGINT)

    cut = trained(data, tmp_path, 0, say=interrupt)
    assert (cut.done, cut.made, cut.card) == (1, 1, None)
    trained(data, tmp_path, 0, say=lambda done, stop: interrupt(done, stop) if done == 3 else None)
    # Curves were told after two steps; what goes on, and its pace, is what was kept.
    assert session.begun(tmp_path / "fake_small_0") == 3
    at_once = trained(data, tmp_path / "other", 0)
    assert trained(data, tmp_path, 0).lines == at_once.lines


def test_a_second_interrupt_ends_at_once() -> None:
    # Whatever handler other tests of this process have left, and in this thread, whichever others there are.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with Stop() as stop:
            assert not stop.over
            signal.raise_signal(signal.SIGINT)
            assert stop.over and stop.interrupted
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)


def typed(*words: object) -> Result:
    return CliRunner().invoke(command, ["loop", *map(str, words)])


def test_too_few_windows_are_refused_before_any_is_simulated(tmp_path: Path) -> None:
    there = tmp_path / "there"
    for words in (("--windows", 240), ()):
        found = typed("--data", there, "--out", tmp_path / "out", *words)
        assert found.exit_code == 2 and f"give --windows {least_windows()} or more" in " ".join(found.output.split())
        there.mkdir(exist_ok=True)
        (there / "manifest.json").write_text('{"seed": 1, "count": 240}')  # what an earlier version simulated
    assert not (tmp_path / "out").exists() and [p.name for p in there.iterdir()] == ["manifest.json"]


def test_minutes_are_of_simulating_too_and_the_command_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    words = ("--data", tmp_path / "data", "--out", tmp_path, "--minutes", 0, "--windows", 500, "--data-seed", 7)
    found = typed(*words)
    assert found.exit_code == 0 and "0% simulated: give the same command again" in found.output
    assert generate.asked_of(tmp_path / "data") == (7, 500) and wanted(tmp_path / "data", None, None) == (7, 500)
    assert json.loads(typed(*words, "--json").stdout)["simulated"] == 0.0
    refused = typed("--data", tmp_path / "data", "--data-seed", 8)
    assert "holds windows of data seed 7, not 8" in str(refused.exception)


def test_a_training_is_a_job_of_a_fleet_with_weights_card_and_picture(
    data: TrainingData, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command of the job, with fake windows and in this process; one of its own is tested with a benchmark."""
    for name, fake_one in (("complete", lambda *_: True), ("features_of", lambda: None), ("read", lambda *_: data)):
        monkeypatch.setattr(hil.training, name, fake_one, raising=False)

    def here(folder: JobFolder, words: list[str], say: Callable[[str], None]) -> dict[str, Any]:
        folder.out.mkdir()
        monkeypatch.chdir(folder.path)
        done = CliRunner().invoke(command, words[1:])
        assert done.exit_code == 0, done.output
        found: dict[str, Any] = json.loads(done.stdout)
        return found

    monkeypatch.setattr(subcommand, "_run", here)
    arguments = ("--windows", str(least_windows()), "--steps", "2", "--threads", "1")
    made = perform_job(GivenJob("train", 0, {"arguments": arguments}, {}, {}, {}), lambda _: None)
    monkeypatch.chdir(Path(__file__).parent)  # the job's folder is gone
    assert made.row["steps"] == 2 and made.row["training_s"] > 0.0 and "held-out windows" in made.answer
    assert {"loop_small_0.safetensors", "loop_small_0.json", "loop_small_0.png"} <= made.files.keys()


def test_the_command_of_a_card_simulates_and_trains_the_same_again(tmp_path: Path) -> None:
    plan = TrainingPlan(steps=2500, batch=9, seed=3)
    line = again("full", plan, "cpu", 1, ("gates",), anywhere(tmp_path / "my data"), 1, 8000)
    assert str(tmp_path) not in line and anywhere(Path("training/loop")) == "training/loop"
    words = shlex.split(line)
    given = loop_command.make_context("loop", words[3:]).params
    assert words[:3] == ["hil", "train", "loop"] and given["data"] == Path("my data")
    assert (given["name"], given["seed"], given["count"], given["data_seed"]) == ("full", 3, 8000, 1)
    assert (given["steps"], given["batch"], given["half"], given["threads"]) == (2500, 9, False, 1)
    assert (given["device"], given["without"]) == ("cpu", ("gates",))
    for card in (generate.TWIN.parents[1] / "trained").glob("loop_small_?.json"):
        document = json.loads(card.read_text())
        given = loop_command.make_context("loop", shlex.split(document["command"])[3:]).params
        assert (given["count"], given["data_seed"]) == (document["data"]["count"], document["data"]["seed"])
        assert (given["seed"], given["steps"]) == (document["seed"], document["plan"]["steps"])


def test_members_of_other_data_and_leaking_ones_are_left_out(data: TrainingData, tmp_path: Path) -> None:
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
    config, plan = binding.config_for("small", features.network, features.table, features.deviations), TrainingPlan()
    rng = np.random.default_rng(0)
    n = len(features.table)
    base = fake.windows(2)
    some = replace(
        base, x=rng.normal(size=(2, 1440, n)), m=np.ones((2, 1440, n), dtype=bool), meta=np.ones((2, config.meta))
    )
    data = TrainingData(features.network, features.table, features.deviations, some, some, some, some, {}, "d")
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


def test_without_the_hierarchy_everything_is_at_the_steps_of_the_record_and_still_causal(data: TrainingData) -> None:
    config, _, _ = without(("hierarchy",), fake.config(), TrainingPlan(), data)
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
    monkeypatch.setattr("twin.calibrators.hiera_unet.weights.device.NEEDED", ("no_such_package",))
    with pytest.raises(HieraError, match=r"needs no_such_package.*\[ml\]"):
        ready()
    monkeypatch.undo()
    found = CliRunner().invoke(command, ["loop", "--config", "huge"])
    assert found.exit_code == 2 and "small" in found.output


def test_curves_of_a_training_never_hold_what_json_does_not_know(data: TrainingData, tmp_path: Path) -> None:
    data.validation.known[:] = False
    trained(data, tmp_path, 0)
    lines = (tmp_path / "fake_small_0" / "curves.jsonl").read_text().splitlines()
    looked = [json.loads(line, parse_constant=lambda name: pytest.fail(f"{name} is no JSON")) for line in lines]
    assert looked[0]["unseen"]["theta_mae"] == [None, None] and np.isfinite(looked[0]["loss"])
