"""Defects of a made station's historian: those that were seeded are found, none is invented."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from tests.twin.historian.made_defects import found_of, spoilt_store
from tests.twin.historian.made_station import (
    START_S,
    ZONE,
    Seeded,
    archived,
    clean_store,
    instruments,
    scanned,
    silent,
)
from twin.historian.defects import Repaired, find_and_repair
from twin.historian.tags import Series

DAY_S = 86400.0


def _found(store: list[Series], **options: object) -> Repaired:
    return find_and_repair(store, timezone=ZONE, pressure_kPa=95.0, **options)  # type: ignore[arg-type]


@lru_cache(maxsize=2)
def _spoilt(seed: int) -> tuple[Seeded, Repaired]:
    """Return the defects of a store of thirty days, and what was found in it."""
    store, seeded, events = spoilt_store(np.random.default_rng(seed), 30.0)
    return seeded, _found(store, events=events)


def test_a_clean_store_has_no_defect() -> None:
    found = _found(clean_store(np.random.default_rng(1), 30.0))
    assert [(one.kind, one.tags, one.says) for one in found.defects] == []


def test_seeded_defects_are_found_and_nothing_else() -> None:
    missed, false, seeded_in_all = [], [], 0
    for seed in (10, 11):
        seeded, repaired_store = _spoilt(seed)
        findings = [(one.kind, one.tags, one.start_s, one.end_s) for one in repaired_store.defects]
        found, extra = found_of(seeded, findings)
        seeded_in_all += len(seeded.rows)
        missed += [seeded.rows[k] for k in range(len(seeded.rows)) if k not in found]
        false += [findings[k] for k in extra]
    assert len(missed) <= 0.05 * seeded_in_all, missed
    assert len(false) <= 1, false


def test_clock_unit_and_swap_are_undone() -> None:
    plant = instruments(np.random.default_rng(11), 30.0)
    truth = {one.tag.name: one.truth for one in plant}
    noise = {one.tag.name: one.noise for one in plant}
    seeded, repaired_store = _spoilt(11)
    repaired = {one.tag.name: one for one in repaired_store.series}
    kinds = {kind: (tags, start, end) for kind, tags, start, end in seeded.rows}
    minutes = START_S + 60.0 * np.arange(len(truth["F1"]))
    for kind in ("unit_switch", "swap", "local_time"):
        tags, start, end = kinds[kind]
        for name in tags:
            one = repaired[name].between(start + 7200.0, end - 7200.0)
            off = np.abs(one.value - np.interp(one.time_s, minutes, truth[name]))
            scale = float(np.std(truth[name])) or 1.0
            assert np.median(off) < max(0.3 * scale, 2.0 * noise[name]), (kind, name)


@pytest.mark.parametrize("hours", [-3, 5])
def test_a_clock_off_by_hours_in_another_zone_is_found(hours: int) -> None:
    store = clean_store(np.random.default_rng(30), 30.0)
    mast = {"TDB", "RHA", "RHB", "TWB", "PB", "WS", "WD"}
    moved = [replace(one, time_s=one.time_s - 3600.0 * hours) if one.tag.name in mast else one for one in store]
    found = [one for one in _found(moved).defects if one.kind in ("clock_offset", "local_time")]
    assert [(one.kind, set(one.tags)) for one in found] == [("clock_offset", mast)]
    assert f"{abs(hours)} h {'behind' if hours > 0 else 'ahead of'}" in found[0].says


def test_what_bad_quality_explains_is_no_further_defect() -> None:
    store = clean_store(np.random.default_rng(31), 20.0)
    start, end = START_S + 5 * DAY_S, START_S + 5.3 * DAY_S
    spoilt = []
    for one in store:
        if one.tag.name == "TWB":
            inside = (one.time_s >= start) & (one.time_s <= end)
            quality = np.where(inside, 64, one.quality).astype(np.int16)
            one = replace(one, value=np.where(inside, one.value + 5.0, one.value), quality=quality)
        spoilt.append(one)
    assert [one.kind for one in _found(spoilt).defects] == ["bad_quality"]


def test_a_wet_bulb_that_stands_still_is_one_defect() -> None:
    rng = np.random.default_rng(32)
    plant = instruments(rng, 20.0)
    start, end = START_S + 8 * DAY_S, START_S + 8.8 * DAY_S
    store = []
    for one in plant:
        time_s, value = scanned(one, rng)
        if one.tag.name == "TWB":
            inside = (time_s >= start) & (time_s <= end)
            value = np.where(inside, value[inside][0], value)
        store.append(archived(one, (time_s, value)))
    assert [(one.kind, one.tags) for one in _found(store).defects] == [("stuck", ("TWB",))]


def test_a_gap_of_a_single_tag_is_no_gap_of_its_interface() -> None:
    store = clean_store(np.random.default_rng(33), 20.0)
    store = [
        silent(one, START_S + 5 * DAY_S, START_S + 5.2 * DAY_S) if one.tag.name == "T1OUT" else one for one in store
    ]
    assert [one.kind for one in _found(store).defects] == []


def test_a_store_of_a_single_tag_or_of_none_is_no_error() -> None:
    store = clean_store(np.random.default_rng(34), 3.0)
    assert _found([]).series == ()
    assert len(_found(store[:1]).series) == 1


def test_a_tag_without_a_good_sample_is_kept_empty() -> None:
    store = clean_store(np.random.default_rng(35), 5.0)
    bad = replace(store[0], quality=np.zeros(len(store[0].time_s), dtype=np.int16))
    repaired = _found([bad, *store[1:]])
    assert len(repaired.series[0].time_s) == 0
    assert [one.kind for one in repaired.defects] == ["bad_quality"]


def test_stuck_values_of_a_long_record_are_found_season_by_season() -> None:
    rng = np.random.default_rng(36)
    days = 125.0
    store, spans = [], []
    for one in instruments(rng, days):
        time_s, value = scanned(one, rng)
        if one.tag.name == "T1BAS":
            for day in range(6, 120, 9):
                start = START_S + day * DAY_S
                inside = (time_s >= start) & (time_s <= start + 6.0 * 3600.0)
                value = np.where(inside, value[inside][0], value)
                spans.append(start)
        store.append(archived(one, (time_s, value)))
    stuck = [one for one in _found(store).defects if one.kind == "stuck"]
    assert {one.tags for one in stuck} == {("T1BAS",)}
    found = [any(abs(one.start_s - start) < 3600.0 for one in stuck) for start in spans]
    assert len(spans) == 13 and sum(found) >= 11
