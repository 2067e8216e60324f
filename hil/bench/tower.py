"""Bench of a tower's calibration: baselines on the same windows, errors against readings that were hidden from them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from hil.bench.measure.report import Cell, Table
from hil.record.raw import RecordError
from hil.tower.calibrate import CellResult, calibrate, openings_of, site_of
from twin.tower.baselines import BASELINES, Case, split, without_discrepancy
from twin.tower.model import DEVIATIONS, CellModel
from twin.tower.smoother import estimate
from twin.tower.twin_file import design_of, value_of

COLUMNS = ("method", "MAE K", "RMSE K", "p90 K", "CPU s")
NOTES = (
    "training: the first 9/14 of the record; test: its last 3/14, at least a day later; a window is two hours, its "
    "readings hidden",
    "the last row knows readings after a window as well; all others know those before it alone",
)


PARAMETERS = ("method", "cell", "fill %", "air %", "uniformity %", "bias K")


def compare(
    record: Path, twins: Sequence[Path], labels: Path | None, truth: Path | None = None
) -> tuple[list[Table], list[str]]:
    """Return a table of each cell's baselines, and a sentence for each that was left out.

    Raises:
        RecordError, TwinFileError: a file cannot be used.
    """
    results, notes = calibrate(record, twins, labels)
    true = _truth(truth) if truth is not None else None
    tables, skipped, errors = [], [], []
    for result in results:
        share = value_of(result.network, "cell.bypass_share")
        model = CellModel(design_of(result.network), site_of(notes, share))
        blocks = result.calibrated.blocks
        train, test = split(blocks)
        case = Case(model, blocks, result.priors, result.labels, openings_of(notes, result.cell), train, test)
        rows = []
        for name, baseline in BASELINES.items():
            began = time.process_time()
            try:
                error = (baseline(case) - blocks.outlet)[test]
            except ImportError:
                skipped.append(f"{name}: scikit-learn is not installed; install the extra ml")
                continue
            rows.append(_row(name, error, time.process_time() - began))
        rows.append(_row("smoothed over the record", _smoothed(result)[test], None))
        about = f"Outlet readings of cell {result.cell}, {int(test.sum())} blocks of ten minutes that no fit saw"
        if true is not None:
            plain = estimate(
                model,
                blocks,
                without_discrepancy(result.priors),
                result.labels,
                case.openings,
                result.calibrated.posterior.edges_s,
            )
            clean = np.zeros((len(blocks.time_s), len(DEVIATIONS)))
            ways = {
                "commissioned": clean, "Gauss-Newton MAP": plain.slow[plain.cells_at(blocks.time_s), :4],
                "with discrepancy": result.calibrated.posterior.slow[plain.cells_at(blocks.time_s), :4],
            }  # fmt: skip
            errors += [_parameter_row(name, result.cell, blocks.time_s, values, true) for name, values in ways.items()]
        tables.append(Table(f"cell{result.cell}", about, COLUMNS, tuple(rows), NOTES))
    if errors:
        tables.append(
            Table("parameters", "Mean absolute error of the deviations against the truth", PARAMETERS, tuple(errors))
        )
    return tables, skipped


def _truth(path: Path) -> dict[str, np.ndarray]:
    """Return the columns of a truth: time, cell, fill, air, uniformity, bias.

    Raises:
        RecordError: the file cannot be read or lacks a column.
    """
    try:
        table = pq.read_table(path, columns=["time", "cell", *DEVIATIONS])
    except (OSError, ValueError, KeyError) as error:
        raise RecordError(f"{path}: is no truth with time, cell and {', '.join(DEVIATIONS)} ({error})") from error
    found = {name: np.asarray(table[name].to_numpy(), dtype=np.float64) for name in ("cell", *DEVIATIONS)}
    found["time"] = table["time"].to_numpy().astype("datetime64[ms]").astype(np.float64) / 1e3
    return found


def _parameter_row(
    name: str, cell: int, time_s: np.ndarray, values: np.ndarray, true: dict[str, np.ndarray]
) -> tuple[Cell, ...]:
    rows = true["cell"] == cell
    found: list[float] = []
    for j, deviation in enumerate(DEVIATIONS):
        known = np.interp(time_s, true["time"][rows], true[deviation][rows]) - (0.0 if deviation == "bias" else 1.0)
        found.append(float(np.abs(values[:, j] - known).mean()) * (1.0 if deviation == "bias" else 100.0))
    return (name, cell, *found)


def _smoothed(result: CellResult) -> np.ndarray:
    """Return the errors of the record's own calibration at the blocks: each window's readings hidden, those after it
    not."""
    c, m, b = result.calibrated, result.minutes, result.calibrated.blocks
    there = np.isfinite(c.t_out)
    reading = np.interp(b.time_s, m.time_s[there], (c.t_out + c.deviations[:, 3])[there])
    return np.asarray(reading - b.outlet)


def _row(name: str, error: np.ndarray, seconds: float | None) -> tuple[Cell, ...]:
    there = error[np.isfinite(error)]
    if not len(there):
        return (name, None, None, None, seconds)
    size = np.abs(there)
    return (name, float(size.mean()), float(np.sqrt(np.mean(there**2))), float(np.quantile(size, 0.9)), seconds)
