"""Seeded defects of a plant's historian for tests, one of each kind or more, at random places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.twin.historian.made_station import (
    START_S,
    Instrument,
    Seeded,
    archived,
    instruments,
    local_stamps,
    scanned,
    silent,
    with_quality,
    with_repeats,
)
from twin.historian.events import Event
from twin.historian.tags import Array, Series

HOUR_S, DAY_S = 3600.0, 86400.0


def spoilt_store(
    rng: np.random.Generator, days: float, cells: int = 2
) -> tuple[list[Series], Seeded, tuple[Event, ...]]:
    """Return the samples of a store with defects, the defects, and the maintenance entries that name a swap."""
    seeded = Seeded()
    plant = instruments(rng, days, cells)
    scans = {one.tag.name: scanned(one, rng) for one in plant}
    by_name = {one.tag.name: one for one in plant}
    events = _spoil_scans(rng, days, cells, by_name, scans, seeded)
    store = [archived(one, scans[one.tag.name]) for one in plant]
    return _spoil_samples(rng, days, plant, store, seeded), seeded, events


def _spoil_scans(
    rng: np.random.Generator,
    days: float,
    cells: int,
    by_name: dict[str, Instrument],
    scans: dict[str, tuple[Array, Array]],
    seeded: Seeded,
) -> tuple[Event, ...]:
    switched = f"F{rng.integers(1, cells + 1)}"
    at = START_S + DAY_S * days * rng.uniform(0.25, 0.75)
    time_s, value = scans[switched]
    scans[switched] = time_s, np.where(time_s >= at, np.round(value / 3.6), value)
    seeded.add("unit_switch", (switched,), at, float(time_s[-1]))

    pair = (f"T{rng.integers(1, cells + 1)}OUT", f"T{rng.integers(1, cells + 1)}OUT")
    if pair[0] == pair[1]:
        pair = pair[0], pair[0].replace("OUT", "BAS")
    start = START_S + DAY_S * days * rng.uniform(0.2, 0.5)
    end = start + DAY_S * rng.uniform(4.0, 0.3 * days)
    first, second = scans[pair[0]], scans[pair[1]]
    scans[pair[0]], scans[pair[1]] = _exchanged(first, second, start, end), _exchanged(second, first, start, end)
    seeded.add("swap", pair, start, end)
    day = start - start % DAY_S + DAY_S * rng.integers(-2, 3)
    events = (Event(day, True, 0, "instrument_work", "CMMS", f"Transmitters {pair[0]} and {pair[1]} renewed"),)

    for name in rng.choice(
        [n for n in by_name if n[0] in "TF" and n[1].isdigit() and n not in (*pair, switched)], 2, replace=False
    ):
        start = START_S + DAY_S * days * rng.uniform(0.05, 0.9)
        end = start + HOUR_S * rng.uniform(5.0, 20.0)
        time_s, value = scans[name]
        inside = (time_s >= start) & (time_s <= end)
        truth = by_name[name].truth
        if not inside.any() or abs(value[inside][0]) < 0.1 * np.abs(truth).max():
            continue
        scans[name] = time_s, np.where(inside, value[inside][0], value)
        seeded.add("stuck", (name,), start, end)

    start = START_S + DAY_S * days * rng.uniform(0.1, 0.45)
    end = start + HOUR_S * rng.uniform(12.0, 60.0)
    time_s, value = scans["RHA"]
    scans["RHA"] = time_s, np.where((time_s >= start) & (time_s <= end), 100.0, value)
    seeded.add("humidity_latched", ("RHA",), start, end)

    start = START_S + DAY_S * days * rng.uniform(0.6, 0.9)
    end = start + HOUR_S * rng.uniform(8.0, 30.0)
    time_s, value = scans["TWB"]
    scans["TWB"] = time_s, np.where((time_s >= start) & (time_s <= end), value + rng.uniform(1.2, 3.0), value)
    seeded.add("impossible_wet_bulb", ("TWB",), start, end)
    return events


def _exchanged(own: tuple[Array, Array], other: tuple[Array, Array], start: float, end: float) -> tuple[Array, Array]:
    time_s, value = own
    inside = (time_s >= start) & (time_s <= end)
    return time_s, np.where(inside, np.interp(time_s, *other), value)


def _spoil_samples(
    rng: np.random.Generator, days: float, plant: list[Instrument], store: list[Series], seeded: Seeded
) -> list[Series]:
    interfaces = {one.tag.name: one.interface for one in plant}
    for interface in ("plc1", "mcc", "met", "plc2"):
        start = START_S + DAY_S * days * rng.uniform(0.02, 0.95)
        end = start + HOUR_S * rng.uniform(1.2, 6.0)
        store = [silent(one, start, end) if interfaces[one.tag.name] == interface else one for one in store]
        names = tuple(name for name, where in interfaces.items() if where == interface)
        seeded.add("comms_gap", names, start, end)
    for _ in range(2):
        start = START_S + DAY_S * days * rng.uniform(0.02, 0.9)
        end = start + HOUR_S * rng.uniform(8.0, 30.0)
        store = [with_repeats(one, start, end, rng) for one in store]
        seeded.add("duplicates", (), start, end)
    for _ in range(6):
        k = int(rng.integers(len(store)))
        start = START_S + DAY_S * days * rng.uniform(0.02, 0.9)
        end = start + HOUR_S * rng.uniform(0.5, 4.0)
        spoilt = with_quality(store[k], start, end, int(rng.choice([0, 64])))
        if (spoilt.quality < 192).sum() > (store[k].quality < 192).sum():
            store[k] = spoilt
            seeded.add("bad_quality", (spoilt.tag.name,), start, end)
    local = [interfaces[one.tag.name] == "mcc" for one in store]
    store = [
        replace(one, time_s=local_stamps(one.time_s)).rows(np.argsort(local_stamps(one.time_s), kind="stable"))
        if is_local
        else one
        for one, is_local in zip(store, local, strict=True)
    ]
    names = tuple(one.tag.name for one, is_local in zip(store, local, strict=True) if is_local)
    seeded.add("local_time", names, START_S, START_S + DAY_S * days)
    return store


def found_of(seeded: Seeded, defects: list[tuple[str, tuple[str, ...], float, float]]) -> tuple[list[int], list[int]]:
    """Return the seeded defects that were found, and the findings that are none of them, by number.

    A finding counts if its kind and a tag are right, and if it covers 30 % of the shorter of the two, 3 hours apart
    at most.
    """
    found, used = [], set()
    for j, (kind, tags, start, end) in enumerate(seeded.rows):
        hits = [
            k
            for k, (a, b, low, high) in enumerate(defects)
            if a == kind
            and (not tags or set(tags) & set(b))
            and min(end, high) - max(start, low) + 3.0 * HOUR_S > 0.3 * (min(end - start, high - low) + 3.0 * HOUR_S)
        ]
        if hits:
            found.append(j)
            used.update(hits)
    return found, [k for k in range(len(defects)) if k not in used]
