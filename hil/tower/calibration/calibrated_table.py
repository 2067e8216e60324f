"""Table `calibrated.parquet`: minutes of the cells with outlet, interval and deviations."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from hil.files import parse_json, replacing
from hil.record import RecordError
from hil.tower.calibration.remarks import remarks_of
from hil.tower.calibration.station_fit import CellResult
from twin.tower import DEVIATIONS, Array
from twin.tower.calibration import NORMAL

TABLE = "calibrated.parquet"
REMARKS = "hil.remarks"
"""Key of the metadata that hold the sentences on contradictions, by cell."""
INFORMED = 0.8
"""A deviation whose posterior standard deviation is above this share of its prior's is left out of the table: the
record hardly informs it. Gates judge proposals, not the table."""


def table_of(result: CellResult) -> pa.Table:
    """Return the minutes of a cell with outlet, interval and deviations; NaN where the record hardly informs one."""
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
        value, sd = informed(result, j)
        clean = 0.0 if name == "bias" else 1.0
        for suffix, deviation in (("", 0.0), ("_lo", -NORMAL), ("_hi", NORMAL)):
            arrays[name + suffix] = pa.array((clean + value + deviation * sd).astype(np.float32), from_pandas=True)
    return pa.table(arrays)


def informed(result: CellResult, j: int) -> tuple[Array, Array]:
    """Return a deviation and its standard deviation by minute, NaN where the record hardly informs it, and where it is
    outside its bounds."""
    _, prior = result.priors.slow(DEVIATIONS[j])
    value, sd = result.calibrated.deviations[:, j], result.calibrated.sd[:, j]
    told = (sd <= INFORMED * prior) & (np.abs(value) <= result.priors.bounds[DEVIATIONS[j]])
    return np.where(told, value, np.nan), np.where(told, sd, np.nan)


def read_remarks(path: Path) -> dict[int, list[str]]:
    """Return the sentences on contradictions that a table holds, by cell; none of a table without any.

    Raises
    ------
    RecordError
        The file cannot be read.
    """
    try:
        found = parse_json((pq.read_schema(path).metadata or {}).get(REMARKS.encode(), b"{}"))
        return {int(cell): [str(one) for one in sentences] for cell, sentences in found.items()}
    except (OSError, pa.ArrowException, ValueError, AttributeError, TypeError) as error:
        raise RecordError(f"{path}: its remarks cannot be read ({error}); calibrate again") from error


def write_table(results: Sequence[CellResult], out: Path) -> Path:
    """Write the minutes of all cells into the folder `out`, all or nothing.

    Raises
    ------
    OSError
        The folder cannot be written.
    """
    out.mkdir(parents=True, exist_ok=True)
    table = pa.concat_tables([table_of(one) for one in results])
    remarks = {str(one.cell): remarks_of(one) for one in results}
    table = table.replace_schema_metadata({REMARKS: json.dumps(remarks)})
    with replacing(out / TABLE) as unfinished:
        pq.write_table(table, unfinished, compression="zstd")
    return out / TABLE
