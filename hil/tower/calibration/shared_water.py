"""Fits of a station's cells joined by the water that they share: basin thermometers and makeup."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hil.tower.calibration.prepared_cells import openings_of
from hil.tower.station import CellRecord, StationNotes
from twin.tower import MEASURED
from twin.tower.calibration import Fitted
from twin.tower.shared_observations import Balance, Drain, with_basin, with_evaporation


def joined_by_basin(
    fitted: Sequence[Fitted], records: Sequence[CellRecord], notes: StationNotes
) -> tuple[list[Fitted], set[int]]:
    """Return the fits with the basin thermometers of each compartment whose cells are all there, and the cells that
    have one.

    A compartment beside others needs the temperature of the common supply: it shows what water comes from them.
    """
    joined, second = list(fitted), set()
    compartments = _compartments(notes)
    for cells, volume in compartments:
        at = [k for k, one in enumerate(records) if one.cell in cells]
        if len(at) != len(cells) or not at:
            continue
        if len({len(records[k].time_s) for k in at}) > 1 or "basin_C" not in records[at[0]].columns:
            continue
        drains = [_drain(joined[k], records[k]) for k in at]
        n = len(records[at[0]].time_s)
        supply = records[at[0]].columns.get("supply_C", np.full(n, np.nan)) if len(compartments) > 1 else None
        makeup = records[at[0]].columns.get("makeup_kg_s", np.zeros(n))
        changes = [
            0.5 * (o.start_s + o.end_s) for o in openings_of(notes, records[at[0]].cell) if o.parameter == "bias"
        ]
        posteriors = [joined[k].posterior for k in at]
        updated = with_basin(posteriors, drains, records[at[0]].time_s, makeup, volume, changes, supply)
        for k, posterior in zip(at, updated, strict=True):
            if posterior is not joined[k].posterior:
                second.add(records[k].cell)
            joined[k] = replace(joined[k], posterior=posterior)
    return joined, second


def joined_by_makeup(
    fitted: Sequence[Fitted], records: Sequence[CellRecord], notes: StationNotes
) -> tuple[list[Fitted], str]:
    """Return the fits with the station's makeup as an observation of their evaporation, and why it is not used or
    ""."""
    columns, n = records[0].columns, len(records[0].time_s)
    if not np.isfinite(columns.get("makeup_kg_s", np.full(n, np.nan))).any():
        return list(fitted), "NO_MAKEUP"
    try:
        cells, volume = int(notes.datasheet["cells_in_station"]), float(notes.datasheet["basin"]["volume_m3"])
    except (KeyError, TypeError, ValueError):
        return list(fitted), "NO_BASIN"
    if {r.cell for r in records} != set(range(1, cells + 1)) or len({len(r.time_s) for r in records}) > 1:
        return list(fitted), "NOT_ALL_CELLS"
    water = Balance(
        records[0].time_s,
        columns["makeup_kg_s"],
        np.nan_to_num(columns.get("blowdown_kg_s", np.zeros(n))),
        columns.get("level_pct", np.full(n, np.nan)) / 100.0,
        volume,
    )
    posteriors, unused = with_evaporation(fitted, [_off(f, r) for f, r in zip(fitted, records, strict=True)], water)
    joined = [replace(one, posterior=posterior) for one, posterior in zip(fitted, posteriors, strict=True)]
    return joined, unused


def _off(fitted: Fitted, record: CellRecord) -> NDArray[np.bool_]:
    """Return the minutes in which a cell has no water."""
    flow = fitted.minutes.operation.inputs.m_w
    share = record.columns.get("in_service", np.full(len(flow), np.nan))
    return np.asarray(
        np.where(
            np.isfinite(flow),
            np.nan_to_num(flow) < 0.02 * fitted.model.design.m_w0,
            np.nan_to_num(share, nan=1.0) < 0.5,
        )
    )


def _compartments(notes: StationNotes) -> list[tuple[tuple[int, ...], float]]:
    """Return the cells and the volume, m3, of each compartment that the datasheet describes."""
    basin = notes.datasheet.get("basin", {})
    try:
        volume, count = float(basin["volume_m3"]), int(basin.get("compartments", 1))
        everything = tuple(range(1, int(notes.datasheet["cells_in_station"]) + 1))
    except (KeyError, TypeError, ValueError):
        return []
    first = tuple(int(n) for n in basin.get("first_compartment_cells", everything))
    rest = tuple(n for n in everything if n not in first)
    return (
        [(first, volume / count), (rest, volume / count)]
        if count == 2
        else [(everything, volume)]
        if count == 1
        else []
    )


def _drain(fitted: Fitted, record: CellRecord) -> Drain:
    """Return what a cell drains into its compartment; minutes without a known flow are unknown."""
    n, m = len(record.time_s), fitted.minutes
    basin = record.columns["basin_C"]
    sampled = record.origin["basin_C"] == MEASURED if "basin_C" in record.origin else np.ones(n, dtype=bool)
    share = record.columns.get("in_service", np.full(n, np.nan))
    flow = np.where(np.isfinite(m.operation.inputs.m_w), m.operation.inputs.m_w, np.where(share < 0.5, 0.0, np.nan))
    flow = np.where(flow < 0.02 * fitted.model.design.m_w0, 0.0, flow)
    return Drain(flow, record.columns["t_out_C"], basin, sampled)
