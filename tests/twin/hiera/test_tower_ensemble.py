"""Ensembles for cooling-tower cells: cards, interval factors, answers, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed: the network calibrator is left out")
pytest.importorskip("safetensors", reason="safetensors is not installed: trained networks cannot be read")

from tests.hil.tower.made_ensemble import write_ensemble  # noqa: E402
from tests.twin.hiera.tower_tables import made_table  # noqa: E402
from twin.calibrators.hiera_unet.model.config import HieraError  # noqa: E402
from twin.calibrators.hiera_unet.serve.service import TRAINED  # noqa: E402
from twin.calibrators.hiera_unet.tower import CAUSAL, SYMMETRIC, Fleet, load_tower_ensemble  # noqa: E402
from twin.calibrators.hiera_unet.tower.ensemble import card_of, factors_of, judged_again, passed  # noqa: E402
from twin.calibrators.hiera_unet.tower.predict import judged  # noqa: E402
from twin.calibrators.hiera_unet.tower.score import targets_of  # noqa: E402


@pytest.fixture(scope="module")
def card(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Card of an ensemble of two untrained members."""
    return write_ensemble(tmp_path_factory.mktemp("ensemble"), count=2)


def changed(card: Path, tmp_path: Path, **values: Any) -> Path:
    """Return a copy of an ensemble whose card has other values."""
    for path in card.parent.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    copy = tmp_path / card.name
    copy.write_text(json.dumps({**json.loads(card.read_text()), **values}))
    return copy


def test_an_ensemble_answers_with_intervals_by_the_factors_of_its_branch(card: Path, tmp_path: Path) -> None:
    fleet = Fleet([made_table()])
    narrow = {"theta": [1.0, 1.0, 1.0, 3.0], "water": 0.5}
    wide = {"theta": [2.0, 1.0, 1.0, 3.0], "water": 1.0}
    ensemble = load_tower_ensemble(changed(card, tmp_path, branches={CAUSAL: narrow, SYMMETRIC: wide}))
    causal, symmetric = (ensemble.ask(fleet, fleet.rows[:3], branch) for branch in (CAUSAL, SYMMETRIC))
    assert causal.found.theta_half is not None and symmetric.found.theta_half is not None
    assert causal.found.water_half is not None and symmetric.found.water_half is not None
    np.testing.assert_allclose(symmetric.found.theta_half[:, 0], 2.0 * causal.found.theta_half[:, 0], rtol=0.05)
    np.testing.assert_allclose(symmetric.found.water_half, 2.0 * causal.found.water_half, rtol=0.05)
    assert causal.attention.shape == (3, 4, 12) and (causal.distance >= 0.0).all()


def test_a_causal_answer_knows_nothing_after_its_window(card: Path) -> None:
    table = made_table()
    ensemble = load_tower_ensemble(card)
    fleet, cut = Fleet([table]), Fleet([made_table()])
    rows = fleet.rows[:1]
    end = int(table.start[0]) + 120
    for name in ("x", "reading", "outlet"):
        cut.arrays[name][end:] = 0.0
    a, b = (ensemble.ask(one, rows, CAUSAL).found for one in (fleet, cut))
    np.testing.assert_array_equal(a.theta, b.theta)
    np.testing.assert_array_equal(a.water, b.water)


def test_factors_make_nine_of_ten_windows_lie_inside(card: Path) -> None:
    fleet = Fleet([made_table()])
    ensemble = load_tower_ensemble(card)
    factors = factors_of(ensemble.members, fleet, fleet.rows)
    found = card_of("made", {}, factors, {"b.safetensors": "BLIND"}, {"windows": 3})
    assert found["left_out"] == {"b.safetensors": "BLIND"} and found["windows"] == 3
    for branch in (CAUSAL, SYMMETRIC):
        assert len(found["branches"][branch]["theta"]) == 4 and found["branches"][branch]["water"] > 0.0
    # The belief of a made cell is off by 0.1 K of bias with a standard deviation of 0.08 K.
    assert factors[CAUSAL].theta[3] == pytest.approx(0.1 / 0.08, rel=0.1)


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"subject": "loop"}, "^OTHER_SUBJECT: "),
        ({"format": 7}, "^OTHER_FORMAT: .* format 7, not"),
        ({"table": "another"}, "^OTHER_TABLE: .* another channel table"),
        ({"members": {"a.safetensors": "0", "b.safetensors": "0"}}, r"^MISSING_MEMBER: .* names a\.safetensors"),
        ({"members": {"tower_made_0.safetensors": "0", "tower_made_1.safetensors": "0"}}, "^OTHER_MEMBER: "),
        ({"members": {"../a.safetensors": "0", "b.safetensors": "0"}}, "does not lie beside it"),
        ({"members": {"a.safetensors": "0"}}, "names 1 member, and an ensemble has at least 2"),
        ({"branches": {CAUSAL: {"theta": [1.0], "water": 1.0}}}, "lacks members or factors"),
        (
            {"branches": {b: {"theta": [1.0, 1.0, -1.0, 1.0], "water": 1.0} for b in (CAUSAL, SYMMETRIC)}},
            "no positive factor",
        ),
    ],
)
def test_a_card_of_something_else_is_refused(card: Path, tmp_path: Path, values: dict[str, Any], says: str) -> None:
    with pytest.raises(HieraError, match=says):
        load_tower_ensemble(changed(card, tmp_path, **values))


def test_a_single_member_an_unreadable_card_and_none_are_refused(card: Path, tmp_path: Path) -> None:
    with pytest.raises(HieraError, match=r"^SINGLE_MEMBER: .* give that of an ensemble"):
        load_tower_ensemble(card.with_name("tower_made_0.json"))
    (tmp_path / "card.json").write_text("{")
    with pytest.raises(HieraError, match=r"card\.json is no card of an ensemble"):
        load_tower_ensemble(tmp_path / "card.json")
    with pytest.raises(HieraError, match=r"^MISSING_MEMBER: there is no card"):
        load_tower_ensemble(tmp_path / "none.json")


def test_members_that_the_gate_passed_make_the_ensemble_and_all_do_where_fewer_than_two_passed() -> None:
    assert passed({"a": "", "b": "BLIND", "c": ""}) == (["a", "c"], {"b": "BLIND"})
    assert passed({"a": "", "b": "BLIND"}) == (["a", "b"], {})


def test_a_member_with_blind_outputs_serves_the_outlet_that_it_starts_at_and_says_so(tmp_path: Path) -> None:
    fleet = Fleet([made_table()])
    start = targets_of(fleet, fleet.rows).water
    seen = load_tower_ensemble(write_ensemble(tmp_path / "seen", biased=1.0))
    assert np.abs(seen.ask(fleet, fleet.rows).found.water - start).max() > 0.01 and not seen.outlet
    blind = load_tower_ensemble(write_ensemble(tmp_path / "blind", blind_outputs=(0, 1), biased=1.0))
    for branch in (CAUSAL, SYMMETRIC):
        np.testing.assert_allclose(blind.ask(fleet, fleet.rows, branch).found.water, start, atol=1e-4)
    assert not blind.blind
    assert blind.outlet == "the outlet is that of the start (Gauss-Newton); only the parameters are the network's"
    member = json.loads((tmp_path / "blind" / "tower_made_0.json").read_text())
    assert member["outlet"] == blind.outlet and member["refused"] == ""
    assert member["gate"]["heads"] == {"parameters": "none", "outputs": "BLIND"}
    one = load_tower_ensemble(write_ensemble(tmp_path / "one", blind_outputs=(1,), biased=1.0))
    assert one.outlet.startswith("the outlet of tower_made_1.safetensors is that of the start (Gauss-Newton); only its")


def test_a_card_of_one_code_for_both_heads_reads_as_before(tmp_path: Path) -> None:
    card = write_ensemble(tmp_path, blind_outputs=(1,), biased=1.0)
    member = tmp_path / "tower_made_1.json"
    document = json.loads(member.read_text())
    del document["gate"]["heads"], document["outlet"]
    member.write_text(json.dumps(document))
    old = load_tower_ensemble(card)
    assert not old.outlet and not old.members[1].network.start_outlet
    member.write_text(json.dumps(document | {"refused": "BLIND"}))
    with pytest.raises(HieraError, match=r"^BLIND: "):
        load_tower_ensemble(card)
    assert load_tower_ensemble(card, blind_too=True).blind == ("tower_made_1.safetensors",)


def test_an_ensemble_judged_again_needs_factors_of_the_members_that_pass() -> None:
    sure, none, config = [0.2, 0.1, 0.3], [0.0, 0.0, 0.0], {"trees": [5, 200, 61]}
    gates = {"a": (sure, none), "b": (sure, none), "c": (none, sure)}
    cards = {
        name: judged(
            {"config": config, "gate": {"parameters_worse": p, "outputs_worse": o, "windows": 9}, "refused": "BLIND"}
        )
        for name, (p, o) in gates.items()
    }
    assert {n: one["refused"] for n, one in cards.items()} == {"a": "", "b": "", "c": "BLIND"}
    found = judged_again({"name": "made", "members": {"a": "0", "b": "0"}, "left_out": {"c": "BLIND"}}, cards)
    assert found["outlet"].startswith("the outlet is that of the start (boosted trees on Gauss-Newton)")
    with pytest.raises(HieraError, match=r"the factors of made are of a, b, c, and the gate passes a, b; write it"):
        judged_again({"name": "made", "members": {"a": "0", "b": "0", "c": "0"}}, cards)
    with pytest.raises(HieraError, match="names members whose cards are missing"):
        judged_again({"name": "made", "members": {"a": "0", "d": "0"}}, cards)


@pytest.mark.skipif(not (TRAINED / "tower_small.json").exists(), reason="no trained ensemble is shipped")
def test_the_shipped_ensemble_holds_four_members_whose_outlet_is_that_of_boosted_trees() -> None:
    ensemble = load_tower_ensemble(TRAINED / "tower_small.json")
    assert len(ensemble.members) == 4 and not ensemble.blind
    assert all(one.network.start_outlet and one.network.trees is not None for one in ensemble.members)
    document = json.loads((TRAINED / "tower_small.json").read_text())
    assert document["outlet"] == ensemble.outlet != "" and not document["left_out"]
    with pytest.raises(HieraError, match=r"^OTHER_SUBJECT: "):
        load_tower_ensemble(TRAINED / "loop_small.json")
