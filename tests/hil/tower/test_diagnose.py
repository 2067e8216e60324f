"""`hil diagnose` on a tower's aligned record, adoption by its twin, and `hil review` of its calibration."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from hil.cli.verbs import group
from hil.tower import diagnose_station, document
from tests.hil.tower.made_plant import SHEET, files, refused, write_points
from tests.twin.tower.made_cell import Made
from tests.twin.tower.made_effect import weathered, with_recirculation


def hil(*words: Any) -> Any:
    return CliRunner().invoke(group, [str(word) for word in words])


def write(folder: Path, made: Made) -> None:
    """Write a record of cell 1 as the alignment does."""
    folder.mkdir()
    arrays = {"time": pa.array((made.time_s * 1e3).astype("datetime64[ms]"), pa.timestamp("ms", tz="UTC"))}
    arrays |= {n: pa.array(v.astype(np.uint8) if n in ("regime", "check") else v) for n, v in made.columns.items()}
    arrays |= {f"{n}_how": pa.array(v) for n, v in made.origin.items() if n not in ("regime", "check")}
    about = {"hil.tower": json.dumps({"format": 1, "cell": 1, "station": "Z"})}
    pq.write_table(pa.table(arrays).replace_schema_metadata(about), folder / "cell1.parquet")
    (folder / "station.json").write_text(json.dumps({"datasheet": {**SHEET, "timezone": "UTC"}, "events": []}))


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record with hidden recirculation, and the commissioned twin."""
    root = tmp_path_factory.mktemp("plant")
    write(root / "record", with_recirculation(weathered(12.0, 31), 0.15, 300.0))
    (root / "datasheet.json").write_text(json.dumps(SHEET))
    write_points(root / "points.csv")
    done = hil("tower", "commission", root / "record", "--cell", 1, *files(root), "--out", root / "cell1.toml")
    assert done.exit_code == 0, done.output
    return root


def test_diagnosis_names_the_effect_adopts_it_and_the_grown_twin_calibrates(plant: Path) -> None:
    out = plant / "found"
    done = hil("diagnose", plant / "record", "--twin", plant / "cell1.toml", "--out", out)
    assert done.exit_code == 1, done.output + repr(done.exception)
    told = json.loads((out / "diagnosis.json").read_text())
    (effect,) = told["effects"]
    assert (effect["kind"], effect["driver"], effect["cell"]) == ("recirculation", "wind_direction", 1)
    assert effect["time"] is None and abs(effect["from_deg"] - 300.0) < 15.0
    assert effect["error_K"]["after_without_offset"] < 0.9 * effect["error_K"]["before_without_offset"]
    (revision,) = map(Path, told["revisions"])
    log = hil("twin", "log", revision)
    assert log.exit_code == 0 and "recirculation" in log.output
    calibrated = hil("tower", "calibrate", plant / "record", "--twin", revision, "--out", plant / "out")
    assert calibrated.exit_code == 0, calibrated.output + repr(calibrated.exception)
    again = hil("diagnose", plant / "record", "--twin", revision, "--out", plant / "again", "--dry")
    assert again.exit_code == 0, again.output
    assert not (plant / "again").exists()
    review = hil("review", plant / "out")
    assert review.exit_code == 0, review.output + repr(review.exception)
    assert (plant / "out" / "review.rrd").stat().st_size > 10_000


def test_a_step_in_the_weeks_that_no_fit_sees_hides_no_effect(plant: Path) -> None:
    made = with_recirculation(weathered(12.0, 31), 0.15, 300.0)
    made.columns["t_out_C"] += 0.6 * (made.time_s > made.time_s[0] + 6.0 * 86400.0)  # no reading is seen about it
    write(plant / "stepped", made)
    told = document(diagnose_station(plant / "stepped", [plant / "cell1.toml"], None))
    (effect,) = told["effects"]
    assert (effect["kind"], effect["driver"]) == ("recirculation", "wind_direction")
    assert effect["log_odds"] > 30.0  # 12 with a walk of the bias that bends over the step


def test_options_of_a_loop_and_a_missing_twin_are_refused_by_a_sentence(plant: Path, tmp_path: Path) -> None:
    record, twin = plant / "record", plant / "cell1.toml"
    assert "--twin" in refused(hil("diagnose", record))
    assert "--at-rest" in refused(hil("diagnose", record, "--twin", twin, "--at-rest"))
    assert "no calibrated.parquet" in refused(hil("review", record))
    broken = tmp_path / "out"
    broken.mkdir()
    (broken / "calibrated.parquet").write_text("no table")
    assert "no table of hil tower calibrate" in refused(hil("review", broken))
    assert "hil tower align" in refused(hil("diagnose", broken, "--twin", twin))
    short = tmp_path / "record"
    shutil.copytree(record, short)
    table = pq.read_table(record / "cell1.parquet")
    pq.write_table(table.slice(0, 500), short / "cell1.parquet")
    assert "longer record" in refused(hil("diagnose", short, "--twin", twin))
