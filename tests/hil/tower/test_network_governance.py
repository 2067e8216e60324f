"""Gates of a network's proposals: those on the record are Gauss-Newton's, interval and envelope are its own."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hil.tower.governance.gates import Verdict
from hil.tower.governance.network_service import NetworkGovernance, network_governance
from hil.tower.network import NetworkAnswers, StationAnswers
from tests.hil.tower.test_governance import window

WINDOWS = 4
MINUTES = 120 * WINDOWS


def governed(
    verdicts: dict[int, Verdict] | None = None,
    half: float = 0.3,
    distance: float = 0.5,
    answered: tuple[int, ...] = (1, 2, 3),
    blind: tuple[str, ...] = (),
) -> NetworkGovernance:
    """Return the verdicts on answers to windows of a cell, whose fill falls by a percent from one to the next."""
    time_s = 60.0 * np.arange(MINUTES)
    rows = np.isin(np.arange(MINUTES) // 120, answered)
    deviations = np.where(rows, -0.01 * (np.arange(MINUTES) // 120), np.nan)
    answers = NetworkAnswers(
        np.where(rows, 28.0, np.nan),
        np.where(rows, half, np.nan),
        np.stack([deviations] * 4, axis=1),
        np.where(rows[:, None], np.full(4, 0.03), np.nan),
        7200.0 * np.array(answered, dtype=float),
        np.full(len(answered), distance),
        np.full((len(answered), 4, 12), 1.0 / 12.0),
    )
    result: Any = SimpleNamespace(cell=1, minutes=SimpleNamespace(time_s=time_s))
    asked = StationAnswers("made", "0" * 64, 2, blind, "shadow", {1: answers}, {1: answers})
    windows = [replace(w, told=replace(w.told, combined={"fill": 1.0})) for w in map(window, range(WINDOWS))]
    return network_governance(result, windows, [(verdicts or {}).get(k, Verdict(())) for k in range(WINDOWS)], asked)


def test_a_window_without_an_answer_is_held_back_and_the_last_answer_is_the_proposal() -> None:
    found = governed(answered=(1, 2))
    assert [v.codes for v in found.verdicts] == [("NO_WINDOW",), (), (), ("NO_WINDOW",)]
    assert found.last == 2
    name, value, sd = found.proposals(2)[0]
    assert name == "fill" and value == pytest.approx(0.98) and sd == pytest.approx(0.03 / 1.6449)
    (entry, *_) = found.queue("advisory")
    assert entry["accepted"] and entry["calibrator"] == "hiera_unet" and entry["state"] == "advisory"
    assert governed(answered=()).queue("advisory") == []


def test_gates_on_the_record_hold_for_the_network_and_those_on_the_rival_s_interval_do_not() -> None:
    verdicts = {
        1: Verdict(("MISSING_REQUIRED",)),
        2: Verdict(("HIGH_UNCERTAINTY", "OUT_OF_ENVELOPE")),
        3: Verdict((), {"fill": ("LOW_SENSITIVITY:fill",)}),
    }
    found = governed(verdicts)
    assert [v.codes for v in found.verdicts[1:]] == [("MISSING_REQUIRED",), (), ()]
    assert not found.verdicts[3].accepts("fill") and found.verdicts[3].accepts("air")
    assert found.withheld == {"fill": 2 / 3, "air": 1 / 3, "uniformity": 1 / 3, "bias": 1 / 3}


@pytest.mark.parametrize(
    ("change", "code"),
    [({"half": 0.9}, "HIGH_UNCERTAINTY"), ({"distance": 1.2}, "OUT_OF_ENVELOPE"), ({"blind": ("a",)}, "BLIND")],
)
def test_the_network_s_own_gates_hold_back_with_their_code(change: dict[str, Any], code: str) -> None:
    assert all(code in v.codes for v in governed(**change).verdicts[1:])
    assert not any(v.codes for v in governed().verdicts[1:])
