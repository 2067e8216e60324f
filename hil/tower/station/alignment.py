"""Aligned one-minute record of a station from its historian.

The record is a folder:

`cell<N>.parquet`, one for each cell with an outlet thermometer; one row a minute, without holes, over the whole span
of the store. `time` is the beginning of the minute (timestamp, ms, UTC). NaN is missing everywhere.

| columns | content |
|---|---|
| `t_in_C`, `t_out_C`, `basin_C` | water: to the fill, in the outlet flume, in the basin |
| `m_w_kg_s`, `riser_valve_pct`, `bypass_pct` | water flow of the cell, valves |
| `fan_command_pct`, `fan_speed_pct`, `fan_power_kW` | fan; Hz become % by the datasheet |
| `fan_fault`, `in_service` | states, 0 or 1 |
| `neighbours_speed_pct` | mean fan speed of the station's other cells |
| `return_C`, `supply_C`, `header_kPa`, `pump_kW`, `load_kW` | station: water, pumps, heat load |
| `makeup_kg_s`, `blowdown_kg_s`, `level_pct` | basin |
| `dry_C`, `rh_pct`, `rh2_pct`, `pressure_kPa`, `wind_m_s`, `wind_deg` | weather |
| `wet_C` | measured wet bulb, dropped more than 0.35 K off that of dry bulb and humidity |
| `wet_rh_C`, `closure_K` | wet bulb of dry bulb and humidity; measured minus that, before dropping |
| `<column>_how` | uint8, origin of the minute, see `twin.historian.minutes.How` |
| `<column>_age_min` | float32, minutes since the last raw sample |
| `regime` | uint8, see `twin.historian.regimes` |
| `check` | uint8, failed redundancy checks, see `twin.historian.checks` |
| `disturbed` | bool, within the influence of an event of known minute |

Origins: 0 missing, 1 measured (a raw sample within the minute), 2 interpolated in a gap under 3 min, 3 interpolated
up to the longest regular interval of a tag that reports by exception, 4 held (commands, states). Checks: 1 power
against speed, 2 pump work against flow, 4 outlet below wet bulb, 8 outlet above inlet.

A column whose tag is not in the dictionary is there and missing throughout. `<column>_how` and `<column>_age_min`
exist for every column that has a tag. Metadata of the file (`hil.tower`): JSON with cell, station, format version.

The files replace those of an earlier record in the folder together, and cells that are not in the new one go.

`alignment.json`: `{"defects": [{"type", "tags", "from", "to", "says", "repair"}], "cells", "minutes", "yield",
"remarks"}`, times in ISO 8601, UTC. `station.json`: datasheet, and events with their influence period and
parameters, for the calibrator.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from drivers.historian import HistorianStore, Samples
from hil.files import held, replacing_all
from hil.record import RecordError
from hil.tower.station.csv_store import CsvStore
from hil.tower.station.description import Station
from hil.tower.station.errors import TowerOutputError, writing
from hil.tower.station.times import iso
from twin.historian import (
    CellMinutes,
    Defect,
    Event,
    Series,
    cell_minutes,
    disturbed,
    exchanged_meters,
    in_usual_units,
    influence_of,
    order_and_silence,
    out_of_range,
    shared_minutes,
    usual_at_work,
    with_clock_steps_undone,
    without_strays,
)
from twin.historian.defects import Repaired, find_and_repair

FORMAT = 1


@dataclass(frozen=True)
class Aligned:
    """Result of an alignment: defects, remarks, files that were written, and the share of complete minutes by cell."""

    defects: tuple[Defect, ...]
    remarks: tuple[str, ...]
    files: tuple[Path, ...]
    minutes: int
    complete: Mapping[int, float]


def align(store: HistorianStore, station: Station, out: Path, stamps: str | None = None) -> Aligned:
    """Write the aligned record of the station's tags into the folder `out` and return the report.

    Parameters
    ----------
    store
        Historian with the raw samples.
    station
        Tag dictionary, datasheet and events.
    out
        Folder of the record.
    stamps
        Zone of the store's time stamps where they carry none, IANA; None: UTC, unless a change of clock or other tags
        show local time.

    Raises
    ------
    RecordError
        The store has none of the tags, or no minute; or the dictionary has no outlet thermometer.
    HistorianError
        The store fails.
    TowerOutputError
        The folder cannot be written, or another process works on it; nothing is left half written.
    """
    if not station.cells:
        raise RecordError(
            "no tag of the dictionary has the role water_outlet_temperature, so no cell gets a record; map the tag of "
            "each cell's outlet thermometer"
        )
    ignored = _own_zone(store, stamps)
    if ignored:
        stamps = None
    raw, remarks = read_series(store, station)
    remarks = [*ignored, *remarks]
    raw, strays = without_strays(raw, station.places)
    raw, set_wrong = with_clock_steps_undone(raw)
    exchanged = exchanged_meters(raw, station.ratings)
    raw, wrong = in_usual_units(raw, station.places, station.ratings)
    repaired = find_and_repair(
        raw,
        timezone=station.timezone,
        stamps=stamps,
        pressure_kPa=station.pressure_kPa,
        events=station.events,
        full_speed=station.full_speed,
        usual=usual_at_work(station.tags.values(), station.ratings),
    )
    local = frozenset(name for one in repaired.defects if one.kind == "local_time" for name in one.tags)
    if isinstance(store, CsvStore) and store.zoneless and stamps is None and not local:
        strays.append(
            f"{store.zoneless[0]}: its times have no time zone and are taken as UTC; where they are local, name their "
            f"zone with --stamps"
        )
    local |= frozenset(one.tag.name for one in raw) if stamps is not None else frozenset()
    remarks = [*station.remarks, *remarks, *strays, *order_and_silence(raw, station.places, local), *wrong]
    del raw
    outside = out_of_range(repaired.series, station.full_speed)
    defects = sorted((*set_wrong, *repaired.defects, *exchanged, *outside), key=lambda one: one.start_s)
    repaired = replace(repaired, defects=tuple(defects))
    remarks += [*repaired.remarks, *_no_pressure(repaired.series, station)]
    return write_record(repaired, station, out, remarks)


def _no_pressure(series: Sequence[Series], station: Station) -> list[str]:
    """Return a sentence where neither a barometer nor the datasheet tells the air pressure of the site."""
    if station.ratings.pressure_kPa or any(one.tag.role == "barometric_pressure" for one in series):
        return []
    return [
        f"neither a barometer nor the datasheet gives the air pressure of the site; {station.pressure_kPa:g} kPa is "
        f"taken, that of sea level: write design.pressure_kPa into the datasheet"
    ]


def _own_zone(store: HistorianStore, stamps: str | None) -> list[str]:
    """Return a sentence if the stamps carry a zone of their own, so that they are no local times of `stamps`."""
    if stamps is None:
        return []
    if store.zoned is None:
        raise RecordError(
            f"some files of the store have time stamps with a zone, and others without: --stamps {stamps} cannot name "
            f"that of all; align them apart, or write the zone into the stamps"
        )
    if not store.zoned:
        return []
    return [
        f"--stamps {stamps} is not used: the time stamps of the store carry a zone of their own, which names their "
        f"moment; where it is wrong, write them without one"
    ]


def surveyed(store: HistorianStore, station: Station) -> tuple[list[Series], list[str]]:
    """Return the raw series of the station's tags, and what is wrong with them before defects are looked for.

    Stamps of a clock that was set wrong are moved back, as `align` does it.

    Raises
    ------
    RecordError
        The store has none of the tags.
    HistorianError
        The store fails.
    """
    raw, remarks = read_series(store, station)
    raw, strays = without_strays(raw, station.places)
    raw, set_wrong = with_clock_steps_undone(raw)
    clocks = [_moved_back(one, station.places) for one in set_wrong]
    _, wrong = in_usual_units(raw, station.places, station.ratings)
    order = order_and_silence(raw, station.places, frozenset(one.tag.name for one in raw))
    return raw, [*station.remarks, *remarks, *strays, *clocks, *order, *wrong]


def _moved_back(defect: Defect, places: Mapping[str, str]) -> str:
    """Return a sentence on stamps that a clock set wrong has given."""
    first = defect.tags[0]
    return (
        f"{places.get(first, 'the dictionary')}: from {iso(defect.start_s)[:16]}Z to {iso(defect.end_s)[:16]}Z, UTC, "
        f"{defect.says} ({first} is one of them); hil tower align moves them back: check the logger's clock"
    )


def read_series(store: HistorianStore, station: Station) -> tuple[list[Series], list[str]]:
    """Return the raw series of the station's tags that the store has, and a sentence for each that it has not."""
    there = set(store.tags())
    wanted = [name for name in station.tags if name in there]
    absent = [name for name in station.tags if name not in there]
    if not wanted:
        example = ", ".join(sorted(there)[:3]) or "none"
        raise RecordError(
            f"the store has none of the dictionary's {len(station.tags)} tags; it has {example}: write the store's "
            f"names into the dictionary"
        )
    further = there - set(station.tags)
    remarks = [f"{station.places.get(name, 'the dictionary')}: {_absent(name, further)}" for name in absent]
    samples = store.read(wanted)
    raw = [_series(station, name, samples[name]) for name in wanted]
    empty = [one.tag.name for one in raw if not one.good.any()]
    remarks += [f"{name} has no good sample; its column stays missing" for name in empty]
    return [one for one in raw if len(one.time_s)], remarks


def _absent(name: str, further: set[str]) -> str:
    import difflib

    near = difflib.get_close_matches(name, sorted(further), n=1, cutoff=0.6)
    hint = f"; is it {near[0]} now? then rename it in the dictionary" if near else "; map it or remove the line"
    return f"{name} of the dictionary is not in the store; its column stays missing{hint}"


def _series(station: Station, name: str, samples: Samples) -> Series:
    return Series(station.tags[name], samples.time_s, samples.value, samples.quality)


def write_record(repaired: Repaired, station: Station, out: Path, remarks: list[str]) -> Aligned:
    """Write minutes of repaired series as the record `out`."""
    times = [(one.time_s[0], one.time_s[-1]) for one in repaired.series if len(one.time_s)]
    if not times:
        raise RecordError("no tag has a good sample; the record would be empty")
    start, end = min(low for low, _ in times), max(high for _, high in times)
    shared = shared_minutes(repaired.series, start, end, station.full_speed, station.pressure_kPa)
    complete = {}
    with writing(out), held(out, TowerOutputError), replacing_all(out, _is_of_record) as staging:
        for cell in station.cells:
            rows = disturbed(station.events, cell, shared.minute_s)
            minutes = cell_minutes(repaired.series, shared, cell, rows, station.full_speed)
            _write(staging / f"cell{cell}.parquet", minutes, cell, station)
            complete[cell] = minutes.complete
            remarks = [*remarks, *minutes.remarks]
        report = {
            "defects": [_defect(one) for one in repaired.defects],
            "cells": list(station.cells),
            "minutes": len(shared.minute_s),
            "yield": {str(cell): round(share, 4) for cell, share in complete.items()},
            "remarks": remarks,
        }
        _write_json(staging / "alignment.json", report)
        about = {"datasheet": station.datasheet, "events": [event_entry(event) for event in station.events]}
        _write_json(staging / "station.json", about)
    files = tuple(out / f"cell{cell}.parquet" for cell in station.cells)
    return Aligned(repaired.defects, tuple(remarks), files, len(shared.minute_s), complete)


def _is_of_record(name: str) -> bool:
    """Return True for the name of a record's file."""
    return re.fullmatch(r"cell\d+\.parquet|alignment\.json|station\.json", name) is not None


def _write(path: Path, minutes: CellMinutes, cell: int, station: Station) -> None:
    arrays = {"time": pa.array((minutes.minute_s * 1e3).astype("datetime64[ms]"), pa.timestamp("ms", tz="UTC"))}
    arrays |= {name: pa.array(values) for name, values in minutes.columns.items()}
    about = {"format": FORMAT, "cell": cell, "station": station.datasheet.get("station", "")}
    table = pa.table(arrays).replace_schema_metadata({"hil.tower": json.dumps(about)})
    pq.write_table(table, path, compression="zstd")


def _write_json(path: Path, document: Any) -> None:
    path.write_text(json.dumps(document, indent=1) + "\n")


def _defect(one: Defect) -> dict[str, Any]:
    return {
        "type": one.kind,
        "tags": list(one.tags),
        "from": iso(one.start_s),
        "to": iso(one.end_s),
        "says": one.says,
        "repair": one.repair,
    }


def event_entry(event: Event) -> dict[str, Any]:
    """Return an event as `station.json` holds it, with its influence period and the parameters that it may change."""
    influence = influence_of(event.kind, event.text)
    low, high = event.window_s
    work_s = 3600.0 * influence.hours
    # An entry by the day may be dated at the end of the work as well as at its beginning.
    begins = low - work_s if event.by_day else low
    return {
        "time": iso(event.time_s),
        "by_day": event.by_day,
        "cell": event.cell,
        "kind": event.kind,
        "source": event.source,
        "text": event.text,
        "from": iso(begins),
        "to": iso(high + work_s),
        "parameters": list(influence.parameters),
    }
