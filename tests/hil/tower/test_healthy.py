"""`hil tower commission --healthy` and `hil bench tower` on a made record."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hil.bench.tower import compare
from hil.tower.calibration.healthy import read_healthy
from hil.tower.calibration.station_fit import calibrate
from tests.hil.tower.test_calibrate import SHEET, files, iso, refused, run, write_points, write_record
from tests.twin.tower.made_cell import made_cell

BEGIN = float(made_cell(0.1).time_s[0])
SPAN = f"{iso(BEGIN)[:10]}..{iso(BEGIN + 3 * 86400)[:10]}"


@pytest.fixture(scope="module")
def clean_plant(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the record of a cell that is clean at first, and its twin with a healthy record."""
    root = tmp_path_factory.mktemp("clean")
    write_record(root / "record", fill=(1.0, 0.99), air=1.0, bias=0.0)
    (root / "datasheet.json").write_text(json.dumps(SHEET))
    write_points(root / "points.csv")
    done = run(
        "commission", root / "record", "--cell", 1, *files(root), "--out", root / "cell1.toml", "--healthy", SPAN
    )
    assert done.exit_code == 0, done.output + repr(done.exception)
    return root


def test_commissioning_keeps_the_healthy_record_beside_the_twin(clean_plant: Path) -> None:
    (path,) = clean_plant.glob("*.healthy.json")
    healthy = read_healthy(path)
    assert healthy is not None
    assert np.linalg.eigvalsh(healthy.covariance).min() > 0.0
    assert iso(healthy.start_s)[:10] == SPAN[:10]


def test_the_healthy_record_narrows_the_deviations_of_the_calibration(clean_plant: Path) -> None:
    twin = clean_plant / "cell1.toml"
    with_it, _ = calibrate(clean_plant / "record", [twin], None)
    (path,) = clean_plant.glob("*.healthy.json")
    hidden = path.rename(path.with_suffix(".off"))
    try:
        without, _ = calibrate(clean_plant / "record", [twin], None)
    finally:
        hidden.rename(path)
    assert with_it[0].calibrated.sd[-1, 0] < 0.6 * without[0].calibrated.sd[-1, 0]
    error = np.abs(with_it[0].calibrated.deviations[-1, 0] + 0.01)
    assert error < 2.0 * with_it[0].calibrated.sd[-1, 0]


@pytest.mark.parametrize(
    ("span", "says"),
    [("yesterday", "no span"), (f"{SPAN[:10]}..{SPAN[:10]}", "shorter"), ("1999-01-01..1999-01-09", "holds no minute")],
)
def test_a_healthy_span_that_cannot_be_used_is_refused(clean_plant: Path, tmp_path: Path, span: str, says: str) -> None:
    done = run(
        "commission",
        clean_plant / "record",
        "--cell",
        1,
        *files(clean_plant),
        "--out",
        tmp_path / "c.toml",
        "--healthy",
        span,
    )
    assert says in refused(done)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("text", ["{", "[]", '{"format": 1}'])
def test_a_damaged_healthy_record_is_refused_with_its_file(tmp_path: Path, text: str) -> None:
    path = tmp_path / "z.healthy.json"
    path.write_text(text)
    with pytest.raises(Exception, match=str(path)):
        read_healthy(path)


def test_the_bench_scores_outlet_and_deviations_against_the_truth(clean_plant: Path) -> None:
    made = made_cell(6, seed=21, fill=(1.0, 0.99), air=1.0, bias=0.0)
    n = len(made.time_s)
    columns = {
        "time": pa.array((made.time_s * 1e3).astype("datetime64[ms]")),
        "cell": np.ones(n, dtype=np.int8),
        "running": np.ones(n, dtype=bool),
        "uniformity": np.ones(n),
        **made.truth,
    }
    pq.write_table(pa.table(columns), clean_plant / "truth.parquet")
    tables, _ = compare(clean_plant / "record", [clean_plant / "cell1.toml"], None, clean_plant / "truth.parquet")
    by_key = {table.key: table for table in tables}
    assert {"cell1", "parameters", "outlet", "deviations", "withheld", "goals", "gains", "changes", "cost"} <= set(
        by_key
    )
    everything = by_key["outlet"].rows[0]
    assert everything[1] == "all" and isinstance(everything[2], int) and everything[2] > 5000
    assert float(everything[4] or 9.0) < 0.15
    assert {row[2] for row in by_key["goals"].rows} <= {"yes", "no"}
    assert {row[3] for row in by_key["gains"].rows} <= {"yes", "no", "not measured"}
