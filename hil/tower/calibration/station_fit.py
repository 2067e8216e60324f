"""Calibration of a station's cells on an aligned record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hil.record import RecordError
from hil.tower.calibration.prepared_cells import PreparedCell, prepare_cells
from hil.tower.calibration.shared_water import joined_by_basin, joined_by_makeup
from hil.tower.station import CellRecord, StationNotes
from twin.network import Network
from twin.tower import CellModel, Minutes, Opening, Priors, time_grid
from twin.tower.calibration import Calibrated, CalibrationError, Fitted, fit_cell, predict_cell
from twin.tower.cell_observations import Label
from twin.tower.change_detection import Step, find_steps, undeclared_changes

DRIVEN = 0.25
"""Share of full fan speed above which a thermometer is watched for steps: below, free convection acts too."""


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
