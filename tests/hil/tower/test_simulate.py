"""`hil tower simulate` and `hil tower serve`: options, files and refusals."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from drivers.virtual.tower import STATION_FILES
from drivers.virtual.tower.effects import EFFECTS
from hil.cli.tower_commands import serve, simulate


def test_stations_are_written_where_asked_with_truth_only_for_scoring(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("HIL_DATA", raising=False)
    options = ["--out", str(tmp_path), "--months", "0.1", "--cells", "3", "--hide", "solar"]
    result = CliRunner().invoke(simulate.command, [*options, "--score"], catch_exceptions=False)
    assert result.exit_code == 0
    assert "stationB: 3 days, 1 of 2 cells recorded" in result.stdout
    key = json.loads((tmp_path / "KEY.json").read_text())
    assert key["stationA"]["answer"]["kind"] == "solar"
    assert (tmp_path / "stationA" / "truth.parquet").exists()
    (tmp_path / "stationA" / "rig.toml").write_text("of hil tower serve")
    assert CliRunner().invoke(simulate.command, options, catch_exceptions=False).exit_code == 0
    left = {path.name for path in (tmp_path / "stationA").iterdir()}
    assert left == set(STATION_FILES) - {"truth.parquet"} | {"rig.toml"} and not (tmp_path / "KEY.json").exists()


def test_effects_of_the_command_are_those_of_the_plant() -> None:
    assert tuple(EFFECTS) == simulate.EFFECTS


def test_a_beginning_after_the_record_is_refused(folder_of_station: Path) -> None:
    result = CliRunner().invoke(serve.command, [str(folder_of_station), "--from", "2030-01-01"])
    assert result.exit_code == 2
    assert "begin before with --from" in result.output


@pytest.fixture
def folder_of_station(tmp_path: Path) -> Path:
    """Return a station folder with one tag."""
    import datetime

    import pyarrow as pa
    import pyarrow.parquet as pq

    start = datetime.datetime(2022, 5, 1, tzinfo=datetime.UTC)
    times = [start + datetime.timedelta(minutes=k) for k in range(3)]
    table = pa.table(
        {
            "timestamp": pa.array(times, pa.timestamp("ms", tz="UTC")),
            "tag": ["T"] * 3,
            "value": [20.0, 21.0, 22.0],
            "quality": pa.array([192] * 3, pa.int16()),
        }
    )
    pq.write_table(table, tmp_path / "raw.parquet")
    (tmp_path / "tags.csv").write_text(
        "tag,description,unit,cell,role,scan_s\nT,x,degC,1,water_outlet_temperature,60\n"
    )
    return tmp_path
