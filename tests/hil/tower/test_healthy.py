"""`hil tower commission --healthy` and `hil bench tower` on a made record."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hil.bench.tower import compare
from hil.record import RecordError
from hil.tower.calibration.healthy import read_healthy
from hil.tower.calibration.station_fit import calibrate
from tests.hil.tower.made_plant import SHEET, files, iso, refused, run, write_points, write_record
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


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{", "is not valid JSON"),
        ("[]", "is not a JSON object"),
        ('{"format": 1}', "clean_cell is missing"),
        ('{"mean": 1}', "format is missing"),
        ('"mean": [', "is not valid JSON"),
    ],
)
def test_a_damaged_healthy_record_is_refused_with_its_file_and_remedy(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "z.healthy.json"
    path.write_text(text)
    with pytest.raises(
        RecordError, match=rf"^{re.escape(str(path))}: {says}.*; commission the cell again with --healthy"
    ):
        read_healthy(path)


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("mean", [0.0], "its constants are those of another version"),
        ("mean", "none", "mean is 'none', which is not a list"),
        ("covariance", [[1.0]], "its constants are those of another version"),
        ("covariance", [[1.0], [1.0, 2.0]], "is no healthy record"),
        ("from", "spring", "is no healthy record"),
        ("format", 1, "its constants are those of another version"),
    ],
)
def test_a_changed_healthy_record_is_refused_with_its_file(
    clean_plant: Path, tmp_path: Path, key: str, value: object, says: str
) -> None:
    (path,) = clean_plant.glob("*.healthy.json")
    changed = tmp_path / path.name
    changed.write_text(json.dumps(json.loads(path.read_text()) | {key: value}))
    with pytest.raises(RecordError, match=rf"^{re.escape(str(changed))}: .*{re.escape(says)}"):
        read_healthy(changed)


def test_the_healthy_record_of_another_clean_cell_is_refused_and_never_replaced(
    clean_plant: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "plant"
    folder.mkdir()
    write_points(folder / "points.csv", water_outlet_C=0.4)
    options = ("--datasheet", clean_plant / "datasheet.json", "--points", folder / "points.csv")
    words = ("commission", clean_plant / "record", "--cell", 1, *options, "--out")
    assert run(*words, folder / "other.toml").exit_code == 0
    (path,) = clean_plant.glob("*.healthy.json")
    content = path.read_bytes()
    (folder / path.name).write_bytes(content)
    says = refused(run("calibrate", clean_plant / "record", "--twin", folder / "other.toml", "--out", folder / "out"))
    assert f"{path.name}: is the healthy record of another clean cell than that of" in says and "other.toml" in says
    says = refused(run(*words, folder / "third.toml", "--healthy", SPAN))
    assert "is a healthy record already, which another twin uses" in says and "take it away" in says
    assert (folder / path.name).read_bytes() == content and not (folder / "third.toml").exists()


def test_a_twin_whose_healthy_record_cannot_be_written_is_not_left_alone(
    clean_plant: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import errno
    import os

    from hil.tower.calibration import healthy as module

    def read_only(_: Path) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(module, "replacing", read_only)
    words = ("--out", tmp_path / "cell1.toml", "--healthy", SPAN)
    done = run("commission", clean_plant / "record", "--cell", 1, *files(clean_plant), *words)
    assert "Read-only file system; choose a place that can be written" in str(done.exception)
    assert list(tmp_path.iterdir()) == []


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
