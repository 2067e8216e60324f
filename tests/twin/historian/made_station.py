"""A small station and its historian for tests: scans with noise, exception reporting, swinging door, jitter, defects.

It shares no code with what it tests but the psychrometrics. Defects are seeded into the scans (stuck, unit, swap,
latched, wet bulb) or into the stored samples (gap, repeats, local time, quality), as a plant's instruments and
archives do.
"""

from __future__ import annotations

import zoneinfo
from dataclasses import dataclass, field, replace

import numba
import numpy as np

from twin.historian.tags import Array, Series, Tag
from twin.tower.air import wet_bulb

START_S = 1_650_000_000.0 - 1_650_000_000.0 % 86400.0
ZONE = "Europe/Madrid"
MINUTE_S = 60.0


@dataclass(frozen=True)
class Instrument:
    """A tag with its truth by the minute, noise, resolution and exception deviation, in the tag's unit."""

    tag: Tag
    truth: Array
    noise: float
    resolution: float
    deviation: float
    interface: str


@dataclass
class Seeded:
    """Defects that were seeded: kind, tags, from and to."""

    rows: list[tuple[str, tuple[str, ...], float, float]] = field(default_factory=list)

    def add(self, kind: str, tags: tuple[str, ...], start_s: float, end_s: float) -> None:
        self.rows.append((kind, tags, start_s, end_s))


def instruments(rng: np.random.Generator, days: float, cells: int = 2) -> list[Instrument]:
    """Return the instruments of a station with its weather, load and cells."""
    n = round(days * 1440)
    minute = np.arange(n)
    season = np.cos(2 * np.pi * (minute / 1440.0 + 100) / 365.0)
    day = np.sin(2 * np.pi * (minute / 1440.0 - 0.38))
    dry = 18.0 - 9.0 * season + 5.0 * day + _wander(rng, n, 1500, 2.5) + _wander(rng, n, 20, 0.4)
    dew = np.minimum(dry - 0.6, 9.0 - 7.0 * season + _wander(rng, n, 2500, 3.0) + _wander(rng, n, 30, 0.3))
    share = 100.0 * _vapour(dew) / _vapour(dry)
    pressure = 95.0 + _wander(rng, n, 2000, 0.6)
    wet = wet_bulb(dry, share / 100.0, pressure)
    wind = np.maximum(3.0 + 1.5 * day + _wander(rng, n, 300, 1.4) + _wander(rng, n, 8, 0.6), 0.0)
    direction = np.mod(230.0 + _wander(rng, n, 600, 50.0) + _wander(rng, n, 10, 12.0), 360.0)
    load = np.maximum(0.72 + 0.12 * day + _wander(rng, n, 700, 0.08) + _wander(rng, n, 15, 0.02), 0.2)
    on = np.stack([_schedule(rng, n, k) for k in range(cells)])
    total = np.maximum(on.sum(axis=0), 1e-9)
    running = on.any(axis=0)
    flow = np.where(on, 180.0 * (1.0 + 0.25 * (cells / np.maximum(total, 1.0) - 1.0)), 0.0)
    flow = np.stack([_lagged(one, 3.0) for one in flow])
    fan = np.clip(0.35 + 0.05 * (wet - 12.0) + 0.5 * (load - 0.7), 0.0, 1.0)
    rows: list[Instrument] = []
    outlets = []
    for k in range(cells):
        command = np.where(
            on[k], np.round(100.0 * np.clip(fan + _wander(rng, n, 25, 0.05) + 0.05 * k, 0.0, 1.0) * 2) / 2, 0.0
        )
        command = np.where(command < 25.0, 0.0, command)
        command = np.repeat(command[::5], 5)[:n] if n % 5 == 0 else command
        speed = _lagged(command, 2.0)
        air = np.maximum(speed / 100.0, 0.12)
        effectiveness = (0.86 - 0.03 * k) * (1.0 - np.exp(-1.9 * air**0.6 * (180.0 / np.maximum(flow[k], 40.0)) ** 0.4))
        inlet = wet + 9.0 + 9.0 * load + 2.0 * (1.0 - fan)
        outlet = _lagged(np.where(on[k], inlet - effectiveness * (inlet - wet), wet + 6.0), 4.0)
        outlets.append(outlet)
        c = str(k + 1)
        plc, bias = f"plc{c}", rng.normal(0.0, 0.25, 3)
        hot = np.where(on[k], inlet, 0.98 * inlet)
        rows += [
            _temperature(f"T{c}IN", "water_inlet_temperature", k + 1, _lagged(hot, 5.0) + bias[0], plc, rng),
            _temperature(f"T{c}OUT", "water_outlet_temperature", k + 1, outlet + bias[1], plc, rng),
            _instrument(f"F{c}", "m3/h", "water_flow", k + 1, flow[k] * 3.61, 4.0, 1.0, 9.0, plc, rng),
            _instrument(f"V{c}", "%", "bypass_position", k + 1, np.zeros(n), 0.15, 0.1, 1.0, plc, rng),
            _instrument(f"ON{c}", "0/1", "cell_in_service", k + 1, on[k].astype(float), 0.0, 1.0, 0.5, plc, rng),
            _instrument(f"SC{c}", "%", "fan_speed_command", k + 1, command, 0.0, 0.1, 0.5, "mcc", rng),
            _instrument(f"SI{c}", "%", "fan_speed", k + 1, speed, 0.05, 0.1, 0.4, "mcc", rng),
            _instrument(f"JI{c}", "kW", "fan_power", k + 1, 40.0 * (speed / 100.0) ** 3, 0.3, 0.1, 0.6, "mcc", rng),
        ]
    mixed = sum((flow[k] * outlets[k] for k in range(cells)), np.zeros(n)) / np.maximum(flow.sum(axis=0), 1.0)
    basin = _lagged(np.where(running, mixed, mixed[running].mean() if running.any() else 20.0), 25.0)
    for k in range(cells):
        rows.append(
            _temperature(
                f"T{k + 1}BAS", "basin_temperature", k + 1, basin + 0.1 * (outlets[k] - basin), f"plc{k + 1}", rng
            )
        )
    pump = np.where(running, 90.0 + 0.05 * flow.sum(axis=0), 0.0)
    head = np.where(running, 120.0 + 60.0 * (flow.max(axis=0) / 225.0) ** 2, 0.0)
    heat = 4.19 * flow.sum(axis=0) * (9.0 + 9.0 * load - 8.0)
    station = [
        ("TRET", "degC", "return_header_temperature", wet + 9.0 + 9.0 * load, 0.06, 0.02, 0.12, "dcs"),
        ("TSUP", "degC", "supply_temperature", _lagged(basin, 10.0), 0.05, 0.02, 0.12, "dcs"),
        ("PH", "kPa", "header_pressure", head, 0.6, 0.1, 1.5, "dcs"),
        ("JP", "kW", "pump_power", pump, 0.8, 0.1, 2.0, "mcc"),
        ("QH", "kW", "station_heat_load", heat, 40.0, 1.0, 90.0, "dcs"),
        ("TDB", "degC", "dry_bulb_temperature", dry, 0.05, 0.01, 0.1, "met"),
        ("RHA", "%", "relative_humidity", np.clip(share + 0.8, 0.0, 100.0), 0.3, 0.1, 0.8, "met"),
        ("RHB", "%", "relative_humidity_redundant", np.clip(share - 0.7, 0.0, 100.0), 0.3, 0.1, 0.8, "met"),
        ("TWB", "degC", "wet_bulb_temperature", wet + 0.1, 0.05, 0.01, 0.1, "met"),
        ("PB", "hPa", "barometric_pressure", 10.0 * pressure, 0.08, 0.1, 0.3, "met"),
        ("WS", "m/s", "wind_speed", wind, 0.2, 0.1, 0.4, "met"),
        ("WD", "deg", "wind_direction", direction, 3.0, 1.0, 6.0, "met"),
    ]
    for name, unit, role, truth, noise, resolution, deviation, interface in station:
        rows.append(_instrument(name, unit, role, None, truth, noise, resolution, deviation, interface, rng))
    return rows


def clean_store(rng: np.random.Generator, days: float, cells: int = 2) -> list[Series]:
    """Return what a historian without defects holds."""
    return [archived(one, scanned(one, rng)) for one in instruments(rng, days, cells)]


def scanned(one: Instrument, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return times and values of the scans, with jitter, noise and resolution."""
    n = len(one.truth)
    count = int(n * MINUTE_S / one.tag.scan_s) - 1
    at = one.tag.scan_s * (np.arange(count) + 0.1 + 0.7 * rng.random()) + rng.normal(0.0, 4.0, count)
    at = np.round(np.maximum.accumulate(np.maximum(at, 0.0)) + 1e-3 * np.arange(count) % 1e-1, 3)
    value = np.interp(at, np.arange(n) * MINUTE_S, one.truth) + one.noise * rng.standard_normal(count)
    if one.tag.unit == "0/1":
        value = one.truth[np.minimum((at / MINUTE_S).astype(int), n - 1)]
    if one.tag.unit == "deg":
        value = np.mod(value, 360.0)
    if one.tag.unit == "%" and "humidity" in one.tag.role:
        value = np.clip(value, 0.0, 100.0)
    return at + START_S, np.round(value / one.resolution) * one.resolution


def archived(one: Instrument, scans: tuple[Array, Array]) -> Series:
    """Return the samples that are left by exception reporting and a swinging door."""
    time_s, value = scans
    longest = 14400.0 if one.tag.unit == "0/1" else 3600.0
    keep = _reported(time_s, value, one.deviation, longest)
    time_s, value = time_s[keep], value[keep]
    keep = _compressed(time_s, value, one.deviation, longest)
    return Series(one.tag, time_s[keep], value[keep], np.full(int(keep.sum()), 192, dtype=np.int16))


def local_stamps(time_s: Array, zone: str = ZONE) -> Array:
    """Return the stamps of an archive that writes local time as if it were UTC."""
    import datetime

    info = zoneinfo.ZoneInfo(zone)
    hours, inverse = np.unique(np.floor(time_s / 3600.0), return_inverse=True)
    moments = [datetime.datetime.fromtimestamp(h * 3600.0, datetime.UTC).astimezone(info) for h in hours]
    offsets = np.array([moment.utcoffset().total_seconds() for moment in moments])  # type: ignore[union-attr]
    return np.asarray(time_s + offsets[inverse])


def with_quality(one: Series, start_s: float, end_s: float, code: int) -> Series:
    """Return the series with a quality code between two times."""
    quality = one.quality.copy()
    quality[(one.time_s >= start_s) & (one.time_s <= end_s)] = code
    return replace(one, quality=quality)


def with_repeats(one: Series, start_s: float, end_s: float, rng: np.random.Generator) -> Series:
    """Return the series with half of its samples between two times stored again."""
    rows = np.flatnonzero((one.time_s >= start_s) & (one.time_s <= end_s))
    rows = rows[rng.random(len(rows)) < 0.5]
    order = np.sort(np.append(np.arange(len(one.time_s)), rows), kind="stable")
    return one.rows(order)


def silent(one: Series, start_s: float, end_s: float) -> Series:
    """Return the series without samples between two times."""
    return one.rows((one.time_s < start_s) | (one.time_s > end_s))


def _instrument(
    name: str,
    unit: str,
    role: str,
    cell: int | None,
    truth: Array,
    noise: float,
    resolution: float,
    deviation: float,
    interface: str,
    rng: np.random.Generator,
) -> Instrument:
    scan = float(rng.choice([120.0, 120.0, 180.0, 300.0]))
    return Instrument(Tag(name, unit, role, cell, scan), truth, noise, resolution, deviation, interface)


def _temperature(name: str, role: str, cell: int, truth: Array, interface: str, rng: np.random.Generator) -> Instrument:
    return _instrument(name, "degC", role, cell, truth, 0.05, 0.01, 0.12, interface, rng)


def _wander(rng: np.random.Generator, n: int, minutes: float, size: float) -> Array:
    """Return first-order noise with a time constant and a standard deviation."""
    return np.asarray(size * _first_order(rng.standard_normal(n), float(np.exp(-1.0 / minutes))))


def _lagged(x: Array, minutes: float) -> Array:
    return np.asarray(_lag(np.asarray(x, dtype=np.float64), 1.0 / max(minutes, 1.0)))


def _schedule(rng: np.random.Generator, n: int, k: int) -> Array:
    """Return the minutes in service: mostly on, off for days at times; the first cell more than the others."""
    on = np.ones(n, dtype=bool)
    at = 0
    while at < n:
        at += int(rng.uniform(3, 9) * 1440)
        off = int(rng.uniform(0.3, 1.5) * 1440)
        on[at : at + off] = False
        at += off
    return on


def _vapour(celsius: Array) -> Array:
    return np.asarray(0.61094 * np.exp(17.625 * celsius / (celsius + 243.04)))


@numba.njit(cache=True)
def _first_order(x, a):  # type: ignore[no-untyped-def]
    y = np.empty(len(x))
    state, gain = 0.0, np.sqrt(1.0 - a * a)
    for k in range(len(x)):
        state = a * state + gain * x[k]
        y[k] = state
    return y


@numba.njit(cache=True)
def _lag(x, share):  # type: ignore[no-untyped-def]
    y = np.empty(len(x))
    state = x[0]
    for k in range(len(x)):
        state += share * (x[k] - state)
        y[k] = state
    return y


@numba.njit(cache=True)
def _reported(time_s, value, deviation, longest):  # type: ignore[no-untyped-def]
    keep = np.zeros(len(value), dtype=np.bool_)
    last = 0
    keep[0] = True
    for k in range(1, len(value)):
        if abs(value[k] - value[last]) > deviation:
            keep[k - 1] = True  # the value before an exception is sent too
            keep[k] = True
            last = k
        elif time_s[k] - time_s[last] > longest - 300.0:
            keep[k] = True
            last = k
    return keep


@numba.njit(cache=True)
def _compressed(time_s, value, deviation, longest):  # type: ignore[no-untyped-def]
    keep = np.zeros(len(value), dtype=np.bool_)
    keep[0] = True
    last, low, high = 0, -np.inf, np.inf
    for k in range(1, len(value)):
        span = time_s[k] - time_s[last]
        if span <= 0.0:
            continue
        slope = (value[k] - value[last]) / span
        if slope > high or slope < low or span > longest:
            keep[k - 1] = True
            last = k - 1
            span = max(time_s[k] - time_s[last], 1e-3)
            low = (value[k] - deviation - value[last]) / span
            high = (value[k] + deviation - value[last]) / span
        else:
            low = max(low, (value[k] - deviation - value[last]) / span)
            high = min(high, (value[k] + deviation - value[last]) / span)
    keep[len(value) - 1] = True
    return keep
