"""Commissioning of a tower cell from its test points and datasheet: a twin file of the clean cell."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hil.record import RecordError
from hil.tower.calibration.healthy import Healthy, clean_cell_of
from hil.tower.calibration.prepared_cells import priors_of, site_of
from hil.tower.station import Mistakes, checked_datasheet, read_cell, read_notes, read_rows
from twin.historian import FAN_APART, SITE_PRESSURE
from twin.network import Network, Revision, digest
from twin.tower import (
    SEA_LEVEL_KPA,
    Array,
    CellModel,
    Inputs,
    cell_network,
    cell_of,
    design_of,
    minutes_of,
    site_pressure_of,
    value_of,
)
from twin.tower.calibration import CalibrationError, fit_cell
from twin.tower.clean_cell import CommissionedCell, CommissioningError, TestPoints, fit_clean_cell

REQUIRED = (
    "cell",
    "water_inlet_C",
    "water_outlet_C",
    "entering_wet_bulb_C",
    "dry_bulb_C",
    "water_flow_kg_s",
    "fan_speed_pct",
)
OPTIONAL = ("pressure_kPa", "fan_power_kW", "air_flow_kg_s", "evaporation_kg_s", "wind_m_s")
RANGES = {
    "water_inlet_C": (0.0, 70.0),
    "water_outlet_C": (0.0, 60.0),
    "entering_wet_bulb_C": (-30.0, 40.0),
    "dry_bulb_C": (-40.0, 60.0),
    "water_flow_kg_s": (0.01, 1e5),
    "fan_speed_pct": (5.0, 120.0),
    "pressure_kPa": (50.0, 110.0),
    "air_flow_kg_s": (0.01, 1e5),
}
"""Values that a test point can have in these units; others are in another unit, which the message names."""
HINTS = {
    "C": "it looks like degF or K: convert to degC",
    "kPa": "is it in hPa, bar, psi or mmHg? convert to kPa",
    "pct": "give it in %, 0 to 100",
}
FAR = {"t/h": 3.6**0.5, "lb": 2.2046**0.5, "hp": 1.341**0.5, "W": 1000.0**0.5}
"""Factors from which a quantity is nearer to one in a usual wrong unit than to itself: the root of that unit's factor.
That of hp is near the service factor of motors, 1.15, too."""
LEAST_LOAD = 0.25
"""Least power of a fan at full speed as a share of its motor's: below, it would be in another unit."""
MAINS_HZ = 60.0
"""Highest mains frequency: speeds that do not exceed it may be frequencies."""
OUTLIER = (4.0, 0.3)
"""Robust standard deviations, and K, beyond which a test point is off the others: thermometers are good to 0.1 K."""
WET_BULB_MARGIN_K = 0.2
"""By which a measured outlet may lie below the entering wet bulb: two thermometers' uncertainty."""


@dataclass(frozen=True)
class CommissioningPoints:
    """Test points of one cell with the name of each and its line in the file."""

    points: TestPoints
    names: tuple[str, ...]


def read_points(path: Path, cell: int, site_kPa: float = SEA_LEVEL_KPA) -> CommissioningPoints:
    """Return the test points of a cell.

    Raises
    ------
    RecordError
        A column or the cell is missing, or a value is no number or cannot be in the column's unit.
    """
    rows, names, cells = [], [], set()
    mistakes = Mistakes(path)
    for line, row in read_rows(path, REQUIRED):
        number = float("nan")
        with mistakes.noted():
            number = _number(path, line, "cell", row["cell"])
            if number != int(number):
                raise RecordError(f"{path}:{line}: cell is {number:g}; give a whole number")
            cells.add(int(number))
        if number != cell:
            continue
        of_row = Mistakes(path)
        values = {}
        for name in (*REQUIRED[1:], *OPTIONAL):
            with of_row.noted():
                values[name] = _value(path, line, name, row.get(name) or "", site_kPa)
        with mistakes.noted():
            of_row.refuse()
            _refuse_impossible(path, line, values)
        rows.append(values)
        names.append(row.get("test") or f"line {line}")
    mistakes.refuse()
    if not rows:
        raise RecordError(f"{path}: has no test point of cell {cell}; it has those of {_listed(cells)}")
    v = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    inputs = Inputs(
        v["water_inlet_C"],
        v["water_flow_kg_s"],
        v["fan_speed_pct"] / 100.0,
        v["dry_bulb_C"],
        v["entering_wet_bulb_C"],
        v["pressure_kPa"],
    )
    points = TestPoints(inputs, v["water_outlet_C"], v["fan_power_kW"], v["air_flow_kg_s"], v["evaporation_kg_s"])
    return CommissioningPoints(points, tuple(names))


def commission_cell(cell: int, datasheet: Path, points: Path) -> tuple[Network, CommissionedCell, CommissioningPoints]:
    """Return the twin of a clean cell, its fit and the test points.

    Raises
    ------
    RecordError
        A file cannot be used, or the fit describes no cooling tower.
    """
    sheet = checked_datasheet(datasheet)
    design = sheet.get("design", {})
    water_flow = float(design.get("water_flow_kg_s", 0.0))
    if water_flow <= 0.0:
        raise RecordError(
            f"{datasheet}: design.water_flow_kg_s, the design water flow of a cell, is needed as a number above 0"
        )
    loading = float(design.get("water_to_air", math.nan))
    share = float(sheet.get("bypass", {}).get("share_when_open", 0.0))
    site = float(design.get("pressure_kPa", SEA_LEVEL_KPA))
    found = read_points(points, cell, site)
    if "pressure_kPa" not in design:
        site = float(np.median(found.points.inputs.pressure))
    flows, air = found.points.inputs.m_w / water_flow, found.points.m_a / (found.points.inputs.speed * water_flow)
    _refuse_far(points, cell, ("water_flow_kg_s", flows), f"design.water_flow_kg_s of {datasheet}", FAR["t/h"])
    if loading > 0.0:
        reference = f"the air at this fan_speed_pct by design.water_to_air of {datasheet}"
        if float(found.points.inputs.speed.max()) * 100.0 <= MAINS_HZ:
            reference += (
                f" (the fan's highest speed is {100.0 * float(found.points.inputs.speed.max()):g}: is it in Hz?)"
            )
        _refuse_far(points, cell, ("air_flow_kg_s", air * loading), reference, FAR["lb"])
    try:
        fitted = fit_clean_cell(found.points, water_flow, water_flow / loading if loading > 0.0 else None)
    except CommissioningError as error:
        raise RecordError(f"{points}: cell {cell}: {error}") from error
    fitted = replace(fitted, remarks=(*fitted.remarks, *_outliers(fitted, found.names)))
    _refuse_other_power(points, cell, fitted.design.power + fitted.design.idle, datasheet, sheet)
    fitted = replace(fitted, remarks=(*fitted.remarks, *_pressures(points, datasheet, design, found.points)))
    evidence = f"{len(found.names)} test points, {fitted.rmse:.3f} K RMSE of the outlet"
    revision = Revision(
        made_by="hil tower commission",
        evidence=evidence,
        record=digest(points.read_text()),
        record_file=points.name,
        error_fitted_K={"T_out_C": fitted.rmse},
        notes=fitted.remarks,
    )
    station = str(sheet.get("station", ""))
    return cell_network(cell, station, fitted.design, share, fitted.rmse, fitted.sd, revision, site), fitted, found


def learn_healthy(record: Path, network: Network, span: tuple[float, float]) -> Healthy:
    """Return what the healthy span of a record teaches of a clean cell's constants and discrepancy.

    Raises
    ------
    RecordError
        The record cannot be used or has too little of the span.
    """
    cell, design = read_cell(record, cell_of(network)), design_of(network)
    share = value_of(network, "cell.bypass_share")
    rows = (cell.time_s >= span[0]) & (cell.time_s < span[1])
    if not rows.any():
        raise RecordError(f"{cell.path}: holds no minute of the healthy span; give days of this record")
    columns = {name: values[rows] for name, values in cell.columns.items()}
    origin = {name: values[rows] for name, values in cell.origin.items()}
    minutes = minutes_of(cell.time_s[rows], columns, origin, design.m_w0, share, site_kPa=site_pressure_of(network))
    clean = Healthy(*span, np.zeros(0), np.zeros((0, 0)))
    notes = read_notes(record)
    model = CellModel(design, site_of(notes, share))
    try:
        found = fit_cell(model, minutes, priors_of(network, notes), clean.labels(cell.cell), ()).posterior
    except CalibrationError as error:
        raise RecordError(f"{cell.path}: the healthy span {error}") from error
    constant, spread = found.constant, found.constant_covariance()
    return replace(clean, mean=constant, covariance=spread, clean_cell=clean_cell_of(network))


def _refuse_far(path: Path, cell: int, of: tuple[str, Array], reference: str, factor: float) -> None:
    """Raise RecordError where the median of a column's share of its design value is far from one."""
    name, share = of
    there = share[np.isfinite(share)]
    middle = float(np.median(there)) if len(there) else 1.0
    if not 1.0 / factor <= middle <= factor:
        raise RecordError(
            f"{path}: {name} of cell {cell} is {middle:.3g} times {reference} in the median; check the units"
        )


def _outliers(fitted: CommissionedCell, names: Sequence[str]) -> list[str]:
    """Return a sentence on each test point that is off the others."""
    size = np.abs(fitted.residual)
    limit = max(OUTLIER[0] * 1.4826 * float(np.median(size)), OUTLIER[1])
    return [
        f"test point {names[k]} is {-fitted.residual[k]:+.2f} K off the others: check it, or leave it out"
        for k in np.flatnonzero(size > limit).tolist()
    ]


def _refuse_other_power(points: Path, cell: int, full_kW: float, path: Path, sheet: dict[str, Any]) -> None:
    """Raise RecordError where the power of a fan at full speed is not that of the datasheet.

    It may be as much below that of the motor as motors are larger than their fans, and as far off that at design as
    pitch, belts and density make it.
    """
    bounds = {
        "power_at_design_kW": (1.0 - FAN_APART, 1.0 + FAN_APART),
        "rated_power_kW": (LEAST_LOAD, FAR["hp"]),
    }
    for key, (low, high) in bounds.items():
        rated = _power_kW(path, sheet, key)
        if rated is None or full_kW <= 0.0 or low <= full_kW / rated <= high:
            continue
        ratio = full_kW / rated
        unit = "W" if ratio > FAR["W"] else "hp" if ratio > 1.0 else "MW" if ratio < 1.0 / FAR["W"] else "another unit"
        raise RecordError(
            f"{points}: cell {cell} has a fan of {full_kW:.3g} kW at full speed, but fan.{key} of {path} is "
            f"{rated:g}; is fan_power_kW in {unit}? correct one of the two"
        )


def _power_kW(path: Path, sheet: dict[str, Any], key: str) -> float | None:
    """Return a power of a fan by the datasheet, kW; None where it is not given."""
    fan = sheet.get("fan")
    rated = fan.get(key) if isinstance(fan, dict) else None
    if rated is None:
        return None
    if not isinstance(rated, int | float) or not rated > 0.0:
        raise RecordError(f"{path}: fan.{key} is {rated!r}; give a number above 0, or leave it out")
    return float(rated)


def _pressures(path: Path, datasheet: Path, design: dict[str, Any], points: TestPoints) -> list[str]:
    """Return a sentence where nothing tells the air pressure, or the test points have another one than the site."""
    middle = float(np.median(points.inputs.pressure))
    if "pressure_kPa" not in design:
        if bool((points.inputs.pressure == SEA_LEVEL_KPA).all()):
            return [
                f"neither {path.name} nor {datasheet.name} gives the air pressure; {SEA_LEVEL_KPA:g} kPa is taken, "
                f"that of sea level: write design.pressure_kPa into the datasheet"
            ]
        return []
    site = float(design["pressure_kPa"])
    if abs(middle / site - 1.0) <= SITE_PRESSURE:
        return []
    return [
        f"the test points have {middle:.4g} kPa in the median and design.pressure_kPa of {datasheet.name} is {site:g}; "
        f"correct one of the two"
    ]


def _number(path: Path, line: int, name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        what = "empty" if not text.strip() else f"{text!r}, which is no number"
        remedy = "write decimals with a point" if "," in text else "give the value that was measured"
        raise RecordError(f"{path}:{line}: {name} is {what}; {remedy}")
    return value


def _value(path: Path, line: int, name: str, text: str, site_kPa: float) -> float:
    if name in OPTIONAL and not text.strip():
        return site_kPa if name == "pressure_kPa" else math.nan
    value = _number(path, line, name, text)
    low, high = RANGES.get(name, (-math.inf, math.inf))
    if not low <= value <= high:
        hint = next((words for end, words in HINTS.items() if name.endswith(end)), "check its unit")
        raise RecordError(f"{path}:{line}: {name} is {value:g}, outside {low:g} to {high:g}; {hint}")
    return value


def _refuse_impossible(path: Path, line: int, row: dict[str, float]) -> None:
    """Raise RecordError for a point that no cooling tower can have."""
    t_in, t_out, wet, dry = (row[k] for k in ("water_inlet_C", "water_outlet_C", "entering_wet_bulb_C", "dry_bulb_C"))
    if t_out >= t_in:
        raise RecordError(
            f"{path}:{line}: the outlet, {t_out:g} degC, is not below the inlet, {t_in:g} degC; are they swapped?"
        )
    if t_out < wet - WET_BULB_MARGIN_K:
        raise RecordError(
            f"{path}:{line}: the outlet, {t_out:g} degC, is below the entering wet bulb, {wet:g} degC; correct one"
        )
    if wet > dry + WET_BULB_MARGIN_K:
        raise RecordError(
            f"{path}:{line}: the wet bulb, {wet:g} degC, is above the dry bulb, {dry:g} degC; are they swapped?"
        )


def _listed(cells: set[int]) -> str:
    return ", ".join(f"cell {n}" for n in sorted(cells)) or "none"
