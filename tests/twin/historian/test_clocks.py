"""Clocks of interfaces: a wrong one is corrected, and none that goes with it is moved along."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twin.historian.defects.clocks import shifted_clocks
from twin.historian.defects.silence import Group
from twin.historian.tags import Array, Series, Tag

START_S, STEP_S = 1.65e9, 300.0
ZONE = "America/Chicago"
"""Five hours behind UTC in the span of these records."""


def _wander(rng: np.random.Generator, n: int) -> Array:
    return np.convolve(rng.standard_normal(n + 11), np.ones(12) / 3.5, "valid")


def _station(rng: np.random.Generator, days: float = 12.0) -> dict[str, list[Series]]:
    """Return a station whose weather drives its fans far more than its water."""
    n = int(days * 86400.0 / STEP_S)
    weather, load = _wander(rng, n), _wander(rng, n)
    fan = 0.9 * weather + 0.5 * load
    water = [load + 0.3 * fan + 0.1 * weather] * 4
    drives = {"met": [weather] * 4, "mcc": [fan] * 4, "plc1": water, "plc2": water}
    return {
        where: [
            Series(
                Tag(f"{where}{k}", "%", "other", None, STEP_S),
                START_S + STEP_S * np.arange(n),
                drive + 0.25 * _wander(rng, n),
                np.full(n, 192, dtype=np.int16),
            )
            for k, drive in enumerate(signals)
        ]
        for where, signals in drives.items()
    }


def _found(station: dict[str, list[Series]]) -> list[tuple[str, str]]:
    groups = [Group(tuple(one.tag.name for one in members)) for members in station.values()]
    found = shifted_clocks([one for members in station.values() for one in members], groups, ZONE)
    return [(defect.kind, defect.tags[0][:3]) for defect, _ in found]


def _moved(members: list[Series], hours: float) -> list[Series]:
    return [replace(one, time_s=one.time_s + 3600.0 * hours) for one in members]


@pytest.mark.parametrize("seed", range(4))
def test_a_right_clock_that_goes_with_a_wrong_one_stays(seed: int) -> None:
    station = _station(np.random.default_rng(seed))
    assert _found(station) == []
    station["mcc"] = _moved(station["mcc"], -5.0)
    assert _found(station) == [("local_time", "mcc")]


def test_two_wrong_clocks_are_both_corrected() -> None:
    station = _station(np.random.default_rng(5))
    station["mcc"], station["plc2"] = _moved(station["mcc"], -5.0), _moved(station["plc2"], 2.0)
    assert sorted(_found(station)) == [("clock_offset", "plc"), ("local_time", "mcc")]
