"""`hil bench tower --steps`: steps of a thermometer are found in time, and the refit calls none of them fouling."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from hil.bench.tower_steps import try_steps
from hil.cli.verbs import group
from hil.record.raw import RecordError
from tests.hil.tower.made_plant import SHEET, files, run, write_points, write_record


@pytest.fixture(scope="module")
def station(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("steps")
    write_record(root / "record", days=9)
    (root / "datasheet.json").write_text(json.dumps(SHEET))
    write_points(root / "points.csv")
    done = run("commission", root / "record", "--cell", 1, *files(root), "--out", root / "cell1.toml")
    assert done.exit_code == 0, done.output
    return root


def test_a_step_too_small_to_see_is_reported_as_missed(station: Path) -> None:
    (trial,) = try_steps(station / "record", [station / "cell1.toml"], 1, 0.02, seed=1)
    assert trial.after_min is None and trial.kind == "none"


def test_the_command_prints_counts_and_writes_them(station: Path, tmp_path: Path) -> None:
    words = ["bench", "tower", station / "record", "--twin", station / "cell1.toml", "--steps", 2, "--out", tmp_path]
    done = CliRunner().invoke(group, [str(word) for word in words])
    assert done.exit_code == 0, done.output
    tables = json.loads((tmp_path / "tower_steps.json").read_text())["tables"]
    counts = dict(tables["steps"]["rows"])
    assert counts["steps"] == 2 and counts["found within 18 min"] == 2 and counts["called fouling by the refit"] == 0
    assert len(tables["trials"]["rows"]) == 2


def test_a_record_without_steady_hours_is_refused(tmp_path: Path, station: Path) -> None:
    write_record(tmp_path / "short", days=6)
    with pytest.raises(RecordError, match="no cell runs steadily for 8 h between the first 5 and the last 2 days"):
        try_steps(tmp_path / "short", [station / "cell1.toml"], 1, 0.5, seed=0)
