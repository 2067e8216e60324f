"""Operation of a station: load, outages, trips of fans, monthly performance tests and rotation of the cells."""

from __future__ import annotations

import datetime
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.virtual.tower.records import Happening
from drivers.virtual.tower.sites import StationDesign

Array = NDArray[np.float64]
MINUTES_A_DAY = 1440
TEST_STEP_MIN = 75
TEST_STEPS = ((1.0, 1.0), (0.75, 1.0), (0.5, 1.0), (1.0, 0.8), (0.7, 0.8), (1.0, 1.12), (0.6, 1.12))
"""Fan speed and water flow, as shares, of the steps of a performance test."""
TRIP_EVERY_D, OUTAGE_EVERY_D, TEST_EVERY_D = 14.0, 45.0, 30.0
"""Mean days between trips of a cell's fan and between outages of the station; days between tests of a cell."""


@dataclass(frozen=True)
class StationOperation:
    """Demands on the plant by minute: load kW, outage, trips and tests by cell (NaN: none), cell that starts
    first."""

    load: Array
    outage: NDArray[np.bool_]
    trips: NDArray[np.bool_]
    test_speed: Array
    test_flow: Array
    lead: NDArray[np.int64]
    happenings: tuple[Happening, ...]


def operate(site: StationDesign, start: datetime.datetime, n: int, rng: np.random.Generator) -> StationOperation:
    """Return `n` minutes of operation from `start` (UTC), drawn by `rng`."""
    cells, happenings = site.cells, []
    outage, trips = np.zeros(n, dtype=bool), np.zeros((n, cells), dtype=bool)
    speed, flow = np.full((n, cells), np.nan), np.full((n, cells), np.nan)
    for minute in _poisson(rng, n, OUTAGE_EVERY_D * MINUTES_A_DAY):
        hours = int(rng.integers(18, 30))
        if minute < MINUTES_A_DAY or minute + 60 * hours > n - MINUTES_A_DAY:
            continue
        outage[minute : minute + 60 * hours] = True
        text = f"station stopped; restarted together after {hours} h"
        happenings.append(Happening(minute, 0, "DCS", "station_outage", text))
    for cell in range(cells):
        first = (
            int(rng.uniform(2.0, TEST_EVERY_D - 4.0))
            if n > 28 * MINUTES_A_DAY
            else int(n / MINUTES_A_DAY * rng.uniform(0.2, 0.6))
        )
        length = TEST_STEP_MIN * len(TEST_STEPS)
        for day in np.arange(first, n / MINUTES_A_DAY, TEST_EVERY_D):
            # At eight in the morning of the site, on a working day, with nobody else testing.
            begin = int(day) * MINUTES_A_DAY + 14 * 60
            while begin < n and (_weekday(start, begin) > 4 or np.isfinite(speed[begin]).any()):
                begin += MINUTES_A_DAY
            if begin + length > n or outage[begin - 600 : begin + length].any():
                continue
            for k, (of_speed, of_flow) in enumerate(TEST_STEPS):
                rows = slice(begin + k * TEST_STEP_MIN, begin + (k + 1) * TEST_STEP_MIN)
                speed[rows, cell], flow[rows, cell] = of_speed, of_flow
            text = f"fan and flow step test, {len(TEST_STEPS)} steps of {TEST_STEP_MIN} min"
            happenings.append(Happening(begin, cell + 1, "DCS", "performance_test", text))
        for minute in _poisson(rng, n, TRIP_EVERY_D * MINUTES_A_DAY):
            length = int(rng.integers(12, 100))
            around = slice(max(minute - 60, 0), minute + length + 60)
            if outage[around].any() or np.isfinite(speed[around, cell]).any():
                continue
            trips[minute : minute + length, cell] = True
            text = f"fan motor tripped, reset after {length} min"
            happenings.append(Happening(minute, cell + 1, "DCS", "fan_trip", text))
    week = (np.arange(n) // (7 * MINUTES_A_DAY)).astype(np.int64)
    lead = (week + int(rng.integers(cells))) % cells
    return StationOperation(_load(site, start, n, rng), outage, trips, speed, flow, lead, tuple(happenings))


def _weekday(start: datetime.datetime, minute: int) -> int:
    return (start + datetime.timedelta(minutes=minute)).weekday()


def _poisson(rng: np.random.Generator, n: int, every: float) -> list[int]:
    times, at = [], rng.exponential(every)
    while at < n:
        times.append(int(at))
        at += rng.exponential(every)
    return times


def _load(site: StationDesign, start: datetime.datetime, n: int, rng: np.random.Generator) -> Array:
    """Return the heat load, kW: a base with shifts and slow changes, or batches; both with steps."""
    design = site.cell_load * site.cells
    hour = (start.hour + start.minute / 60.0 + np.arange(n) / 60.0 + site.climate.zone_h) % 24.0
    day = (start.weekday() + np.arange(n) // MINUTES_A_DAY) % 7
    hours = n // 60 + 3
    slow = np.zeros(hours)
    kicks = rng.normal(size=hours) * np.sqrt(1.0 - 0.97**2)
    for k in range(1, hours):
        slow[k] = 0.97 * slow[k - 1] + kicks[k]
    drift = np.interp(np.arange(n) / 60.0, np.arange(hours), slow)
    if site.batch:
        share, at, high = np.empty(n), 0, True
        while at < n:
            length = int(rng.uniform(100, 280) if high else rng.uniform(40, 150))
            share[at : at + length] = rng.uniform(0.72, 0.95) if high else rng.uniform(0.35, 0.55)
            at, high = at + length, not high
        share = _lagged(share, 18.0) + 0.04 * drift
    else:
        shift = np.where((hour > 6.0) & (hour < 22.0) & (day < 5), 0.16, 0.0)
        share = 0.58 + _lagged(shift, 40.0) + 0.07 * drift
        for minute in _poisson(rng, n, 1.2 * MINUTES_A_DAY):  # a unit that goes on or off
            length = int(rng.uniform(60, 900))
            share[minute : minute + length] += rng.choice([-0.14, 0.12])
        share = _lagged(share, 10.0)
    return np.asarray(design * np.clip(share, 0.15, 1.02))


def _lagged(value: Array, minutes: float) -> Array:
    from scipy.signal import lfilter

    a = np.exp(-1.0 / minutes)
    return np.asarray(lfilter([1.0 - a], [1.0, -a], value - value[0]) + value[0])
