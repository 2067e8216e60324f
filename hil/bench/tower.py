"""Bench of a tower's calibration: baselines on the same windows, errors against readings that were hidden from them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hil.bench.measure.report import Cell, Table
from hil.tower.calibrate import CellResult, calibrate, openings_of, site_of
from twin.tower.baselines import BASELINES, Case, split
from twin.tower.model import CellModel
from twin.tower.twin_file import design_of, value_of


COLUMNS = ("method", "MAE K", "RMSE K", "p90 K", "CPU s")
NOTES = (
    "training: the first 9/14 of the record; test: its last 3/14, at least a day later; a window is two hours, its readings hidden",
    "the last row knows readings after a window as well; all others know those before it alone",
)


def compare(record: Path, twins: Sequence[Path], labels: Path | None) -> tuple[list[Table], list[str]]:
    """Return a table of each cell's baselines, and a sentence for each that was left out.

    Raises:
        RecordError, TwinFileError: a file cannot be used.
    """
    results, notes = calibrate(record, twins, labels)
    tables, skipped = [], []
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
        tables.append(Table(f"cell{result.cell}", about, COLUMNS, tuple(rows), NOTES))
    return tables, skipped


def _smoothed(result: CellResult) -> np.ndarray:
    """Return the errors of the record's own calibration at the blocks: each window's readings hidden, those after it not."""
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
