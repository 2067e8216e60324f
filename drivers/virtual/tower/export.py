"""Files of a simulated station, in the format of a plant's export, and for scoring its truth and key."""

from __future__ import annotations

import csv
import datetime
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from drivers.virtual.tower.degradation import WRITTEN
from drivers.virtual.tower.physics import ratios, wet_bulb
from drivers.virtual.tower.sites import EnteringAir, StationDesign
from drivers.virtual.tower.station import Simulated, state_by_minute

STATION_FILES = frozenset(
    (
        "raw.parquet",
        "tags.csv",
        "datasheet.json",
        "commissioning.csv",
        "events.csv",
        "labels.csv",
        "truth.parquet",
    )
)
"""Names of all files that `write_station` can write."""
TESTS = (
    (1.0, 1.0),
    (1.0, 1.0),
    (1.0, 1.0),
    (1.0, 1.0),
    (1.0, 0.92),
    (1.0, 0.9),
    (1.0, 0.9),
    (1.0, 0.9),
    (1.0, 1.1),
    (1.0, 1.1),
    (1.0, 1.1),
    (1.0, 1.1),
    (0.8, 1.0),
    (0.6, 1.0),
    (0.5, 1.0),
)
"""Fan speed and water flow, as shares, of the acceptance test of a cell."""
DAYS_OFF = 3


def write_station(made: Simulated, folder: Path, *, score: bool) -> list[Path]:
    """Write the station's files into `folder` and return their paths.

    Raises
    ------
    OSError
        The folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = [_raw(made, folder / "raw.parquet")]
    files.append(
        _table(
            folder / "tags.csv",
            ("tag", "description", "unit", "cell", "role", "scan_s"),
            (
                (one.tag, one.description, one.unit, one.cell or "", one.kind.role, one.scan_s)
                for one in made.instruments
            ),
        )
    )
    files.append(folder / "datasheet.json")
    files[-1].write_text(json.dumps(datasheet(made.site, made.recorded), indent=1) + "\n")
    files.append(_table(folder / "commissioning.csv", COMMISSIONING, commissioning_rows(made)))
    files.append(_table(folder / "events.csv", EVENTS, event_rows(made)))
    files.append(_labels(made, folder / "labels.csv"))
    if score:
        files.append(_truth(made, folder / "truth.parquet"))
    return files


def _table(path: Path, header: tuple[str, ...], rows: Iterable[Iterable[Any]]) -> Path:
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)
    return path


def _moment(made: Simulated, seconds: float) -> datetime.datetime:
    return made.plan.start + datetime.timedelta(seconds=seconds)


def iso(moment: datetime.datetime) -> str:
    """Return a time as ISO 8601 in UTC, to the second."""
    return moment.strftime("%Y-%m-%dT%H:%M:%SZ")


def _raw(made: Simulated, path: Path) -> Path:
    names = [one.tag for one in made.instruments]
    kept = [made.samples[name] for name in names]
    zero = made.plan.start.timestamp()
    stamp = np.concatenate([np.round((zero + one.time_s) * 1e3) for one in kept]).astype("datetime64[ms]")
    index = np.repeat(np.arange(len(names), dtype=np.int32), [len(one.time_s) for one in kept])
    value = np.concatenate([one.value for one in kept]).astype(np.float32)
    table = pa.table(
        {
            "timestamp": pa.array(stamp, pa.timestamp("ms", tz="UTC")),
            "tag": pa.DictionaryArray.from_arrays(pa.array(index), pa.array(names, pa.string())),
            "value": pa.array(value, pa.float32()),
            "quality": pa.array(np.concatenate([one.quality for one in kept]), pa.int16()),
        }
    )
    pq.write_table(table, path, compression="zstd")
    return path


def datasheet(site: StationDesign, recorded: int) -> dict[str, Any]:
    """Return the datasheet of a station: what its maker states."""
    return {
        "station": site.station,
        "site": site.city,
        "timezone": site.timezone,
        "kind": "induced-draft counterflow, film fill, VFD fan",
        "cells_in_station": site.cells,
        "cells_recorded": list(range(1, recorded + 1)),
        "design": {
            "water_flow_kg_s": site.water,
            "water_flow_m3_h": round(site.water * 3.61),
            "water_inlet_C": site.hot,
            "water_outlet_C": site.cold,
            "range_K": round(site.hot - site.cold, 2),
            "approach_K": round(site.cold - site.wet, 2),
            "wet_bulb_C": site.wet,
            "pressure_kPa": site.pressure,
            "water_to_air": round(site.water / site.air, 2),
        },
        "fan": {
            "rated_power_kW": site.rated_power,
            "power_at_design_kW": site.power,
            "minimum_speed_pct": 30,
            "speed_100pct": "60 Hz",
        },
        "fill": {"length_m": site.plan, "width_m": site.plan, "height_m": site.fill_height},
        "basin": {
            "volume_m3": site.basin,
            "compartments": 2,
            "first_compartment_cells": list(range(1, site.first_cells + 1)),
            "suction": "from both compartments",
        },
        "hot_header_volume_m3": site.header,
        "pumps": {"speed": "variable" if site.variable_pumps else "fixed", "per_cells": site.cells_per_pump},
        "bypass": {"route": "hot water of a cell past its fill into its outlet flume", "share_when_open": 0.7},
        "supply_setpoint_C": site.setpoint,
        "outlet_rtd": "in the outlet flume of each cell, after the bypass return",
        "quality_codes": {"192": "good", "64": "uncertain", "0": "bad"},
    }


COMMISSIONING = (
    "cell",
    "test",
    "water_inlet_C",
    "water_outlet_C",
    "entering_wet_bulb_C",
    "dry_bulb_C",
    "pressure_kPa",
    "wind_m_s",
    "water_flow_kg_s",
    "fan_speed_pct",
    "fan_power_kW",
    "air_flow_kg_s",
    "evaporation_kg_s",
)
"""Columns of the acceptance tests."""


def commissioning_rows(made: Simulated) -> list[tuple[Any, ...]]:
    """Return the acceptance tests of the clean cells, at rest, with test instruments, in the order of `COMMISSIONING`.

    Each call draws from the station's own stream of commissioning, so that two calls differ.
    """
    site, rng = made.site, made.streams["commissioning"]
    rows = []
    for cell in range(1, made.recorded + 1):
        for k, (speed, flow) in enumerate(TESTS):
            dry = site.wet + rng.uniform(1.5, 8.0)
            pressure = site.pressure + rng.normal(0.0, 0.3)
            humidity = rng.uniform(0.5, 0.85)
            ratio = float(ratios(np.array([dry]), np.array([humidity]), np.array([pressure]))[0])
            hot, m_w = site.hot + rng.uniform(-3.5, 2.5), site.water * flow * rng.normal(1.0, 0.015)
            wind = rng.uniform(0.3, 3.0)
            entering = EnteringAir(dry, ratio, pressure, wind)
            out, _, air, _, _, power, lost = made.built.steady(
                cell - 1, made.built.clean_state(), m_w, speed, hot, entering
            )
            wet = wet_bulb(dry, ratio, pressure)
            rows.append(
                (
                    cell,
                    f"T{k + 1:02d}",
                    _r(hot + rng.normal(0, 0.03), 2),
                    _r(out + rng.normal(0, 0.03), 2),
                    _r(wet + rng.normal(0, 0.06), 2),
                    _r(dry + rng.normal(0, 0.05), 2),
                    _r(pressure, 2),
                    _r(wind, 1),
                    _r(m_w * rng.normal(1, 0.006), 2),
                    _r(100 * speed, 1),
                    _r(power * rng.normal(1, 0.005), 2),
                    _r(air * rng.normal(1, 0.012), 1),
                    _r(lost * rng.normal(1, 0.02), 3),
                )
            )
    return rows


def _r(value: float, digits: int) -> float:
    return round(float(value), digits)


EVENTS = ("time", "precision", "cell", "source", "event", "text")


def event_rows(made: Simulated) -> list[tuple[Any, ...]]:
    """Return the events in the order of `EVENTS`: to the minute from the control system; by the day, sometimes wrong or
    missing, from maintenance. Each call draws from the station's own stream of records, so that two calls differ."""
    rng = made.streams["records"]
    rows = []
    for one in (*made.operation.happenings, *made.truth.life.happenings):
        if one.cell > made.recorded or one.minute >= len(made.truth.wet):
            continue
        moment = _moment(made, 60.0 * one.minute)
        if one.source == "DCS":
            rows.append((iso(moment), "minute", one.cell, one.source, one.event, one.text))
            continue
        off, written = int(rng.integers(-DAYS_OFF, DAYS_OFF + 1)), rng.random() < WRITTEN
        if written:
            day = moment + datetime.timedelta(days=off * (rng.random() < 0.6))
            rows.append((day.strftime("%Y-%m-%d"), "day", one.cell, one.source, one.event, one.text))
    for swap in made.seeded.of("swap"):
        text = f"Transmitters of {swap.tags[0]} and {swap.tags[1]} exchanged for new ones, terminals re-made"
        rows.append((_moment(made, swap.span[0]).strftime("%Y-%m-%d"), "day", 0, "CMMS", "instrument_work", text))
    return sorted(rows)


def _labels(made: Simulated, path: Path) -> Path:
    rows = [
        (
            iso(_moment(made, 60.0 * one.minute)),
            one.cell,
            one.parameter,
            "point" if one.value is not None else "interval",
            *("" if x is None else x for x in (one.value, one.sd, one.low, one.high)),
            one.source,
        )
        for one in made.truth.life.labels
        if one.cell <= made.recorded
    ]
    return _table(path, ("time", "cell", "parameter", "kind", "value", "sd", "lo", "hi", "source"), sorted(rows))


def _truth(made: Simulated, path: Path) -> Path:
    """Write the truth by minute and cell."""
    truth, n = made.truth, len(made.truth.wet)
    first = np.datetime64(made.plan.start.replace(tzinfo=None), "ms")
    time = first + np.arange(n).astype("timedelta64[m]")
    tables = []
    for cell in range(1, made.recorded + 1):
        daily = made.truth.life
        columns = {
            "t_out": truth.cell("t_out", cell),
            "t_in": truth.cell("t_in", cell),
            "twb": truth.wet,
            "twb_in": truth.cell("wet_in", cell),
            "m_w": truth.cell("m_w", cell),
            "m_a": truth.cell("m_a", cell),
            "speed": truth.cell("speed", cell) / 100.0,
            "bypass": truth.cell("bypass", cell) / 100.0,
            "evap": truth.cell("evaporation", cell),
            **state_by_minute(made, cell),
            "bias": truth.held(daily.bias[:, cell - 1]),
            "flow_gain": truth.held(daily.flow_gain[:, cell - 1]),
        }
        head = {
            "time": pa.array(time, pa.timestamp("ms")),
            "cell": pa.array(np.full(n, cell, dtype=np.int8)),
            "running": pa.array(truth.cell("on", cell) > 0.5),
        }
        tables.append(pa.table(head | {name: pa.array(values.astype(np.float32)) for name, values in columns.items()}))
    pq.write_table(pa.concat_tables(tables), path, compression="zstd")
    return path


def key_of(made: Simulated) -> dict[str, Any]:
    """Return what was seeded and hidden: for scoring alone."""
    defects = []
    for one in made.seeded.defects:
        named: dict[str, Any] = (
            {"tag": one.tags[0]} if len(one.tags) == 1 else {"tags": list(one.tags)} if one.tags else {}
        )
        span = {"from": iso(_moment(made, one.span[0])), "to": iso(_moment(made, one.span[1]))}
        defects.append({"type": one.kind, **named, **one.more, **span})
    done = [
        {"time": iso(_moment(made, 60.0 * one.minute)), "cell": one.cell, "event": one.event}
        for one in made.truth.life.happenings
        if one.cell <= made.recorded and one.minute < len(made.truth.wet)
    ]
    mix = {str(cell): _mix(made, cell) for cell in range(1, made.recorded + 1)}
    return {
        "answer": made.answer,
        "hidden": list(made.plan.hide),
        "defects": defects,
        "events": done,
        "seed": made.plan.seed,
        "weather": made.weather_source,
        "mix": mix,
    }


def _mix(made: Simulated, cell: int) -> dict[str, Any]:
    """Return the deviations of a cell at the beginning and the end: the mix that makes a commissioned twin's error."""
    days = slice(made.plan.days)
    daily = {
        "bias": made.truth.life.bias[days, cell - 1],
        "flow_gain": made.truth.life.flow_gain[days, cell - 1],
        **state_by_minute(made, cell),
    }
    return {name: [round(float(values[0]), 4), round(float(values[-1]), 4)] for name, values in daily.items()}
