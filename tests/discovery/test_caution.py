"""Weak effects are claimed where they foretell what no fit saw, and sizes beyond measure where much asks for them."""

from dataclasses import replace

import numpy as np

from tests.discovery.conftest import Bench
from twin.discovery.diagnosis import Fold, SensorError
from twin.discovery.engine import diagnose
from twin.discovery.evidence.commissioned import as_under_another_load

SAME = {"T_tank_C": SensorError(0.06, 0.055, 0.055, 0.05)}
LESS = {"T_tank_C": SensorError(0.09, 0.060, 0.052, 0.05)}


def folds(*gains: float) -> tuple[Fold, ...]:
    return tuple(Fold(0.0, 3600.0, 240, gain) for gain in gains)


def test_a_commissioned_twin_may_leave_more_of_a_rig_that_moves_more(bench: Bench) -> None:
    """In squares beyond the thermometers' own noise: twice that of 0.08 K is well within, three times is not."""
    revision = replace(bench.network.revision, error_after_K={"T_tank_C": float(np.hypot(0.05, 0.08))})
    known = replace(bench.network, revision=revision)

    def left(structure_K: float) -> dict[str, SensorError]:
        before = float(np.hypot(0.05, structure_K))
        return {"T_tank_C": SensorError(before, before, before, 0.05)}

    assert as_under_another_load(known, left(0.16))
    assert not as_under_another_load(known, left(0.24))
    unread = {**left(0.05), "T_heater_C": SensorError(0.5, 0.5, 0.5, 0.05)}
    assert not as_under_another_load(known, unread)  # nothing excuses a thermometer that commissioning did not read
    assert not as_under_another_load(bench.network, left(0.16))  # nothing is known of its commissioning


def test_nothing_is_searched_for_in_a_twin_that_is_as_good_as_when_commissioned(bench: Bench) -> None:
    revision = replace(bench.network.revision, error_after_K={s.name: 1e-3 for s in bench.network.sensors}, number=1)
    network = replace(bench.network, revision=revision)
    heard: list[str] = []
    assert diagnose(network, bench.record(16.0, seed=9), say=heard.append).verdict == "adequate"
    assert "re-tuning" in heard and not [what for what in heard if what.startswith("fitting")]
