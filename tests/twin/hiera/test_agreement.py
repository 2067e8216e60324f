"""One proposal alone moves nothing, and a record of which they contradict one another is refused."""

from __future__ import annotations

import json
from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.calibrators.hiera_unet.serve.agreement import TURNS, Spoken, doubts, lately, turns

IDS = ("power", "loss")
LIVE = np.zeros(2)


def spoken(cycle: int, power: float, loss: float = 0.0, *, closed: Iterable[int] = (), half: float = 0.1) -> Spoken:
    allowed = np.array([k not in closed for k in range(2)])
    return Spoken(300.0 * cycle, np.array([power, loss]), np.full(2, half), allowed)


@pytest.mark.parametrize(
    ("before", "codes"),
    [
        ([], {"power": "UNCONFIRMED", "loss": "UNCONFIRMED"}),
        ([spoken(9, 1.1)], {}),
        ([spoken(9, 1.1, closed=[1])], {"loss": "UNCONFIRMED"}),
        ([spoken(6, 1.1)], {"power": "UNCONFIRMED", "loss": "UNCONFIRMED"}),
        ([spoken(9, 0.0)], {"": "CONTRADICTORY_EVENT"}),
        ([spoken(9, 0.0, half=2.0)], {}),
        ([spoken(9, 0.0, closed=[0])], {"power": "UNCONFIRMED"}),
        ([spoken(8, 1.1), spoken(9, 0.0, closed=[0])], {}),
        ([spoken(9, 0.7)], {}),
        ([spoken(9, 1.3)], {}),
        ([spoken(9, -0.5)], {"": "CONTRADICTORY_EVENT"}),
    ],
)
def test_what_the_proposal_before_does_not_bear_out_is_held(before: list[Spoken], codes: dict[str, str]) -> None:
    found = doubts(before, spoken(10, 1.0), LIVE, IDS)
    assert {r.parameter: r.code for r in found} == codes


def test_what_gates_of_its_own_hold_is_not_asked() -> None:
    assert doubts([], spoken(10, 1.0, closed=[0, 1]), LIVE, IDS) == ()


@pytest.mark.parametrize(("turns", "refused"), [(TURNS - 1, False), (TURNS, True)])
def test_a_change_there_and_back_is_followed_and_one_to_and_fro_is_not(turns: int, refused: bool) -> None:
    levels = [float(min(k, turns) % 2) for k in range(turns + 2)]
    *before, now = (spoken(k, level) for k, level in enumerate(levels))
    found = doubts(before, now, now.theta, IDS)
    assert [r.parameter for r in found] == ([""] if refused else [])
    assert not refused or f"power turned round {TURNS} times in two hours" in found[0].sentence
    assert lately(before, before[0].time_s + 7200.0) == tuple(before[1:])


def test_what_was_spoken_is_plain_data() -> None:
    said = spoken(3, 1.0, np.nan, closed=[1])
    again = Spoken.restored(json.loads(json.dumps(said.plain())))
    assert again.time_s == said.time_s and np.array_equal(again.open, said.open)
    assert np.array_equal(again.theta, said.theta, equal_nan=True) and np.array_equal(again.half, said.half)


def followed(levels: np.ndarray, half: float = 0.1) -> np.ndarray:
    """Power of the live twin (n,) after each proposal of it."""
    live, before, found = 0.0, [], []
    for k, level in enumerate(levels.tolist()):
        now = spoken(k, level, half=half)
        held = [r for r in doubts(before, now, np.array([live, 0.0]), IDS) if r.parameter in ("", "power")]
        live = live if held else level
        before = [*lately(before, now.time_s), now]
        found.append(live)
    return np.array(found)


SURE = st.floats(0.01, 0.3)


@settings(max_examples=100, deadline=None)
@given(st.floats(-1.0, 1.0), st.integers(1, 60), SURE, st.integers(0, 1000))
def test_a_drift_is_followed_however_sure_each_proposal_is(far: float, cycles: int, half: float, seed: int) -> None:
    levels = far * np.clip((np.arange(cycles + 12) - 4) / cycles, 0.0, 1.0)
    levels += 0.4 * half * np.random.default_rng(seed).uniform(-1.0, 1.0, levels.size)
    live = followed(levels, half)
    for k in range(2, len(levels)):
        both = [spoken(i, levels[i], half=half).beyond(np.array([live[k], 0.0]))[0] for i in (k - 1, k)]
        assert both not in ([1.0, 1.0], [-1.0, -1.0])
    assert abs(live[-1] - far) <= 1.5 * half
    assert turns([spoken(k, level, half=half) for k, level in enumerate(levels)])[0] <= 1


@settings(max_examples=50, deadline=None)
@given(st.floats(0.3, 1.0), SURE, st.booleans(), st.integers(0, 1000))
def test_a_step_is_taken_on_with_the_second_proposal(size: float, half: float, up: bool, seed: int) -> None:
    size = max(size, 2.5 * half) * (1.0 if up else -1.0)
    levels = np.repeat([0.0, size], [6, 6]) + 0.2 * half * np.random.default_rng(seed).uniform(-1.0, 1.0, 12)
    live = followed(levels, half)
    assert abs(live[6]) <= half and (np.abs(live[7:] - size) <= half).all()


@settings(max_examples=50, deadline=None)
@given(st.floats(-1.0, 1.0), SURE, st.integers(2, 9))
def test_one_proposal_alone_moves_nothing(size: float, half: float, when: int) -> None:
    levels = np.zeros(12)
    levels[when] = size
    assert (np.abs(followed(levels, half)) <= 2.0 * half).all()
