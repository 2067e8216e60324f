"""One proposal alone moves nothing, and a record of which they contradict one another is refused."""

from __future__ import annotations

import json
from collections.abc import Iterable

import numpy as np
import pytest

from twin.calibrators.hiera_unet.agreement import TURNS, Spoken, doubts, lately

IDS = ("power", "loss")


def spoken(cycle: int, power: float, loss: float = 0.0, *, closed: Iterable[int] = (), half: float = 0.1) -> Spoken:
    allowed = np.array([k not in closed for k in range(2)])
    return Spoken(300.0 * cycle, np.array([power, loss]), np.full(2, half), allowed)


@pytest.mark.parametrize(
    ("before", "codes"),
    [
        ([], {"power": "UNCONFIRMED", "loss": "UNCONFIRMED"}),
        ([spoken(9, 1.1)], {}),
        ([spoken(9, 1.1, closed=[1])], {"loss": "UNCONFIRMED"}),
        ([spoken(8, 1.1)], {"power": "UNCONFIRMED", "loss": "UNCONFIRMED"}),
        ([spoken(9, 0.0)], {"": "CONTRADICTORY_EVENT"}),
        ([spoken(9, 0.0, half=2.0)], {}),
        ([spoken(9, 0.0, closed=[0])], {"power": "UNCONFIRMED"}),
    ],
)
def test_what_the_proposal_before_does_not_bear_out_is_held(before: list[Spoken], codes: dict[str, str]) -> None:
    found = doubts(before, spoken(10, 1.0), IDS)
    assert {r.parameter: r.code for r in found} == codes


def test_what_gates_of_its_own_hold_is_not_asked() -> None:
    assert doubts([], spoken(10, 1.0, closed=[0, 1]), IDS) == ()


@pytest.mark.parametrize(("turns", "refused"), [(TURNS - 1, False), (TURNS, True)])
def test_a_change_there_and_back_is_followed_and_one_to_and_fro_is_not(turns: int, refused: bool) -> None:
    levels = [float(min(k, turns) % 2) for k in range(turns + 2)]
    *before, now = (spoken(k, level) for k, level in enumerate(levels))
    found = doubts(before, now, IDS)
    assert [r.parameter for r in found] == ([""] if refused else [])
    assert not refused or f"power turned round {TURNS} times in two hours" in found[0].sentence
    assert lately(before, before[0].time_s + 7200.0) == tuple(before[1:])


def test_what_was_spoken_is_plain_data() -> None:
    said = spoken(3, 1.0, np.nan, closed=[1])
    again = Spoken.restored(json.loads(json.dumps(said.plain())))
    assert again.time_s == said.time_s and np.array_equal(again.open, said.open)
    assert np.array_equal(again.theta, said.theta, equal_nan=True) and np.array_equal(again.half, said.half)
