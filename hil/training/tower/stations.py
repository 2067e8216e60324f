"""Simulated stations as a calibrator knows them: aligned minutes, commissioned twin, healthy record, labels and truth.

A station of the family is drawn between the two sites that ship, with its own climate, pressure, hidden effect and
habits. The twin is commissioned from the simulated acceptance tests; its discrepancy is learned from the first three
weeks, when the cell is clean. Nothing else of the simulation reaches the calibrator; the truth is kept apart.
"""

from __future__ import annotations

import datetime
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.virtual.tower import (
    CHICAGO_SITE,
    COMMISSIONING,
    DAYS_A_MONTH,
    EFFECTS,
    MIAMI_SITE,
    Simulated,
    SimulationPlan,
    StationDesign,
    commissioning_rows,
    datasheet,
    event_rows,
    simulate,
    state_by_minute,
)
from twin.calibrators.hiera_unet.tower import CellTable, commissioned_log_power, commissioned_outlet
from twin.calibrators.hiera_unet.tower.cell_table import CellSources, cell_table, trimmed
from twin.historian import CellMinutes, Event, Series, Tag, cell_minutes, disturbed, influence_of, shared_minutes
from twin.tower import (
    BOUNDS,
    DEVIATIONS,
    Array,
    CellModel,
    DesignPoint,
    Inputs,
    Minutes,
    Opening,
    Priors,
    Recursion,
    blocks_of,
    filter_cell,
    minutes_of,
)
from twin.tower.calibration import fit_cell
from twin.tower.cell_observations import Label
from twin.tower.clean_cell import CommissionedCell, TestPoints, fit_clean_cell

HEALTHY_DAYS = 21
"""Days at the beginning in which a simulated cell is as good as clean: at most three weeks after its cleaning."""
CLEAN = {"fill": 0.015, "air": 0.01, "uniformity": 0.01}
"""Standard deviation of the deviations of a cell that counts as clean, as in `hil tower commission --healthy`."""
DENVER_KPA = 83.5
HIGH_SHARE, HIDDEN_SHARE = 0.2, 0.5
"""Shares of stations at a low pressure, and with an effect that the twin lacks."""
OF_A, OF_B = "A", "B"


SEGMENTS, SEGMENT_D, SETTLING_D = 2, 28, 8
"""Parts of a record that is simulated in parts, and their days: as long as from one test of the plant to the next. In
the first of them the belief finds its way back; no window is taken there."""


@dataclass(frozen=True)
class StationPlan:
    """A station to simulate: `site` A, B, or F for one of the family; seed, months, recorded cells.

    Attributes
    ----------
    parts
        Whether the healthy record and some parts of the rest are simulated alone: a plant costs a third of the time,
        and windows of its first year are as far apart as can be.
    """

    site: str
    seed: int
    months: float
    cells: int
    parts: bool = False

    @property
    def name(self) -> str:
        """Name of the station in files."""
        return f"{self.site}{self.seed:04d}"

    def segments(self) -> tuple[tuple[int, int], ...]:
        """Return the days [first, end) that are simulated, none for all."""
        if not self.parts:
            return ()
        days, first = round(self.months * DAYS_A_MONTH), HEALTHY_DAYS + 2
        free = days - first - SEGMENTS * SEGMENT_D
        if free < 0:
            return ()
        begins = np.sort(np.random.default_rng([self.seed, 11]).integers(0, free + 1, SEGMENTS))
        starts = [first + int(b) + k * SEGMENT_D for k, b in enumerate(begins)]
        return ((0, first), *((start, start + SEGMENT_D) for start in starts))


@dataclass(frozen=True)
class CellData:
    """A cell with all that a calibrator may know, and `truth` by minute: water degC and deviations, NaN at rest.

    Attributes
    ----------
    sheet
        Datasheet.
    columns
        Of the aligned record.
    minutes, recursion, commissioned
        As in `twin.tower`.
    clean, log_clean
        (n,) outlet degC and logarithm of the fan power by the commissioned twin. openings,
    events
        Of the station's records.
    """

    name: str
    sheet: dict[str, Any]
    columns: dict[str, NDArray[Any]]
    minutes: Minutes
    commissioned: CommissionedCell
    clean: Array
    log_clean: Array
    recursion: Recursion
    openings: tuple[Opening, ...]
    events: tuple[Event, ...]
    healthy_end_s: float
    truth_water: Array
    truth: Array


def drawn_site(seed: int) -> tuple[StationDesign, tuple[str, ...]]:
    """Return a site of the family and the effect that its twin lacks, if any."""
    rng = np.random.default_rng([seed, 7])
    share, weather = rng.uniform(-0.1, 1.1), rng.uniform(-0.1, 1.1)

    def between(a: Any, b: Any, at: float) -> Any:
        return a + at * (b - a) if isinstance(a, float) else a

    changes = {
        f.name: between(getattr(CHICAGO_SITE, f.name), getattr(MIAMI_SITE, f.name), share)
        for f in fields(StationDesign)
    }
    cold, warm = CHICAGO_SITE.climate, MIAMI_SITE.climate
    climate = replace(
        cold, **{f.name: between(getattr(cold, f.name), getattr(warm, f.name), weather) for f in fields(cold)}
    )
    pressure = DENVER_KPA if rng.random() < HIGH_SHARE else float(climate.pressure)
    climate = replace(
        climate,
        pressure=pressure,
        wind=float(climate.wind * rng.uniform(0.7, 1.4)),
        prevailing=float(rng.uniform(0.0, 360.0)),
    )
    first = bool(rng.random() < 0.5)
    changes |= {
        "station": "F",
        "city": "family",
        "weather_words": (),
        "climate": climate,
        "cells": 2,
        "first_cells": 1,
        "cells_per_pump": 1.0,
        "basin": float(rng.uniform(140.0, 240.0)),
        "header": float(rng.uniform(50.0, 90.0)),
        "pressure": pressure,
        "variable_pumps": bool(rng.random() < 0.5),
        "batch": bool(rng.random() < 0.5),
        "style": "loops" if first else "words",
    }
    hide = (str(rng.choice(list(EFFECTS))),) if rng.random() < HIDDEN_SHARE else ()
    return StationDesign(**changes), hide


def station_cells(plan: StationPlan) -> list[CellData]:
    """Simulate a station and return its recorded cells.

    Raises
    ------
    ValueError
        A cell cannot be commissioned or calibrated.
    """
    site, hide = drawn_site(plan.seed) if plan.site == "F" else (CHICAGO_SITE if plan.site == OF_A else MIAMI_SITE, ())
    start = datetime.datetime(2022, 1 + plan.seed % 12, 1, tzinfo=datetime.UTC)
    made = simulate(
        site,
        plan.cells,
        SimulationPlan(
            months=plan.months, cells=plan.cells, seed=plan.seed, start=start, hide=hide, segments=plan.segments()
        ),
    )
    zero = start.timestamp()
    sheet = datasheet(site, plan.cells)
    events = tuple(_event(row) for row in event_rows(made))
    points = _points(made)
    series = [_series(made, one, zero) for one in made.instruments]
    full = str(sheet["fan"]["speed_100pct"])
    shared = shared_minutes(series, zero, zero + made.plan.days * 86400.0 - 1.0, full, site.pressure)
    found = []
    for cell in range(1, plan.cells + 1):
        aligned = cell_minutes(series, shared, cell, disturbed(events, cell, shared.minute_s), full)
        found.append(_cell(plan, made, cell, sheet, aligned, points[cell], events))
    return found


def table_of(cell: CellData, segments: tuple[tuple[int, int], ...] = ()) -> CellTable:
    """Return the arrays that windows of a simulated cell are cut from.

    Parameters
    ----------
    segments
        Days [first, end) that were simulated, none for all.
    """
    found = cell_table(
        CellSources(
            name=cell.name,
            sheet=cell.sheet,
            columns=cell.columns,
            minutes=cell.minutes,
            design=cell.commissioned.design,
            clean=cell.clean,
            log_clean=cell.log_clean,
            beliefs=cell.recursion,
            events=cell.events,
            healthy_end_s=cell.healthy_end_s,
            true_water=cell.truth_water,
            true=cell.truth,
        )
    )
    if not segments:
        return found
    day = np.arange(len(found.regime)) / 1440.0
    keep, settled = (
        np.any([(day >= first + wait) & (day < end) for first, end in segments], axis=0) for wait in (0, SETTLING_D)
    )
    return trimmed(found, keep, settled)


def _cell(
    plan: StationPlan,
    made: Simulated,
    cell: int,
    sheet: dict[str, Any],
    aligned: CellMinutes,
    points: TestPoints,
    events: tuple[Event, ...],
) -> CellData:
    design, bypass = sheet["design"], float(sheet["bypass"]["share_when_open"])
    water = float(design["water_flow_kg_s"])
    fitted = fit_clean_cell(points, water, water / float(design["water_to_air"]))
    columns = {name: np.asarray(v) for name, v in aligned.columns.items()}
    origin = {n: columns[f"{n}_how"].astype(np.uint8) for n in columns if f"{n}_how" in columns}
    wide = {n: v.astype(np.float64) for n, v in columns.items() if not n.endswith(("_how", "_age_min"))}
    minutes = minutes_of(
        aligned.minute_s, wide, origin, fitted.design.m_w0, bypass, site_kPa=float(design["pressure_kPa"])
    )
    point = DesignPoint(float(design["water_inlet_C"]), float(design["wet_bulb_C"]), float(design["range_K"]), bypass)
    model = CellModel(fitted.design, point)
    sd = fitted.sd
    priors = Priors(
        BOUNDS, {"merkel": (0.0, float(np.clip(sd[0], 1e-3, 0.5))), "exponent": (0.0, float(np.clip(sd[1], 1e-3, 0.5)))}
    )
    end = float(minutes.time_s[0]) + HEALTHY_DAYS * 86400.0
    until = int(np.searchsorted(minutes.time_s, end))
    openings = _openings(events, cell)
    first = minutes.part(slice(0, until))
    middle = 0.5 * (float(minutes.time_s[0]) + end)
    stated = [Label(middle, cell, name, 0.0, 0.0, one, "healthy record") for name, one in CLEAN.items()]
    zero = made.plan.start.timestamp()
    labels = [_label(one, zero) for one in made.truth.life.labels if one.cell == cell]
    early = [one for one in labels if one.time_s <= end]
    healthy = fit_cell(model, first, priors, [*stated, *early], [o for o in openings if o.start_s < end]).posterior
    blocks, _ = blocks_of(minutes)
    beliefs = filter_cell(model, minutes, blocks, priors, healthy, end, labels, openings)
    state = state_by_minute(made, cell)
    bias = made.truth.held(made.truth.life.bias[:, cell - 1])
    truth = np.stack([*(state[name] - 1.0 for name in DEVIATIONS[:3]), bias], axis=1)
    on = made.truth.cell("on", cell) > 0.5
    return CellData(
        f"{plan.name}_{cell}",
        sheet,
        columns,
        minutes,
        fitted,
        commissioned_outlet(model, minutes),
        commissioned_log_power(model, minutes),
        beliefs,
        openings,
        tuple(e for e in events if e.cell in (0, cell)),
        end,
        np.where(on, made.truth.cell("t_out", cell), np.nan),
        truth,
    )


def _series(made: Simulated, one: Any, zero: float) -> Series:
    samples = made.samples[one.tag]
    time_s = np.round((zero + samples.time_s) * 1e3) / 1e3
    tag = Tag(one.tag, one.unit, one.kind.role, one.cell or None, float(one.scan_s), one.description)
    return Series(tag, time_s, samples.value.astype(np.float32).astype(np.float64), samples.quality)


def _points(made: Simulated) -> dict[int, TestPoints]:
    rows = [dict(zip(COMMISSIONING, row, strict=True)) for row in commissioning_rows(made)]
    found = {}
    for cell in {int(row["cell"]) for row in rows}:
        mine = [row for row in rows if int(row["cell"]) == cell]
        v = {name: np.array([float(row[name]) for row in mine]) for name in COMMISSIONING if name != "test"}
        inputs = Inputs(
            v["water_inlet_C"],
            v["water_flow_kg_s"],
            v["fan_speed_pct"] / 100.0,
            v["dry_bulb_C"],
            v["entering_wet_bulb_C"],
            v["pressure_kPa"],
        )
        found[cell] = TestPoints(
            inputs, v["water_outlet_C"], v["fan_power_kW"], v["air_flow_kg_s"], v["evaporation_kg_s"]
        )
    return found


def _event(row: tuple[Any, ...]) -> Event:
    time, precision, cell, source, kind, text = row
    moment = datetime.datetime.fromisoformat(str(time).replace("Z", "+00:00"))
    moment = moment if moment.tzinfo else moment.replace(tzinfo=datetime.UTC)
    return Event(moment.timestamp(), precision == "day", int(cell), kind, source, text)


def _openings(events: tuple[Event, ...], cell: int) -> tuple[Opening, ...]:
    found = []
    for event in events:
        if event.cell not in (0, cell):
            continue
        influence = influence_of(event.kind, event.text)
        low, high = event.window_s
        work_s = 3600.0 * influence.hours
        begins = low - work_s if event.by_day else low
        found += [Opening(begins, high + work_s, name) for name in influence.parameters]
    return tuple(found)


def _label(one: Any, zero: float) -> Label:
    clean = 0.0 if one.parameter == "bias" else 1.0
    time_s = zero + 60.0 * one.minute
    if one.value is not None:
        return Label(time_s, one.cell, one.parameter, one.value - clean, one.value - clean, one.sd, one.source)
    return Label(time_s, one.cell, one.parameter, one.low - clean, one.high - clean, None, one.source)
