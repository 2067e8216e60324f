"""Air instruments that contradict one another: the one that leapt is at fault, whichever it is."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tests.twin.historian.made_station import START_S, ZONE, archived, instruments, scanned
from twin.historian.defects import find_and_repair
from twin.historian.tags import Array, Defect

DAY_S = 86400.0


def _spoilt(name: str, spoil: Callable[[Array, Array], Array], without: tuple[str, ...] = ()) -> list[Defect]:
    rng = np.random.default_rng(70)
    store = []
    for one in instruments(rng, 16.0):
        time_s, value = scanned(one, rng)
        if one.tag.name == name:
            inside = (time_s >= START_S + 6.0 * DAY_S) & (time_s <= START_S + 7.5 * DAY_S)
            part = (time_s - START_S - 6.0 * DAY_S) / (1.5 * DAY_S)
            value = np.where(inside, spoil(value, part), value)
        if one.tag.name not in without:
            store.append(archived(one, (time_s, value)))
    return list(find_and_repair(store, timezone=ZONE, pressure_kPa=95.0).defects)


@pytest.mark.parametrize(
    ("name", "by", "kind", "without"),
    [
        ("TDB", -8.0, "range_change", ()),
        ("TWB", -3.0, "impossible_wet_bulb", ()),
        ("TWB", 3.0, "impossible_wet_bulb", ()),
        ("RHA", -20.0, "contradicted", ("RHB",)),
    ],
)
def test_the_instrument_that_leapt_is_left_out(name: str, by: float, kind: str, without: tuple[str, ...]) -> None:
    found = _spoilt(name, lambda value, _: value + by, without)
    assert {(one.kind, one.tags) for one in found} == {(kind, (name,))}


def test_where_none_leapt_all_are_left_out_and_it_is_said() -> None:
    found = _spoilt("TWB", lambda value, part: value - 5.0 * np.sin(np.pi * part) ** 2)
    assert {one.tags[0] for one in found} == {"TWB", "TDB"}
    assert all("nothing tells which instrument is at fault" in one.says for one in found)


def test_a_pressure_that_cannot_be_spoils_no_wet_bulb() -> None:
    found = _spoilt("PB", lambda value, _: value * 0.37)
    assert {one.tags[0] for one in found} <= {"PB"}


def test_a_fault_that_lasts_for_most_of_a_record_is_not_taken_as_usual() -> None:
    rng = np.random.default_rng(71)
    store = []
    for one in instruments(rng, 16.0):
        time_s, value = scanned(one, rng)
        if one.tag.name == "TDB":
            value = np.where(time_s >= START_S + 4.0 * DAY_S, value - 6.0, value)
        store.append(archived(one, (time_s, value)))
    found = list(find_and_repair(store, timezone=ZONE, pressure_kPa=95.0).defects)
    assert {one.tags for one in found} == {("TDB",)}
    assert abs(min(one.start_s for one in found) - START_S - 4.0 * DAY_S) < 3 * 3600.0
    assert max(one.end_s for one in found) > START_S + 15.5 * DAY_S


def test_a_wet_bulb_above_a_dry_bulb_of_another_range_is_impossible() -> None:
    rng = np.random.default_rng(73)
    plant = instruments(rng, 16.0)
    store = []
    for one in plant:
        time_s, value = scanned(one, rng)
        day = (time_s - START_S) / DAY_S
        if one.tag.name == "TDB":
            value = np.where((day >= 5.0) & (day <= 8.0), value - 4.4, value)
        if one.tag.name == "TWB":
            dry = next(other.truth for other in plant if other.tag.name == "TDB")
            above = np.interp(time_s, START_S + 60.0 * np.arange(len(dry)), dry) + 1.0
            value = np.where((day >= 6.0) & (day <= 6.5), above, value)
        store.append(archived(one, (time_s, value)))
    found = find_and_repair(store, timezone=ZONE, pressure_kPa=95.0).defects
    assert sorted((one.kind, one.tags) for one in found) == [
        ("impossible_wet_bulb", ("TWB",)),
        ("range_change", ("TDB",)),
    ]


def test_a_humidity_that_latches_where_fog_is_usual_is_found() -> None:
    rng = np.random.default_rng(74)
    store = []
    for one in instruments(rng, 16.0):
        time_s, value = scanned(one, rng)
        day = (time_s - START_S) / DAY_S
        fog = (day % 4.0 > 1.0) & (day % 4.0 < 1.45)
        if "humidity" in one.tag.role:
            value = np.where(fog, 100.0, value)
        if one.tag.name == "RHA":
            value = np.where((day >= 6.0) & (day <= 7.4), 100.0, value)
        if one.tag.name == "TWB":
            dry = next(other.truth for other in instruments(np.random.default_rng(74), 16.0) if other.tag.name == "TDB")
            value = np.where(fog, np.interp(time_s, START_S + 60.0 * np.arange(len(dry)), dry), value)
        store.append(archived(one, (time_s, value)))
    found = find_and_repair(store, timezone=ZONE, pressure_kPa=95.0).defects
    assert [(one.kind, one.tags) for one in found] == [("humidity_latched", ("RHA",))]
