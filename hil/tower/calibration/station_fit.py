"""Calibration of a station's cells on an aligned record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.record import RecordError
from hil.tower.calibration.prepared_cells import PreparedCell, prepare_cells
from hil.tower.calibration.shared_water import joined_by_basin, joined_by_makeup
from hil.tower.station import CellRecord, StationNotes
from twin.network import Network
from twin.tower import (
    DAY_S,
    SLOW,
    WALK,
    Array,
    CellModel,
    Minutes,
    Opening,
    Priors,
    blocks_of,
    moved_grid,
    time_grid,
)
from twin.tower.calibration import (
    FEWEST_BLOCKS,
    Calibrated,
    CalibrationError,
    Fitted,
    LabelConflict,
    fit_cell,
    label_conflicts,
    predict_cell,
    widened,
    with_lasting_errors,
)
from twin.tower.cell_observations import Label
from twin.tower.change_detection import (
    Contradiction,
    Step,
    changing_rate,
    contradictory_steps,
    find_steps,
    jumping_column,
    merged,
    spans_beyond,
    undeclared_changes,
    with_fan,
)

ONLY_REST = np.array([float(name != "air") for name in SLOW])
"""Deviations without the air: an air that has followed a step hides it from the fan's power."""
HALF_DAY_S = 43200.0
"""Length of an opening up to which its time is known: the grid gets an edge there."""
ROUNDS = 3
"""Fits after the first one that leave contradictory spans out: what is left over at their edges may contradict too."""
WITNESSES = ("t_in_C", "m_w_kg_s", "fan_speed_pct", "dry_C", "wet_C", "pressure_kPa")
"""Columns of a record that the outlet is predicted from: one that jumps there is the likelier cause."""
IMPOSSIBLE = {
    8: "the outlet is above the inlet (are the tags of inlet and outlet swapped?)",
    4: "the outlet is below the wet bulb (is one of them in another unit?)",
}
"""Words of the bits of `check`."""
DRIVEN = 0.25
"""Share of full fan speed above which a cell is watched for steps and changes: below, free convection acts too, and the
twin knows it less well: hours of it are no change of the cell."""


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
    contradictions: tuple[Contradiction, ...] = ()
    """Spans of the record that contradict the rest: nothing is known of their minutes."""
    conflicts: tuple[LabelConflict, ...] = ()
    """Labels that contradict what is known without them."""


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
    fitted = [replace(one, posterior=with_lasting_errors(one.posterior)) for one in fitted]
    found = [label_conflicts(one.posterior, WALK) for one in fitted]
    fitted = [replace(one, posterior=widened(one.posterior, c)) for one, c in zip(fitted, found, strict=True)]
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
            d.contradictions,
            conflicts,
        )
        for d, one, conflicts in zip(drafts, fitted, found, strict=True)
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
    contradictions: tuple[Contradiction, ...] = ()


def _fit(one: PreparedCell) -> SeparateCellFit:
    minutes = one.minutes
    found: tuple[Contradiction, ...] = ()
    try:
        fitted, steps, changes = fit_with_steps(one.model, minutes, one.record, one.priors, one.labels, one.openings)
        for _ in range(ROUNDS):
            more = _contradictions(fitted, steps, one.priors)
            if not more:
                break
            found = merged((*found, *more))
            rest = one.minutes.without(_inside(one.minutes.time_s, found))
            if np.isfinite(blocks_of(rest)[0].outlet).sum() < FEWEST_BLOCKS:
                break
            fitted, steps, changes = fit_with_steps(one.model, rest, one.record, one.priors, one.labels, one.openings)
    except CalibrationError as error:
        raise RecordError(f"{one.record.path}: {_impossible(one) or error}") from error
    found = _witnessed(one, found)
    return SeparateCellFit(one.twin, one.network, one.record, fitted, one.priors, one.labels, steps, changes, found)


def _impossible(one: PreparedCell) -> str:
    """Return a sentence where most outlets cannot be, "" otherwise."""
    check = np.nan_to_num(one.record.columns.get("check", np.zeros(0))).astype(np.int64)
    seen = np.isfinite(one.record.columns["t_out_C"])
    if not seen.any() or not len(check):
        return ""
    for bit, words in IMPOSSIBLE.items():
        share = float(np.mean((check[seen] & bit) > 0))
        if share > 0.5:
            return f"{words} in {100.0 * share:.0f} % of its minutes; mend tags.csv and align again"
    return ""


def _contradictions(fitted: Fitted, steps: Sequence[Step], priors: Priors) -> tuple[Contradiction, ...]:
    """Return the spans in which the outlet's thermometer does what no thermometer does."""
    time_s, bound = fitted.minutes.time_s, priors.bounds["bias"]
    days = float(time_s[-1] - time_s[0]) / DAY_S
    posterior = fitted.posterior
    # Wrong steps bend the bias about them: it is judged when they are left out.
    return contradictory_steps(steps, days, bound) or spans_beyond(
        posterior.edges_s, posterior.slow[:, SLOW.index("bias")], bound
    )


def _inside(time_s: Array, spans: Sequence[Contradiction]) -> NDArray[np.bool_]:
    rows = np.zeros(len(time_s), dtype=bool)
    for one in spans:
        rows |= (time_s >= one.start_s) & (time_s <= one.end_s)
    return rows


def _witnessed(one: PreparedCell, found: tuple[Contradiction, ...]) -> tuple[Contradiction, ...]:
    """Return contradictions with the column that jumps there."""
    if not found:
        return found
    columns = {name: one.record.columns[name] for name in WITNESSES if name in one.record.columns}
    # A cell with its fan on has water: a flow that is known to be small then is itself a witness.
    u = one.minutes.operation.inputs
    running = (u.speed > DRIVEN) & (u.m_w > 0.0)
    named = jumping_column(one.minutes.time_s, running, columns, found)
    return tuple(replace(span, column=column) for span, column in zip(found, named, strict=True))


def step_openings(steps: Sequence[Step]) -> tuple[Opening, ...]:
    """Return the jumps that lasting steps open: of the bias for a thermometer, of the air for a fan."""
    opened = {"thermometer": "bias", "fan": "air"}
    return tuple(Opening(s.since_s, s.alarm_s, opened[s.kind]) for s in steps if s.lasting and s.kind in opened)


def fit_with_steps(
    model: CellModel,
    minutes: Minutes,
    record: CellRecord,
    priors: Priors,
    labels: Sequence[Label],
    openings: Sequence[Opening],
) -> tuple[Fitted, tuple[Step, ...], tuple[Opening, ...]]:
    """Fit a cell; where its thermometer has stepped, a deviation jumped undeclared, or a rate of loss changed, fit it
    again with that opened.

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
    steps, jumps = undeclared_jumps(fitted, record, priors, labels, openings)
    of_steps = step_openings(steps)
    timed = [one for one in jumps if one.parameter == "bias" or one in of_steps]
    known = [one.start_s for one in timed if one.end_s - one.start_s < HALF_DAY_S]
    edges = moved_grid(edges, known)
    opened = (*openings, *jumps)
    refitted = fit_cell(model, minutes, priors, labels, opened, edges, fitted.posterior)
    if rates := changing_rate(refitted.posterior, opened):
        refitted = fit_cell(model, minutes, replace(priors, rates=rates), labels, opened, edges, refitted.posterior)
    return refitted, steps, jumps[len(of_steps) :]


def undeclared_jumps(
    fitted: Fitted, record: CellRecord, priors: Priors, labels: Sequence[Label], openings: Sequence[Opening]
) -> tuple[tuple[Step, ...], tuple[Opening, ...]]:
    """Return the steps of a cell's outlet thermometer, and the jumps that no event announces: those that lasting steps
    open, then those of the smoother.

    Parameters
    ----------
    fitted, record
        A fit of the cell without them, and the record that it is from.
    priors, labels, openings
        Those of the fit.
    """
    steps = thermometer_steps(fitted, record)
    opened = step_openings(steps)
    known, start = (*openings, *opened), fitted.posterior
    timed = [one.start_s for one in opened if one.end_s - one.start_s < HALF_DAY_S]
    start = replace(start, edges_s=moved_grid(start.edges_s, timed))
    blocks = fitted.blocks
    driven = replace(blocks, outlet=np.where(blocks.operation.inputs.speed > DRIVEN, blocks.outlet, np.nan))
    return steps, (*opened, *undeclared_changes(fitted.model, driven, priors, labels, known, start))


def thermometer_steps(fitted: Fitted, record: CellRecord) -> tuple[Step, ...]:
    """Return the steps of a cell's outlet thermometer; the basin's thermometer shows whether the water itself has
    stepped, and the fan's power whether the air has."""
    predicted = predict_cell(fitted)
    driven = fitted.minutes.operation.inputs.speed > DRIVEN
    rows = np.flatnonzero(
        fitted.minutes.steady & driven & np.isfinite(fitted.minutes.outlet) & np.isfinite(predicted.t_out)
    )
    residual = fitted.minutes.outlet[rows] - predicted.t_out[rows]
    second = record.columns["basin_C"][rows] - predicted.t_out[rows] if "basin_C" in record.columns else None
    steps = find_steps(record.time_s[rows], residual, second)
    if not any(one.lasting for one in steps):
        return tuple(steps)
    p, o = fitted.posterior, fitted.minutes.operation.take(rows)
    twin = fitted.model.log_power(o, p.slow[p.cells_at(record.time_s[rows])] * ONLY_REST, p.constant)
    with np.errstate(divide="ignore", invalid="ignore"):
        power = np.log(fitted.minutes.power[rows]) - twin
    return tuple(with_fan(steps, record.time_s[rows], power))
