"""Report of a calibration beside the truth of a simulated station: table of errors and picture of a cell."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hil.record.raw import RecordError
from hil.tower.calibration.picture import draw_cell
from hil.tower.calibration.truth import TruthColumns, compare, read_truth

N = 3 * 1440
TIME = np.datetime64("2023-06-01", "ms") + np.arange(N).astype("timedelta64[m]")


def calibrated(error: float) -> TruthColumns:
    """Return a calibration whose outlet is off by `error` K, and its fill by 2 %."""
    columns: TruthColumns = {"time": TIME, "t_out": np.full(N, 25.0 + error), "t_out_commissioned": np.full(N, 26.0)}
    columns |= {"t_out_lo": columns["t_out"] - 0.2, "t_out_hi": columns["t_out"] + 0.2}
    for name, value in (("fill", 0.92), ("air", 1.0), ("uniformity", 1.0), ("bias", 0.1)):
        columns |= {
            name: np.full(N, value),
            f"{name}_lo": np.full(N, value - 0.05),
            f"{name}_hi": np.full(N, value + 0.05),
        }
    return columns


def truth(running: bool = True) -> TruthColumns:
    """Return the truth: outlet 25 degC, fill 0.9, the rest clean; the outlet means nothing while the cell is off."""
    runs = np.full(N, running)
    runs[:100] = False
    outlet = np.where(runs, 25.0, 99.0)
    ones = np.ones(N)
    return {
        "time": TIME,
        "running": runs,
        "t_out": outlet,
        "fill": 0.9 * ones,
        "air": ones,
        "uniformity": ones,
        "bias": 0.0 * ones,
    }


def test_errors_count_while_the_cell_runs() -> None:
    row = compare({1: calibrated(0.1)}, {1: truth()})[-1]
    assert row == "| 1 | 1.00 | 0.10 | 100 % | 2.0 | 0.0 | 0.0 | 0.10 |"


def test_an_interval_that_misses_the_truth_covers_nothing() -> None:
    assert "| 0 % |" in compare({1: calibrated(0.5)}, {1: truth()})[-1]


def test_a_withheld_parameter_is_a_dash_and_a_cell_without_truth_has_no_figure() -> None:
    columns = calibrated(0.1)
    columns["fill"][:] = np.nan
    assert compare({1: columns}, {1: truth()})[-1].split(" | ")[4] == "-"
    assert compare({1: columns, 2: columns}, {1: truth()})[-1].startswith("| 2 | - | - |")
    later = {name: values.copy() for name, values in columns.items()}
    later["time"] = later["time"] + np.timedelta64(900, "D")
    for other in ({2: columns}, {1: later}):
        with pytest.raises(RecordError, match=r"no running minute of the calibrated cells [12]; give the truth of the"):
            compare(other, {1: truth()})


def test_a_table_that_is_no_truth_is_refused_with_the_missing_columns(tmp_path: Path) -> None:
    pq.write_table(pa.table({"time": TIME, "cell": np.ones(N, dtype=np.int8)}), tmp_path / "truth.parquet")
    with pytest.raises(
        RecordError, match=r"has no column running, t_out.*; use truth.parquet of hil tower simulate --score"
    ):
        read_truth(tmp_path / "truth.parquet")
    with pytest.raises(RecordError, match=r"cannot be read"):
        read_truth(tmp_path / "absent.parquet")


@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_a_cell_is_drawn_with_and_without_truth(tmp_path: Path, suffix: str) -> None:
    labels = tmp_path / "labels.csv"
    labels.write_text(
        "time,cell,parameter,kind,value,sd,lo,hi,source\n2023-06-02T15:00:00Z,1,fill,interval,,,0.85,0.95,x\n"
        "2023-06-02T15:00:00Z,1,air,point,0.98,0.02,,,x\n2023-06-02T15:00:00Z,2,air,point,0.5,0.02,,,x\n"
    )
    when = f"{TIME[2000].astype('datetime64[s]')}Z"
    cleaning = {"time": when, "cell": 1, "kind": "cleaning", "source": "CMMS", "parameters": ["fill", "uniformity"]}
    sizes = []
    for number, true in enumerate((None, truth())):
        path = tmp_path / f"cell{number}{suffix}"
        draw_cell(calibrated(0.1), path, cell=1, truth=true, labels=labels, events=(cleaning,))
        sizes.append(path.stat().st_size)
    assert min(sizes) > 10_000
    if suffix == ".svg":
        assert "<svg" in (tmp_path / "cell0.svg").read_text()[:500]
        assert (tmp_path / "cell0.svg").read_text().count("cleaning") == 2
