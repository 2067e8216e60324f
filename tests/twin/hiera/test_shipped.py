"""The network that is shipped: it loads, it is small, its card says what it is and where it stands."""

from __future__ import annotations

import json
import re
from dataclasses import FrozenInstanceError
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed: the network calibrator is left out")
pytest.importorskip("safetensors", reason="safetensors is not installed: trained networks cannot be read")

from twin.calibrators import make_calibrator  # noqa: E402
from twin.calibrators.hiera_unet.data.channels import table  # noqa: E402
from twin.calibrators.hiera_unet.data.parameters import Deviations  # noqa: E402
from twin.calibrators.hiera_unet.model.config import Config, HieraError  # noqa: E402
from twin.calibrators.hiera_unet.serve.service import TRAINED, HieraUNetCalibrator  # noqa: E402
from twin.calibrators.hiera_unet.tower.member import load_member  # noqa: E402
from twin.calibrators.hiera_unet.weights.binding import subject_of  # noqa: E402
from twin.twinfile import load  # noqa: E402

PROFILES = Path(__file__).resolve().parents[3] / "profiles"
CARD = TRAINED / "loop_small.json"
TOWER = sorted(TRAINED.glob("tower_small_*.json"))
MOST_MB = 10.0


@pytest.mark.skipif(not CARD.exists(), reason="no trained network is shipped")
def test_the_shipped_ensemble_fits_the_shipped_twins_and_says_where_it_comes_from() -> None:
    for name in ("loop.toml", "virtual.toml"):
        found = make_calibrator("hiera_unet", load(PROFILES / "twins" / name))
        assert isinstance(found, HieraUNetCalibrator) and found.ensemble.members
    document = json.loads(CARD.read_text())
    for member in document["members"]:
        card = json.loads((TRAINED / member).with_suffix(".json").read_text())
        assert {"seed", "command", "plan", "data", "metrics", "curves", "leakage"} <= card.keys()
        assert card["data"]["sha256"] == document["data"]
        before, after = (card["metrics"]["blind"][key] for key in ("mae_before", "mae"))
        assert all(a < b for a, b in zip(after, before, strict=True))
    assert sum(p.stat().st_size for p in TRAINED.glob("loop_*")) < MOST_MB * 1e6
    assert not re.search(r"/(tmp|home|root)/", "".join(p.read_text() for p in TRAINED.glob("*.json")))


@pytest.mark.skipif(not CARD.exists(), reason="no trained network is shipped")
def test_the_loop_is_a_subject_whose_configuration_is_that_of_its_shipped_weights() -> None:
    network = load(PROFILES / "twins" / "loop.toml")
    channels, deviations = table(network), Deviations.of(network, "nine")
    subject = subject_of(network, channels, deviations)
    assert (subject.name, subject.step_s, subject.context) == ("loop", 5.0, 1440)
    assert [one.name for one in subject.deviations] == list(deviations.ids)
    for name in json.loads(CARD.read_text())["members"]:
        card = json.loads((TRAINED / name).with_suffix(".json").read_text())
        assert subject.config("small") == Config.of(card["config"])
    assert np.flatnonzero(subject.told).tolist() == channels.indices("y", "r").tolist()
    with pytest.raises(FrozenInstanceError):
        subject.step_s = 60.0  # type: ignore[misc]


def test_a_twin_without_a_trained_network_is_refused_with_the_reason() -> None:
    if CARD.exists():
        with pytest.raises(HieraError, match=r"trained for a twin of another structure|no trained network"):
            make_calibrator("hiera_unet", load(PROFILES / "twins" / "loop_six.toml"))
    else:
        with pytest.raises(HieraError, match=r"no trained network .* train one with `hil train loop`"):
            make_calibrator("hiera_unet", load(PROFILES / "twins" / "loop.toml"))


@pytest.mark.parametrize("card", TOWER, ids=lambda path: path.stem)
def test_a_shipped_member_of_the_tower_loads_only_if_its_gate_passed_it(card: Path) -> None:
    document = json.loads(card.read_text())
    weights = card.with_suffix(".safetensors")
    assert {"seed", "plan", "steps_done", "device", "data", "curves", "gate", "command"} <= document.keys()
    parameters, outputs = (
        mean >= document["gate"]["least"] and low > 0.0
        for mean, low, _ in (document["gate"][key] for key in ("parameters_worse", "outputs_worse"))
    )
    assert document["gate"]["heads"]["outputs"] == ("none" if outputs else "BLIND")
    assert bool(document["refused"]) != parameters
    if parameters:
        assert load_member(weights).network.count() == document["weights"]["count"]
    else:
        with pytest.raises(HieraError, match="BLIND"):
            load_member(weights)
    assert weights.stat().st_size < MOST_MB * 1e6
