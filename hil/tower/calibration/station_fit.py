"""Calibration of a station's cells on an aligned record, and its table `calibrated.parquet`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from hil.files import replacing
from hil.record import RecordError
from hil.tower.calibration.healthy import known_by, path_beside, read_healthy
from hil.tower.station import (
    CellRecord,
    StationNotes,
    cells_of,
    event_entries,
    read_cell,
    read_labels,
    read_notes,
    seconds,
    station_of,
)
from twin.network import Network, TwinFileError
from twin.tower import (
    DEVIATIONS,
    IDS,
    MEASURED,
    Array,
    CellModel,
    DesignPoint,
    Minutes,
    Opening,
    Priors,
    cell_of,
    design_of,
    minutes_of,
    station_of_twin,
    time_grid,
    value_of,
)
from twin.tower.calibration import NORMAL, Calibrated, CalibrationError, Fitted, fit_cell, predict_cell
from twin.tower.cell_observations import Label
from twin.tower.change_detection import Step, find_steps, undeclared_changes
from twin.tower.diagnosis import effects_of
from twin.tower.shared_observations import Balance, Drain, with_basin, with_evaporation
from twin.twinfile import load

TABLE = "calibrated.parquet"
DRIVEN = 0.25
"""Share of full fan speed above which a thermometer is watched for steps: below, free convection acts too."""
INFORMED = 0.8
"""A deviation whose posterior standard deviation is above this share of its prior's is withheld: the record hardly
says it."""


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
    steps: tuple[Step, ...] = ()
    second: bool = False
    unused: str = ""
    """Why the station's water balance is not used, "" where it is."""
    changes: tuple[Opening, ...] = ()


def calibrate(
    record: Path, twins: Sequence[Path], labels: Path | None, events: Path | None = None
) -> tuple[list[CellResult], StationNotes]:
    """Calibrate the cells of these twins on a record.

    Raises
    ------
    RecordError, TwinFileError
        A file cannot be used, or the record cannot calibrate a cell.
    """
    drafts, notes = fitted_drafts(record, twins, labels, events)
    records = [draft.record for draft in drafts]
    fitted, second = joined_by_basin([draft.fitted for draft in drafts], records, notes)
    fitted, unused = joined_by_makeup(fitted, records, notes)
    return [
        CellResult(
            d.record.cell,
            d.twin,
            d.network,
            d.record,
            one.minutes,
            predict_cell(one),
            d.priors,
            d.labels,
            d.steps,
            d.record.cell in second,
            unused,
            d.changes,
        )
        for d, one in zip(drafts, fitted, strict=True)
    ], notes


def fitted_drafts(
    record: Path, twins: Sequence[Path], labels: Path | None, events: Path | None = None
) -> tuple[list[SeparateCellFit], StationNotes]:
    """Fit the cells of these twins one by one; raises as `calibrate`."""
    ready, notes = prepare_cells(record, twins, labels, events)
    return [_fit(one) for one in ready], notes


def prepare_cells(
    record: Path, twins: Sequence[Path], labels: Path | None, events: Path | None = None
) -> tuple[list[PreparedCell], StationNotes]:
    """Read the cells of these twins, each with what its calibration is made of; raises as `calibrate`."""
    loaded = load_all(twins, record)
    notes = read_notes(record)
    if events is not None:
        notes = replace(notes, events=event_entries(events))
    found = read_labels(labels, tuple(loaded)) if labels is not None else ()
    return [
        _prepare(record, cell, path, network, notes, tuple(label for label in found if label.cell == cell))
        for cell, (path, network) in loaded.items()
    ], notes


@dataclass(frozen=True)
class PreparedCell:
    """A cell with what its calibration is made of."""

    twin: Path
    network: Network
    record: CellRecord
    model: CellModel
    minutes: Minutes
    priors: Priors
    labels: tuple[Label, ...]
    openings: tuple[Opening, ...]
    edges_s: Array


@dataclass(frozen=True)
class SeparateCellFit:
    """A cell's fit before the basin's thermometers join it to the others."""

    twin: Path
    network: Network
    record: CellRecord
    fitted: Fitted
    priors: Priors
    labels: tuple[Label, ...]
    steps: tuple[Step, ...] = ()
    changes: tuple[Opening, ...] = ()


def joined_by_basin(
    fitted: Sequence[Fitted], records: Sequence[CellRecord], notes: StationNotes
) -> tuple[list[Fitted], set[int]]:
    """Return the fits with the basin thermometers of each compartment whose cells are all there, and the cells that
    have one."""
    joined, second = list(fitted), set()
    for cells, volume in _compartments(notes):
        at = [k for k, one in enumerate(records) if one.cell in cells]
        if len(at) != len(cells) or not at:
            continue
        if len({len(records[k].time_s) for k in at}) > 1 or "basin_C" not in records[at[0]].columns:
            continue
        drains = [_drain(joined[k], records[k]) for k in at]
        n = len(records[at[0]].time_s)
        makeup = records[at[0]].columns.get("makeup_kg_s", np.zeros(n))
        changes = [
            0.5 * (o.start_s + o.end_s) for o in openings_of(notes, records[at[0]].cell) if o.parameter == "bias"
        ]
        updated = with_basin([joined[k].posterior for k in at], drains, records[at[0]].time_s, makeup, volume, changes)
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


def load_all(twins: Sequence[Path], record: Path) -> dict[int, tuple[Path, Network]]:
    """Return file and network of each twin by its cell.

    Raises
    ------
    RecordError, TwinFileError
        A twin is of no cell of the record, or of the cell of another one.
    """
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
            raise TwinFileError(
                f"{path}: is of cell {cell}, which {record} does not hold; it holds {cells}: give their twins"
            )
        of_record, of_twin = station_of(record, cell), station_of_twin(network)
        if of_record and of_twin and of_record != of_twin:
            raise TwinFileError(
                f"{path}: is of station {of_twin!r} and {record} of station {of_record!r}; give the twins of that "
                f"station"
            )
        loaded[cell] = (path, network)
    return loaded


def _prepare(
    record: Path, cell: int, path: Path, network: Network, notes: StationNotes, labels: tuple[Label, ...]
) -> PreparedCell:
    minutes_read = read_cell(record, cell)
    design, share = design_of(network), value_of(network, "cell.bypass_share")
    effects = effects_of(network)
    minutes = minutes_of(minutes_read.time_s, minutes_read.columns, minutes_read.origin, design.m_w0, share, effects)
    flow = float(np.nanmedian(minutes.operation.inputs.m_w[minutes.known])) if minutes.known.any() else np.nan
    if not minutes.known.any():
        raise RecordError(
            f"{minutes_read.path}: no minute has water above a fifth of the design flow, {design.m_w0:g} kg/s, and "
            f"all inputs; "
            "is the twin of this station, and the flow in kg/s?"
        )
    if flow > 2.0 * design.m_w0:
        raise RecordError(
            f"OTHER_UNITS: {minutes_read.path}: the flow is {flow:.0f} kg/s at the median and the twin's design flow "
            f"{design.m_w0:g} kg/s; give the twin of this station instead of {path}, or the flow in kg/s"
        )
    healthy = read_healthy(path_beside(path, network))
    priors, stated = known_by(healthy, priors_of(network), minutes, cell)
    edges = time_grid(float(minutes.time_s[0]), float(minutes.time_s[-1]))
    model = CellModel(design, site_of(notes, share), effects)
    return PreparedCell(
        path, network, minutes_read, model, minutes, priors, (*labels, *stated), tuple(openings_of(notes, cell)), edges
    )


def _fit(one: PreparedCell) -> SeparateCellFit:
    try:
        fitted, steps, changes = fit_with_steps(
            one.model, one.minutes, one.record, one.priors, one.labels, one.openings
        )
    except CalibrationError as error:
        raise RecordError(f"{one.record.path}: {error}") from error
    return SeparateCellFit(one.twin, one.network, one.record, fitted, one.priors, one.labels, steps, changes)


def step_openings(steps: Sequence[Step]) -> tuple[Opening, ...]:
    """Return the jumps of the bias that lasting steps of a thermometer open."""
    return tuple(Opening(s.start_s, s.alarm_s, "bias") for s in steps if s.lasting and s.kind == "thermometer")


def fit_with_steps(
    model: CellModel,
    minutes: Minutes,
    record: CellRecord,
    priors: Priors,
    labels: Sequence[Label],
    openings: Sequence[Opening],
) -> tuple[Fitted, tuple[Step, ...], tuple[Opening, ...]]:
    """Fit a cell; where its thermometer has stepped, or a deviation jumped undeclared, fit it again with that opened.

    Parameters
    ----------
    model, priors
        The cell, and the priors of its deviations.
    minutes, record
        Minutes of the cell, and the record that they are from.
    labels
        Tests of the fill and of the air flow.
    openings
        Times at which the maintenance record lets a deviation jump.

    Raises
    ------
    CalibrationError
        The record has too few steady minutes.
    """
    edges = time_grid(float(minutes.time_s[0]), float(minutes.time_s[-1]))
    fitted = fit_cell(model, minutes, priors, labels, openings, edges)
    steps = thermometer_steps(fitted, record)
    known = (*openings, *step_openings(steps))
    changes = undeclared_changes(model, fitted.blocks, priors, labels, known, fitted.posterior)
    return fit_cell(model, minutes, priors, labels, (*known, *changes), edges, fitted.posterior), steps, changes


def thermometer_steps(fitted: Fitted, record: CellRecord) -> tuple[Step, ...]:
    """Return the steps of a cell's outlet thermometer; the basin's thermometer shows whether the water itself has
    stepped."""
    predicted = predict_cell(fitted)
    driven = fitted.minutes.operation.inputs.speed > DRIVEN
    rows = np.flatnonzero(
        fitted.minutes.steady & driven & np.isfinite(fitted.minutes.outlet) & np.isfinite(predicted.t_out)
    )
    residual = fitted.minutes.outlet[rows] - predicted.t_out[rows]
    second = record.columns["basin_C"][rows] - predicted.t_out[rows] if "basin_C" in record.columns else None
    return tuple(find_steps(record.time_s[rows], residual, second))


def priors_of(network: Network) -> Priors:
    """Return the priors of a twin: bounds of the deviations, and the uncertainty of the clean cell."""
    bounds = {}
    for name, identifier in IDS.items():
        low, high = network.bounds([identifier])
        bounds[name] = float(high[0] - low[0]) / 2.0
    replaced = {
        "merkel": (0.0, value_of(network, "cell.merkel_sd")),
        "exponent": (0.0, value_of(network, "cell.exponent_sd")),
    }
    return Priors(bounds, replaced)


def site_of(notes: StationNotes, bypass_share: float) -> DesignPoint:
    """Return the design point of a datasheet; the usual rating where it gives none."""
    design, usual = notes.datasheet.get("design", {}), DesignPoint()
    return DesignPoint(
        float(design.get("water_inlet_C", usual.inlet)),
        float(design.get("wet_bulb_C", usual.wet)),
        float(design.get("range_K", usual.fall)),
        bypass_share,
    )


def openings_of(notes: StationNotes, cell: int) -> tuple[Opening, ...]:
    """Return the jumps that the station's events open for a cell.

    Raises
    ------
    RecordError
        An event of the record has no time.
    """
    found = []
    for event in notes.events:
        if int(event.get("cell", 0)) not in (0, cell):
            continue
        try:
            start, end = seconds(event["from"]), seconds(event["to"])
        except (KeyError, ValueError, AttributeError) as error:
            raise RecordError(
                f"station.json: an event has no time that can be read ({error}); align the store again"
            ) from error
        found += [Opening(start, end, name) for name in event.get("parameters", ())]
    return tuple(found)


def table_of(result: CellResult) -> pa.Table:
    """Return the minutes of a cell with outlet, interval and deviations; withheld values are missing."""
    c, n = result.calibrated, len(result.minutes.time_s)
    arrays: dict[str, Any] = {
        "time": pa.array((result.minutes.time_s * 1e3).astype("datetime64[ms]"), pa.timestamp("ms", tz="UTC")),
        "cell": pa.array(np.full(n, result.cell, dtype=np.int32)),
    }
    for name, values in (
        ("t_out", c.t_out),
        ("t_out_lo", c.low),
        ("t_out_hi", c.high),
        ("t_out_commissioned", c.commissioned),
        ("t_out_measured", result.minutes.outlet),
    ):
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

    Raises
    ------
    OSError
        The folder cannot be written.
    """
    out.mkdir(parents=True, exist_ok=True)
    with replacing(out / TABLE) as unfinished:
        pq.write_table(pa.concat_tables([table_of(one) for one in results]), unfinished, compression="zstd")
    return out / TABLE
