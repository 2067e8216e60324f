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
from twin.calibrators.hiera_unet.config import HieraError  # noqa: E402
from twin.calibrators.hiera_unet.service import TRAINED  # noqa: E402
from twin.calibrators.hiera_unet.tower import CAUSAL, SYMMETRIC, Fleet, load_tower_ensemble  # noqa: E402
from twin.calibrators.hiera_unet.tower.ensemble import card_of, factors_of, passed  # noqa: E402


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


@pytest.mark.skipif(not (TRAINED / "tower_small.json").exists(), reason="no trained ensemble is shipped")
def test_the_shipped_ensemble_holds_the_members_that_passed_and_the_blind_one_alone_is_refused() -> None:
    ensemble = load_tower_ensemble(TRAINED / "tower_small.json")
    assert len(ensemble.members) == 3 and not ensemble.blind
    with pytest.raises(HieraError, match=r"^BLIND: "):
        load_tower_ensemble(TRAINED / "tower_small_3.json")
    with pytest.raises(HieraError, match=r"^OTHER_SUBJECT: "):
        load_tower_ensemble(TRAINED / "loop_small.json")
