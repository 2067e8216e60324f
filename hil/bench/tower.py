"""Bench of a tower's calibration: baselines on the same windows, errors against readings that were hidden from them."""

from __future__ import annotations

import json
import resource
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from hil.bench.measure import Cell, ReportTable
from hil.bench.tower_truth import against_truth
from hil.record import RecordError
from hil.tower import CellResult, calibrate_station, openings_of, site_of
from twin.tower import (
    BASELINES,
    DAY_S,
    DEVIATIONS,
    CellDataset,
    CellModel,
    design_of,
    estimate,
    split,
    value_of,
    without_discrepancy,
)

COLUMNS = ("method", "MAE K", "RMSE K", "p90 K", "CPU s")
NOTES = (
    "training: the first 9/14 of the record; test: its last 3/14, at least a day later; a window is two hours, its "
    "readings hidden",
    "the last row knows readings after a window as well; all others know those before it alone",
)


GAINS = ("goal", "ratio", "at most", "reached")
PARAMETERS = ("method", "cell", "fill %", "air %", "uniformity %", "bias K")


def compare(
    record: Path, twins: Sequence[Path], labels: Path | None, truth: Path | None = None
) -> tuple[list[ReportTable], list[str]]:
    """Return a table of each cell's baselines, and a sentence for each that was left out.

    Raises
    ------
    RecordError, TwinFileError
        A file cannot be used.
    """
    began = time.process_time()
    results, notes = calibrate_station(record, twins, labels)
    cost = time.process_time() - began
    true = _truth(truth) if truth is not None else None
    tables, skipped, errors = [], [], []
    for result in results:
        share = value_of(result.network, "cell.bypass_share")
        model = CellModel(design_of(result.network), site_of(notes, share))
        blocks = result.calibrated.blocks
        train, test = split(blocks)
        case = CellDataset(model, blocks, result.priors, result.labels, openings_of(notes, result.cell), train, test)
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
        about = (
            f"Outlet readings of cell {result.cell}, {int(test.sum())} blocks of ten minutes of the validation segment"
        )
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
                "commissioned": clean,
                "Gauss-Newton MAP": plain.slow[plain.cells_at(blocks.time_s), :4],
                "with discrepancy": result.calibrated.posterior.slow[plain.cells_at(blocks.time_s), :4],
            }
            errors += [_parameter_row(name, result.cell, blocks.time_s, values, true) for name, values in ways.items()]
        tables.append(ReportTable(f"cell{result.cell}", about, COLUMNS, tuple(rows), NOTES))
    if errors:
        tables.append(
            ReportTable(
                "parameters", "Mean absolute error of the deviations against the truth", PARAMETERS, tuple(errors)
            )
        )
    if truth is not None:
        tables += against_truth(results, notes, truth)
        tables.append(ReportTable("gains", "Goals against Gauss-Newton", GAINS, tuple(_gains(tables))))
    tables += [_changes(results), _defects(record), _cost(results, cost)]
    return tables, skipped


def _gains(tables: Sequence[ReportTable]) -> list[tuple[Cell, ...]]:
    """Return the ratios of errors with discrepancy to those of Gauss-Newton, and whether the goals are reached."""
    found: list[tuple[Cell, ...]] = []
    for table in tables:
        rows = {(str(row[0]), row[1] if table.key == "parameters" else 0): row for row in table.rows}
        if table.key == "parameters":
            for (name, cell), row in rows.items():
                plain = rows.get(("Gauss-Newton MAP", cell))
                if name == "with discrepancy" and plain is not None:
                    found.append(_gain(f"cell {cell}: fill error, of Gauss-Newton's", row[2], plain[2], 0.5))
        elif table.columns == COLUMNS:
            plain, ours = (rows.get((name, 0)) for name in ("Gauss-Newton MAP", "Gauss-Newton MAP with discrepancy"))
            if plain is not None and ours is not None:
                found.append(_gain(f"{table.key}: outlet MAE, of Gauss-Newton's", ours[1], plain[1], 0.85))
    return found


def _gain(name: str, ours: Cell, plain: Cell, most: float) -> tuple[Cell, ...]:
    if not isinstance(ours, float) or not isinstance(plain, float) or plain <= 0.0:
        return (name, None, most, "not measured")
    return (name, ours / plain, most, "yes" if ours / plain <= most else "no")


def _changes(results: Sequence[CellResult]) -> ReportTable:
    """Return the jumps that were found: lasting steps of a thermometer, and undeclared changes, in days."""
    rows: list[tuple[Cell, ...]] = []
    for one in results:
        start = float(one.minutes.time_s[0])
        found = [(s.start_s, "bias", "step of the readings") for s in one.steps if s.lasting and s.kind != "water"]
        found += [(c.start_s, c.parameter, "smoother") for c in one.changes]
        rows += [(str(one.cell), (t - start) / DAY_S, name, source) for t, name, source in sorted(found)]
    return ReportTable("changes", "Undeclared changes that were found", ("cell", "day", "deviation", "by"), tuple(rows))


def _defects(record: Path) -> ReportTable:
    """Return the number of defects of the store by kind, as the alignment found them."""
    path = record / "alignment.json"
    try:
        found = json.loads(path.read_text())["defects"] if path.is_file() else []
        count = Counter(str(one["type"]) for one in found)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RecordError(f"{path}: cannot be read ({error}); align the store again") from error
    return ReportTable("defects", "Defects of the store", ("defect", "found"), tuple(count.most_common()))


def _cost(results: Sequence[CellResult], seconds: float) -> ReportTable:
    days = sum(len(one.minutes.time_s) for one in results) / 1440.0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2.0**20
    row = (len(results), days, seconds, peak)
    return ReportTable("cost", "Cost of the calibration", ("cells", "cell days", "CPU s", "peak GiB"), (row,))


def _truth(path: Path) -> dict[str, np.ndarray]:
    """Return the columns of a truth: time, cell, fill, air, uniformity, bias.

    Raises
    ------
    RecordError
        The file cannot be read or lacks a column.
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
