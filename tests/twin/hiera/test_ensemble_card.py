"""An ensemble's card: what of a card or of its members is refused, and with which words."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed: the network calibrator is left out")
pytest.importorskip("safetensors", reason="safetensors is not installed: trained networks cannot be read")

from tests.twin.hiera.loop_ensemble import DEVIATIONS, IDENTITY, LOOP, TABLE, ensemble_card, untrained
from twin.calibrators.hiera_unet.model.config import HieraError
from twin.calibrators.hiera_unet.model.network import HieraUNet
from twin.calibrators.hiera_unet.serve.members import load_ensemble
from twin.calibrators.hiera_unet.weights.binding import config_for
from twin.calibrators.hiera_unet.weights.checkpoint import Member, load, save
from twin.calibrators.hiera_unet.weights.envelope import Envelope


def test_an_ensemble_of_something_else_is_refused(tmp_path: Path) -> None:
    with pytest.raises(HieraError, match="no trained network"):
        load_ensemble(tmp_path / "none.json", IDENTITY)
    card = ensemble_card(tmp_path)
    with pytest.raises(HieraError, match="another channel table"):
        load_ensemble(card, replace(IDENTITY, table="other"))
    save(untrained(7), tmp_path / "loop_small_0.safetensors")
    with pytest.raises(HieraError, match="not the one that"):
        load_ensemble(card, IDENTITY)
    with pytest.raises(HieraError, match="hang on a record's last moments"):
        load_ensemble(ensemble_card(tmp_path, leakage=0.2), IDENTITY)


def changed(card: Path, **other: Any) -> Path:
    """A card of the same members with something else on it."""
    document = json.loads(card.read_text())
    own = card.with_name("changed.json")
    own.write_text(json.dumps(document | other))
    return own


@pytest.mark.parametrize(
    ("outputs", "parameters", "words"),
    [
        ({"overall": [2.0]}, None, r"factors 2.0 for outputs, not a positive one for each of T_heater"),
        ({"overall": [2.0, 2.0, 2.0, float("nan")]}, None, r"nan for outputs, not a positive one"),
        ({"overall": ["a"] * 4}, None, "cannot be read"),
        ({"binned": {"7": [2.0, 2.0]}}, None, r"factors 2.0, 2.0 for outputs in bin 7"),
        ({}, {"overall": [1.0, 2.0]}, r"factors 1.0, 2.0 for parameters, not a positive one for all parameters"),
        ({}, {"overall": [1.0], "binned": {"3": [-1.0]}}, r"factors -1.0 for parameters in bin 3, not a positive one"),
        ({}, [None] * 9, "cannot be read"),
    ],
)
def test_a_card_has_a_factor_for_each_output_and_one_for_parameters(
    tmp_path: Path, outputs: dict[str, Any], parameters: Any, words: str
) -> None:
    card = ensemble_card(tmp_path)
    usual = json.loads(card.read_text())["modes"]["online"]["outputs"]
    own, parameters = usual | outputs, usual | parameters if isinstance(parameters, dict) else parameters
    with pytest.raises(HieraError, match=words) as caught:
        load_ensemble(changed(card, modes={"online": {"outputs": own, "parameters": parameters}}), IDENTITY)
    assert "changed.json" in str(caught.value) and "hil train loop" in str(caught.value)


def test_a_card_of_another_format_or_of_too_few_or_unlike_members_is_refused(tmp_path: Path) -> None:
    card = ensemble_card(tmp_path)
    with pytest.raises(HieraError, match=r"format 99, not 2; have `hil train loop` write it again"):
        load_ensemble(changed(card, format=99), IDENTITY)
    with pytest.raises(HieraError, match="cannot be read"):
        load_ensemble(changed(card, members=3), IDENTITY)
    members = json.loads(card.read_text())["members"]
    for count, said in ((1, "1 trained member, and"), (0, "0 trained members, and")):
        with pytest.raises(HieraError, match=f"names {said} an ensemble has at least 2; train more"):
            load_ensemble(changed(card, members=dict(list(members.items())[:count])), IDENTITY)
    width = 2 * untrained().network.config.channels
    other = HieraUNet(replace(config_for("small", LOOP, TABLE, DEVIATIONS), name="full"))
    hull = Envelope(np.zeros(width), np.eye(width), 1e6)
    save(Member(other, IDENTITY, hull, {"leakage": 0.0}), tmp_path / "loop_small_1.safetensors")
    sha = load(tmp_path / "loop_small_1.safetensors").card["weights"]["sha256"]
    with pytest.raises(HieraError, match=r"two configurations, 'small' and, in loop_small_1.safetensors, 'full'"):
        load_ensemble(changed(card, members=members | {"loop_small_1.safetensors": sha}), IDENTITY)
