"""Calibration of a station's cells on an aligned record, and its table `calibrated.parquet`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from hil.files.atomic import replacing
from hil.record.raw import RecordError
from hil.tower.record import CellRecord, StationNotes, cells_of, read_cell, read_labels, read_notes, seconds
from twin.network import Network, TwinFileError
from twin.tower.air import Array
from twin.tower.calibration import NORMAL, Calibrated, CalibrationError, calibrate_cell
from twin.tower.evidence import Label
from twin.tower.minutes import Minutes, minutes_of
from twin.tower.model import DEVIATIONS, CellModel, Site
from twin.tower.smoother import Opening, Priors
from twin.tower.twin_file import IDS, cell_of, design_of, value_of
from twin.twinfile import load

TABLE = "calibrated.parquet"
INFORMED = 0.8
"""A deviation whose posterior standard deviation is above this share of its prior's is withheld: the record hardly says it."""


@dataclass(frozen=True)
class CellResult:
    """Calibration of one cell with what it was made of."""

    cell: int
    twin: Path
    network: Network
    record: CellRecord
    minutes: Minutes
    calibrated: Calibrated
    priors: Priors
    labels: tuple[Label, ...]


def calibrate(record: Path, twins: Sequence[Path], labels: Path | None) -> tuple[list[CellResult], StationNotes]:
    """Calibrate the cells of these twins on a record.

    Raises:
        RecordError, TwinFileError: a file cannot be used, or the record cannot calibrate a cell.
    """
    loaded = _load_all(twins, record)
    notes = read_notes(record)
    found = read_labels(labels, tuple(loaded)) if labels is not None else ()
    results = []
    for cell, (path, network) in loaded.items():
        results.append(_one(record, cell, path, network, notes, tuple(label for label in found if label.cell == cell)))
    return results, notes


def _load_all(twins: Sequence[Path], record: Path) -> dict[int, tuple[Path, Network]]:
    loaded: dict[int, tuple[Path, Network]] = {}
    there = cells_of(record)
    if not there:
        raise RecordError(f"{record}: holds no cell<N>.parquet; make an aligned record with hil tower align")
    for path in twins:
        network = load(path)
        try:
            cell = cell_of(network)
        except TwinFileError as error:
            raise TwinFileError(f"{path}: {error}") from error
        if cell in loaded:
            raise TwinFileError(f"{path}: is of cell {cell}, as {loaded[cell][0]} is; give one twin for each cell")
        if cell not in there:
            cells = ", ".join(f"cell {n}" for n in there)
            raise TwinFileError(f"{path}: is of cell {cell}, which {record} does not hold; it holds {cells}: give their twins")
        loaded[cell] = (path, network)
    return loaded


def _one(record: Path, cell: int, path: Path, network: Network, notes: StationNotes, labels: tuple[Label, ...]) -> CellResult:
    minutes_read = read_cell(record, cell)
    design, share = design_of(network), value_of(network, "cell.bypass_share")
    minutes = minutes_of(minutes_read.time_s, minutes_read.columns, minutes_read.origin, design.m_w0, share)
    flow = float(np.nanmedian(minutes.operation.inputs.m_w[minutes.known])) if minutes.known.any() else np.nan
    if not minutes.known.any():
        raise RecordError(
            f"{minutes_read.path}: no minute has water above a fifth of the design flow, {design.m_w0:g} kg/s, and all inputs; "
            "is the twin of this station, and the flow in kg/s?"
        )
    if flow > 2.0 * design.m_w0:
        raise RecordError(
            f"{minutes_read.path}: the flow is {flow:.0f} kg/s at the median and the twin's design flow {design.m_w0:g} kg/s; "
            f"give the twin of this station instead of {path}"
        )
    priors = priors_of(network)
    try:
        calibrated = calibrate_cell(CellModel(design, site_of(notes, share)), minutes, priors, labels, openings_of(notes, cell))
    except CalibrationError as error:
        raise RecordError(f"{minutes_read.path}: {error}") from error
    return CellResult(cell, path, network, minutes_read, minutes, calibrated, priors, labels)


def priors_of(network: Network) -> Priors:
    """Return the priors of a twin: bounds of the deviations, and the uncertainty of the clean cell."""
    bounds = {}
    for name, identifier in IDS.items():
        low, high = network.bounds([identifier])
        bounds[name] = float(high[0] - low[0]) / 2.0
    replaced = {
        "merkel": (0.0, value_of(network, "cell.merkel_sd")), "exponent": (0.0, value_of(network, "cell.exponent_sd")),
    }  # fmt: skip
    return Priors(bounds, replaced)


def site_of(notes: StationNotes, bypass_share: float) -> Site:
    """Return the design point of a datasheet; the usual rating where it gives none."""
    design, usual = notes.datasheet.get("design", {}), Site()
    return Site(
        float(design.get("water_inlet_C", usual.inlet)), float(design.get("wet_bulb_C", usual.wet)),
        float(design.get("range_K", usual.fall)), bypass_share,
    )  # fmt: skip


def openings_of(notes: StationNotes, cell: int) -> tuple[Opening, ...]:
    """Return the jumps that the station's events open for a cell.

    Raises:
        RecordError: an event of the record has no time.
    """
    found = []
    for event in notes.events:
        if int(event.get("cell", 0)) not in (0, cell):
            continue
        try:
            start, end = seconds(event["from"]), seconds(event["to"])
        except (KeyError, ValueError, AttributeError) as error:
            raise RecordError(f"station.json: an event has no time that can be read ({error}); align the store again") from error
        found += [Opening(start, end, name) for name in event.get("parameters", ())]
    return tuple(found)


def table_of(result: CellResult) -> pa.Table:
    """Return the minutes of a cell with outlet, interval and deviations; withheld values are missing."""
    c, n = result.calibrated, len(result.minutes.time_s)
    arrays: dict[str, Any] = {
        "time": pa.array((result.minutes.time_s * 1e3).astype("datetime64[ms]"), pa.timestamp("ms", tz="UTC")),
        "cell": pa.array(np.full(n, result.cell, dtype=np.int32)),
    }
    for name, values in (("t_out", c.t_out), ("t_out_lo", c.low), ("t_out_hi", c.high), ("t_out_commissioned", c.commissioned)):
        arrays[name] = pa.array(values.astype(np.float32), from_pandas=True)
    for j, name in enumerate(DEVIATIONS):
        value, sd = withheld(result, j)
        clean = 0.0 if name == "bias" else 1.0
        for suffix, deviation in (("", 0.0), ("_lo", -NORMAL), ("_hi", NORMAL)):
            arrays[name + suffix] = pa.array((clean + value + deviation * sd).astype(np.float32), from_pandas=True)
    return pa.table(arrays)


def withheld(result: CellResult, j: int) -> tuple[Array, Array]:
    """Return a deviation and its standard deviation by minute, NaN where the record hardly says it."""
    _, prior = result.priors.slow(DEVIATIONS[j])
    value, sd = result.calibrated.deviations[:, j], result.calibrated.sd[:, j]
    told = sd <= INFORMED * prior
    return np.where(told, value, np.nan), np.where(told, sd, np.nan)


def write_table(results: Sequence[CellResult], out: Path) -> Path:
    """Write the minutes of all cells into the folder `out`, all or nothing.

    Raises:
        OSError: the folder cannot be written.
    """
    out.mkdir(parents=True, exist_ok=True)
    with replacing(out / TABLE) as unfinished:
        pq.write_table(pa.concat_tables([table_of(one) for one in results]), unfinished, compression="zstd")
    return out / TABLE
