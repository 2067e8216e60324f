"""Comparison of a calibration with the truth of a simulated station.

`truth.parquet` has one row a minute and cell: time, cell, running, t_out, and fill, air, uniformity and bias. Only
`hil tower simulate --score` writes it; a plant has none.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from hil.record import RecordError

PARAMETERS = ("fill", "air", "uniformity", "bias")
TruthColumns = dict[str, NDArray[Any]]


def read_minutes(path: Path, needed: tuple[str, ...], remedy: str) -> dict[int, TruthColumns]:
    """Return the columns of a table of minutes by cell; `time` as datetime64[ms].

    Raises
    ------
    RecordError
        The file cannot be read or lacks a column; the message ends with `remedy`.
    """
    try:
        table = pq.read_table(path)
    except (OSError, pa.ArrowException) as error:
        reason = getattr(error, "strerror", None) or str(error).splitlines()[0]
        raise RecordError(f"{path}: cannot be read ({reason}); {remedy}") from error
    missing = [name for name in ("time", "cell", *needed) if name not in table.column_names]
    if missing:
        raise RecordError(f"{path}: has no column {', '.join(missing)}; {remedy}")
    for name in ("time", "cell", *needed):
        kind = table.schema.field(name).type
        number = pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind)
        if not (pa.types.is_timestamp(kind) if name == "time" else number):
            raise RecordError(
                f"{path}: column {name} holds {kind} and no {'times' if name == 'time' else 'numbers'}; {remedy}"
            )
    table = table.filter(pc.is_valid(table["cell"]))
    columns = {name: table[name].to_numpy() for name in table.column_names}
    columns["time"] = columns["time"].astype("datetime64[ms]")
    return {
        int(cell): {name: values[columns["cell"] == cell] for name, values in columns.items()}
        for cell in np.unique(columns["cell"])
    }


def read_truth(path: Path) -> dict[int, TruthColumns]:
    """Return the truth by cell.

    Raises
    ------
    RecordError
        The file cannot be read or lacks a column.
    """
    return read_minutes(path, ("running", "t_out", *PARAMETERS), "use truth.parquet of hil tower simulate --score")


def compare(
    calibrated: Mapping[int, TruthColumns],
    truth: Mapping[int, TruthColumns],
    network: Mapping[int, TruthColumns] | None = None,
) -> list[str]:
    """Return a Markdown table of the mean absolute errors against the truth: outlet by minute, parameters by day.

    Parameters
    ----------
    network
        Minutes of a network that was asked. Both calibrators are then compared on the minutes that it answered.

    Raises
    ------
    RecordError
        The truth and the calibration have no running minute in common.
    """
    asked = network or {}
    together = {cell: _minutes_together(found, truth.get(cell)) for cell, found in calibrated.items()}
    if not any(together.values()):
        cells = ", ".join(map(str, calibrated))
        raise RecordError(
            f"the truth has no running minute of the calibrated cells {cells}; give the truth of the station and "
            "months that were calibrated"
        )
    by = " calibrator |" if asked else ""
    head = (
        f"| cell |{by} outlet as commissioned K | calibrated K | within 90 % | fill % | air % | uniformity % | bias K |"
    )
    rows = [head, "|---" * (head.count("|") - 1) + "|"]
    for cell, found in calibrated.items():
        if not together[cell]:
            rows.append(f"| {cell} |{' Gauss-Newton |' if asked else ''}{' - |' * 7}")
            continue
        answer = asked.get(cell)
        if answer is None:
            rows.append(f"| {cell} |{' Gauss-Newton |' if asked else ''} {_errors(found, truth[cell])} |")
            continue
        answered = np.isfinite(answer["t_out"])
        rows.append(f"| {cell} | Gauss-Newton | {_errors(_taken(found, answer['time'][answered]), truth[cell])} |")
        rows.append(f"| {cell} | network | {_errors(_taken(answer, answer['time'][answered]), truth[cell])} |")
    return ["Mean absolute errors against the truth of the simulated station:", "", *rows]


def _minutes_together(found: TruthColumns, true: TruthColumns | None) -> int:
    """Return the number of minutes that a calibration shares with the truth while the cell runs."""
    return 0 if true is None else int(np.isin(true["time"][true["running"].astype(bool)], found["time"]).sum())


def _taken(found: TruthColumns, time: NDArray[Any]) -> TruthColumns:
    rows = np.isin(found["time"], time)
    return {name: values[rows] for name, values in found.items()}


def _errors(found: TruthColumns, true: TruthColumns) -> str:
    """Return the errors of a calibrator's minutes of a cell as the cells of a row."""
    _, mine, its = np.intersect1d(found["time"], true["time"], return_indices=True)
    runs = true["running"][its]
    mine, its = mine[runs], its[runs]
    got, real = found["t_out"][mine], true["t_out"][its]
    inside = (found["t_out_lo"][mine] <= real) & (real <= found["t_out_hi"][mine])
    known = np.isfinite(got)
    before = np.nanmean(np.abs(found["t_out_commissioned"][mine] - real)) if known.any() else np.nan
    figures = [f"{before:.2f}", f"{np.nanmean(np.abs(got - real)):.2f}" if known.any() else "-"]
    figures.append(f"{100.0 * inside[known].mean():.0f} %" if known.any() else "-")
    for name in PARAMETERS:
        figures.append(
            _daily(found["time"][mine], found[name][mine], true[name][its], 1.0 if name == "bias" else 100.0)
        )
    return " | ".join(figures)


def _daily(time: NDArray[Any], found: NDArray[Any], true: NDArray[Any], scale: float) -> str:
    """Return the mean over days of the absolute error of a daily mean, as text."""
    known = np.isfinite(found)
    if not known.any():
        return "-"
    day = time[known].astype("datetime64[D]")
    _, index, count = np.unique(day, return_inverse=True, return_counts=True)
    error = np.bincount(index, found[known] - true[known]) / count
    return f"{scale * np.abs(error).mean():.2f}" if scale == 1.0 else f"{scale * np.abs(error).mean():.1f}"
