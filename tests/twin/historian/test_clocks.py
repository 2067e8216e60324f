"""Clocks of interfaces: a wrong one is corrected, and none that goes with it is moved along."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twin.historian.defects.clocks import ByChange, Shift, corrected, local_by_change, shifted_clocks
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
    return [(defect.kind, defect.tags[0][:3]) for defect, _ in found.found]


def _moved(members: list[Series], hours: float) -> list[Series]:
    return [replace(one, time_s=one.time_s + 3600.0 * hours) for one in members]


@pytest.mark.parametrize("seed", range(2))
def test_a_right_clock_that_goes_with_a_wrong_one_stays(seed: int) -> None:
    station = _station(np.random.default_rng(seed))
    assert _found(station) == []
    station["mcc"] = _moved(station["mcc"], -5.0)
    assert _found(station) == [("local_time", "mcc")]


def test_two_wrong_clocks_are_both_corrected() -> None:
    station = _station(np.random.default_rng(5))
    station["mcc"], station["plc2"] = _moved(station["mcc"], -5.0), _moved(station["plc2"], 2.0)
    assert sorted(_found(station)) == [("clock_offset", "plc"), ("local_time", "mcc")]


@pytest.mark.parametrize("hours", [0.5, -3.5, 9.5])
def test_clocks_of_zones_with_half_hours_are_corrected_by_as_much(hours: float) -> None:
    station = _station(np.random.default_rng(15))
    station["plc2"] = _moved(station["plc2"], hours)
    station["met"][1] = _moved(station["met"][1:2], -hours)[0]
    groups = [Group(tuple(one.tag.name for one in members)) for members in station.values()]
    found = shifted_clocks([one for members in station.values() for one in members], groups, ZONE).found
    by_tag = {name: shift.add_s / 3600.0 for defect, shift in found for name in defect.tags}
    assert by_tag == {**{f"plc2{k}": -hours for k in range(4)}, "met1": hours}


def test_a_tag_that_follows_the_others_by_half_an_hour_has_a_right_clock() -> None:
    """A basin follows its cells with a time constant; its changes are smoothed and no copies of theirs."""
    station = _station(np.random.default_rng(16))
    keep = np.exp(-STEP_S / 1800.0)
    for k in range(2):
        slow = station["plc1"][k].value.copy()
        for i in range(1, len(slow)):
            slow[i] = keep * slow[i - 1] + (1.0 - keep) * slow[i]
        station["plc2"][k] = replace(station["plc2"][k], value=slow)
    assert _found(station) == []


def test_a_single_wrong_clock_within_an_interface_is_corrected_alone() -> None:
    station = _station(np.random.default_rng(6))
    station["met"][1] = _moved(station["met"][1:2], 9.0)[0]
    groups = [Group(tuple(one.tag.name for one in members)) for members in station.values()]
    found = shifted_clocks([one for members in station.values() for one in members], groups, ZONE).found
    assert [(defect.kind, defect.tags, shift.add_s) for defect, shift in found] == [
        ("clock_offset", ("met1",), -9 * 3600.0)
    ]


def test_of_two_tags_that_no_third_confirms_none_is_moved_and_both_are_named() -> None:
    rng = np.random.default_rng(7)
    n = 12 * 288
    shared = _wander(rng, n)
    signals = [shared, shared, *(_wander(rng, n) for _ in range(4))]
    series = [
        Series(
            Tag(f"X{k}", "%", "other", None, STEP_S),
            START_S + STEP_S * np.arange(n) + (6 * 3600.0 if k == 1 else 0.0),
            signal + 0.1 * _wander(rng, n),
            np.full(n, 192, dtype=np.int16),
        )
        for k, signal in enumerate(signals)
    ]
    clocks = shifted_clocks(series, [Group((one.tag.name,)) for one in series], ZONE)
    assert clocks.found == () and len(clocks.remarks) == 1
    assert "X0" in clocks.remarks[0] and "X1" in clocks.remarks[0] and "6 h" in clocks.remarks[0]


def test_a_few_tags_in_utc_show_that_the_many_are_in_local_time() -> None:
    station = _station(np.random.default_rng(8))
    for where in ("mcc", "plc1", "plc2"):
        station[where] = _moved(station[where], -5.0)
    groups = [Group(tuple(one.tag.name for one in members)) for members in station.values()]
    found = shifted_clocks([one for members in station.values() for one in members], groups, ZONE).found
    assert [(defect.kind, len(defect.tags)) for defect, _ in found] == [("local_time", 12)]
    assert not any(name.startswith("met") for name in found[0][0].tags)


def test_clocks_without_a_majority_are_named() -> None:
    station = _station(np.random.default_rng(9))
    station["met"], station["mcc"] = _moved(station["met"], 3.0), _moved(station["mcc"], 3.0)
    groups = [Group(tuple(one.tag.name for one in members)) for members in station.values()]
    clocks = shifted_clocks([one for members in station.values() for one in members], groups, ZONE)
    assert clocks.found and any("only 8 of 16 tags have the clock" in text for text in clocks.remarks)


AUTUMN_S, SPRING_S = 1667714400.0 + 3600.0, 1678608000.0
"""Changes of clock of Chicago, UTC: 2022-11-06 07:00 and 2023-03-12 08:00."""


def _local(stamp_s: Array, *, change_s: float, before_h: float, after_h: float) -> Array:
    return stamp_s + 3600.0 * np.where(stamp_s < change_s, before_h, after_h)


def _around(change_s: float, *, local: bool, scan_s: float = 180.0) -> tuple[list[Series], list[Array]]:
    """Return tags of two interfaces four days about a change of clock, with their true times."""
    rng = np.random.default_rng(10)
    series, truth = [], []
    for k in range(6):
        true = change_s - 2 * 86400.0 + np.cumsum(rng.uniform(0.6, 1.4, int(4 * 86400.0 / scan_s)) * scan_s)
        hours = (-5.0, -6.0) if change_s == AUTUMN_S else (-6.0, -5.0)
        stamp = _local(true, change_s=change_s, before_h=hours[0], after_h=hours[1]) if local else true
        tag = Tag(f"X{k}", "%", "other", 1 + k // 3, scan_s)
        series.append(Series(tag, stamp, rng.standard_normal(len(true)), np.full(len(true), 192, dtype=np.int16)))
        truth.append(true)
    return series, truth


def _by_change(series: list[Series]) -> ByChange:
    groups = [Group(("X0", "X1", "X2")), Group(("X3", "X4", "X5"))]
    return local_by_change(series, groups, ZONE)


@pytest.mark.parametrize("change_s", [AUTUMN_S, SPRING_S])
@pytest.mark.parametrize("stored", ["as it came", "by stamp"])
def test_a_store_in_local_time_is_found_by_its_change_of_clock(change_s: float, stored: str) -> None:
    series, truth = _around(change_s, local=True)
    if stored == "by stamp":
        series = [one.rows(np.argsort(one.time_s, kind="stable")) for one in series]
    assert _by_change(series).local == {f"X{k}" for k in range(6)}
    for one, true in zip(series, truth, strict=True):
        right = corrected(one, Shift(ZONE))
        missing = len(true) - len(right.time_s)
        if stored == "as it came" or change_s == SPRING_S:
            assert missing == 0 and np.allclose(right.time_s, true)
        else:  # which of the two hours a sample is of is not known
            assert 20 < missing < 60 and np.isin(np.round(right.time_s, 3), np.round(true, 3)).all()


@pytest.mark.parametrize("change_s", [AUTUMN_S, SPRING_S])
def test_a_store_in_utc_is_not_taken_for_local_time(change_s: float) -> None:
    series, _ = _around(change_s, local=False)
    assert _by_change(series).local == frozenset()
    # a start in just this hour of the autumn, after which the samples go on as often
    busy = [
        replace(
            one,
            time_s=np.where(
                one.time_s > AUTUMN_S - 7 * 3600.0, one.time_s * 0.5 + 0.5 * (AUTUMN_S - 7 * 3600.0), one.time_s
            ),
        )
        for one in series
    ]
    assert _by_change(busy).local == frozenset()


def test_one_tag_in_local_time_among_others_is_found_by_its_stored_order() -> None:
    series, _ = _around(AUTUMN_S, local=False)
    series[4] = _around(AUTUMN_S, local=True)[0][4]
    found = _by_change(series)
    assert found.local == {"X4"} and found.fixed == {"X0", "X1", "X2"}


@pytest.mark.parametrize("disordered", [False, True])
def test_a_tag_that_stood_about_the_change_falls_back_by_minutes(disordered: bool) -> None:
    """By exception it has few samples in the hour that comes twice."""
    true = AUTUMN_S + 1500.0 * np.arange(-100, 100) + 300.0
    true = np.append(true[true < AUTUMN_S], true[true > AUTUMN_S + 600.0])
    stamp = _local(true, change_s=AUTUMN_S, before_h=-5.0, after_h=-6.0)
    assert -1800.0 < np.diff(stamp).min() < 0.0
    if disordered:
        stamp[10:150:20] += 3600.0
    tag = Tag("X0", "%", "other", 1, 1800.0)
    one = Series(tag, stamp, np.arange(len(true), dtype=float), np.full(len(true), 192, dtype=np.int16))
    found = local_by_change([one], [Group(("X0",))], ZONE)
    assert ("X0" in found.local) is not disordered
    if not disordered:
        np.testing.assert_allclose(corrected(one, Shift(ZONE)).time_s, true)


def test_a_tag_whose_clock_is_known_is_not_moved_with_the_others_of_its_interface() -> None:
    station = _station(np.random.default_rng(11))
    known = station["mcc"][0]
    station["mcc"] = [known, *_moved(station["mcc"][1:], -5.0)]
    groups = [Group(tuple(one.tag.name for one in members)) for members in station.values()]
    every = [one for members in station.values() for one in members]
    found = shifted_clocks(every, groups, ZONE, frozenset({known.tag.name})).found
    assert [(defect.kind, defect.tags) for defect, _ in found] == [("local_time", ("mcc1", "mcc2", "mcc3"))]
