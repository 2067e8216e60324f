"""Windows of a calibrated cell for the network: channels, memory of the healthy record, and recursive beliefs.

A belief knows readings before its window alone, so the network's answers do not know the smoother's result.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.record import RecordError
from hil.tower.calibration import (
    CellResult,
    Healthy,
    healthy_of,
    load_all,
    openings_of,
    site_of,
)
from hil.tower.station import StationNotes, events_of, iso, read_cell, read_channels, read_notes
from twin.calibrators.hiera_unet import HieraError
from twin.network import Network
from twin.tower import DAY_S, DEVIATIONS, Array, CellModel, blocks_of, design_of, effects_of, filter_cell, value_of
from twin.tower.calibration import CalibrationError, fit_cell

if TYPE_CHECKING:
    from twin.calibrators.hiera_unet.tower import CellTable

SCALES = {
    "design": ("water_inlet_C", "water_outlet_C", "wet_bulb_C", "pressure_kPa"),
    "fan": ("rated_power_kW", "power_at_design_kW"),
    "fill": ("length_m", "width_m", "height_m"),
}
"""Numbers of the datasheet that channels and static numbers are scaled by, by section."""


def windows_table(result: CellResult, notes: StationNotes) -> tuple[CellTable, int]:
    """Return the network's table of a cell from the healthy record on, and the row of the record at which it begins.

    Raises
    ------
    HieraError
        The twin has no healthy record, the record does not hold it, holds less than a day after it, lacks minutes, or
        has no window.
    RecordError
        An event cannot be read, or the datasheet lacks a number.
    """
    from twin.calibrators.hiera_unet.tower import commissioned_log_power, commissioned_outlet
    from twin.calibrators.hiera_unet.tower.cell_table import CellSources, cell_table

    path = result.record.path
    sheet = _sheet(notes, path)
    healthy = _healthy(path, result.minutes.time_s, result.twin, result.network)
    model = CellModel(
        design_of(result.network),
        site_of(notes, value_of(result.network, "cell.bypass_share")),
        effects_of(result.network),
    )
    first = int(np.searchsorted(result.minutes.time_s, healthy.start_s))
    minutes = result.minutes.part(slice(first, len(result.minutes.time_s)))
    until = int(np.searchsorted(minutes.time_s, healthy.end_s))
    openings = openings_of(notes, result.cell)
    early = [one for one in result.labels if one.time_s <= healthy.end_s]
    try:
        posterior = fit_cell(
            model,
            minutes.part(slice(0, until)),
            result.priors,
            early,
            [one for one in openings if one.start_s < healthy.end_s],
        ).posterior
    except CalibrationError as error:
        raise HieraError(f"{path}: its healthy span {error}", code="NO_HEALTHY_RECORD") from error
    blocks, _ = blocks_of(minutes)
    beliefs = filter_cell(model, minutes, blocks, result.priors, posterior, healthy.end_s, result.labels, openings)
    columns = {name: values[first:] for name, values in read_channels(path).items()}
    unknown = np.full(len(minutes.time_s), np.nan)
    table = cell_table(
        CellSources(
            name=f"cell{result.cell}",
            sheet=sheet,
            columns=columns,
            minutes=minutes,
            design=model.design,
            clean=commissioned_outlet(model, minutes),
            log_clean=commissioned_log_power(model, minutes),
            beliefs=beliefs,
            events=[one for one in events_of(notes.events) if one.cell in (0, result.cell)],
            healthy_end_s=healthy.end_s,
            true_water=unknown,
            true=np.full((len(unknown), len(DEVIATIONS)), np.nan),
        )
    )
    if not table.valid.any():
        raise HieraError(
            f"{path}: no window of two hours after {iso(healthy.end_s)} has all inputs and two hours of "
            "steady blocks in the day before; give a record in which the cell runs",
            code="NO_WINDOW",
        )
    return table, first


def check_cells(record: Path, twins: Sequence[Path]) -> None:
    """Check that the network can read the cells of a record, before a calibration that takes minutes.

    Raises
    ------
    HieraError, RecordError, TwinFileError
        As `windows_table`, or a file cannot be used.
    """
    notes = read_notes(record)
    for cell, (twin, network) in load_all(twins, record).items():
        path = record / f"cell{cell}.parquet"
        _sheet(notes, path)
        _healthy(path, read_cell(record, cell).time_s, twin, network)


def _healthy(path: Path, time_s: Array, twin: Path, network: Network) -> Healthy:
    """Return the healthy record of a cell's twin, which the record `path` has to hold."""
    found = healthy_of(twin, network)
    if found is None:
        raise HieraError(
            f"{twin} has no healthy record, which the network reads as its memory of the plant; commission the cell "
            "again with `hil tower commission --healthy FROM..TO`",
            code="NO_HEALTHY_RECORD",
        )
    first, last = float(time_s[0]), float(time_s[-1])
    holes = np.flatnonzero(np.diff(time_s) != 60.0)
    if len(holes):
        raise HieraError(
            f"{path} goes from {iso(time_s[holes[0]])} to {iso(time_s[holes[0] + 1])} without the minutes between, and "
            "the network reads a row a minute; align the store again",
            code="GAPS",
        )
    if found.start_s < first - DAY_S / 2.0 or found.end_s > last:
        raise HieraError(
            f"{path} runs from {iso(first)} to {iso(last)} and does not hold the healthy span of {twin}, "
            f"{iso(found.start_s)} to {iso(found.end_s)}; give a record that begins with it",
            code="NO_HEALTHY_RECORD",
        )
    if last - found.end_s < DAY_S:
        raise HieraError(
            f"{path}: holds {(last - found.end_s) / 3600.0:.1f} h after the healthy span; the network needs 24 h",
            code="SHORT_RECORD",
        )
    return found


def _sheet(notes: StationNotes, path: Path) -> dict[str, Any]:
    """Return the datasheet of a record, which has all numbers that channels are scaled by."""
    sheet = notes.datasheet
    lacking = [f"{part}.{n}" for part, names in SCALES.items() for n in names if not _number(sheet.get(part), n)]
    if not _number(sheet, "cells_in_station"):
        lacking.append("cells_in_station")
    if lacking:
        raise RecordError(
            f"{path.parent / 'station.json'}: the datasheet has no number {', '.join(lacking)}, by which the network "
            "scales its channels; add it to the datasheet and align again"
        )
    return sheet


def _number(part: object, name: str) -> bool:
    """Return True if a section of a datasheet has a number of this name."""
    value = part.get(name) if isinstance(part, Mapping) else None
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))
