"""CSV files as a store of `hil tower align`: a row a sample or a column a tag, and what is said of bad ones."""

from __future__ import annotations

import datetime
import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from tests.hil.tower.made_store import hil, written_station
from tests.twin.historian.made_station import ZONE, clean_store
from twin.historian.tags import Series


@pytest.fixture(scope="module")
def clean() -> list[Series]:
    return clean_store(np.random.default_rng(70), 4.0, cells=1)


def _stamp(time_s: float, form: str, zone: str = "UTC") -> str:
    import zoneinfo

    moment = datetime.datetime.fromtimestamp(round(time_s, 3), datetime.UTC).astimezone(zoneinfo.ZoneInfo(zone))
    return f"{moment:{form}}"


def _rows(series: list[Series], form: str = "%Y-%m-%dT%H:%M:%S.%fZ", zone: str = "UTC") -> list[tuple[str, str, float]]:
    rows = [(t, one.tag.name, v) for one in series for t, v in zip(one.time_s, one.value, strict=True)]
    return [(_stamp(t, form, zone), name, v) for t, name, v in sorted(rows)]


def _folder(tmp_path: Path, series: list[Series], text: str) -> Path:
    folder = written_station(tmp_path / "station", series)
    for path in folder.glob("*.parquet"):
        path.unlink()
    (folder / "export.csv").write_text(text)
    return folder


def _outlet(record: Path) -> np.ndarray:
    return np.asarray(pq.read_table(record / "cell1.parquet")["t_out_C"].to_numpy())


@pytest.fixture(scope="module")
def wanted(tmp_path_factory: pytest.TempPathFactory, clean: list[Series]) -> np.ndarray:
    root = tmp_path_factory.mktemp("parquet")
    assert hil("tower", "align", written_station(root / "station", clean), "--out", root / "record") == 0
    return _outlet(root / "record")


@pytest.mark.parametrize(
    ("heading", "line"),
    [
        ("timestamp,tag,value,quality", "{0},{1},{2:.6g},192"),
        ("Time;TagName;Value;Quality", "{0};{1};{2:.6g};Good"),
        ("timestamp,tag,value", "{0},{1},{2:.6g}"),
    ],
)
def test_a_row_a_sample_is_a_store(
    tmp_path: Path, clean: list[Series], wanted: np.ndarray, heading: str, line: str
) -> None:
    text = "\n".join([heading, *(line.format(*row) for row in _rows(clean))]) + "\n"
    assert hil("tower", "align", _folder(tmp_path, clean, text), "--out", tmp_path / "record") == 0
    assert np.allclose(_outlet(tmp_path / "record"), wanted, atol=1e-3, equal_nan=True)


def test_a_column_a_tag_is_a_store(tmp_path: Path, clean: list[Series], wanted: np.ndarray) -> None:
    names = [one.tag.name for one in clean]
    lines = [",".join(["time", *names])]
    for stamp, name, value in _rows(clean):
        lines.append(",".join([stamp, *(f"{value:.6g}" if name == other else "" for other in names)]))
    folder = _folder(tmp_path, clean, "\n".join(lines) + "\n")
    assert hil("tower", "align", folder / "export.csv", "--out", tmp_path / "record") == 0
    assert np.allclose(_outlet(tmp_path / "record"), wanted, atol=1e-3, equal_nan=True)


def test_times_without_a_zone_are_named_and_taken_as_it_is_given(
    tmp_path: Path, clean: list[Series], wanted: np.ndarray, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = _rows(clean, "%Y-%m-%d %H:%M:%S.%f", ZONE)
    text = "\n".join(["timestamp,tag,value,quality", *(f"{t},{n},{v:.6g},192" for t, n, v in rows)]) + "\n"
    folder = _folder(tmp_path, clean, text)
    assert hil("tower", "align", folder, "--out", tmp_path / "as_utc") == 0
    assert "its times have no time zone and are taken as UTC" in " ".join(capsys.readouterr().out.split())
    assert hil("tower", "align", folder, "--stamps", ZONE, "--out", tmp_path / "record") == 0
    assert np.allclose(_outlet(tmp_path / "record"), wanted, atol=1e-3, equal_nan=True)


def test_ratings_in_words_become_bad_quality(tmp_path: Path, clean: list[Series]) -> None:
    rows = _rows(clean)
    bad = {k for k, row in enumerate(rows) if row[1] == "T1OUT"}
    bad = set(sorted(bad)[200:240])
    lines = [f"{t},{n},{v:.6g},{'Bad' if k in bad else 'Good'}" for k, (t, n, v) in enumerate(rows)]
    text = "\n".join(["timestamp,tag,value,quality", *lines]) + "\n"
    assert hil("tower", "align", _folder(tmp_path, clean, text), "--out", tmp_path / "record") == 0
    found = json.loads((tmp_path / "record" / "alignment.json").read_text())["defects"]
    assert [(one["type"], one["tags"]) for one in found] == [("bad_quality", ["T1OUT"])]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("timestamp,tag,value,quality\n2024-05-01T00:00:00Z,T1OUT,20.1,wet\n", "codes that are not known; write 192"),
        ("timestamp,tag,value,quality\nyesterday,T1OUT,20.1,192\n", "export.csv"),
        ("name,comment\nT1OUT,none\n", "export.csv"),
    ],
)
def test_a_csv_that_is_no_store_is_one_sentence(
    tmp_path: Path, clean: list[Series], capsys: pytest.CaptureFixture[str], text: str, says: str
) -> None:
    folder = _folder(tmp_path, clean, text)
    assert hil("tower", "align", folder, "--out", tmp_path / "record") == 2
    said = capsys.readouterr().err
    assert says in said and said.count("\n") == 1 and not (tmp_path / "record").exists()


def test_a_folder_without_samples_names_what_to_give(
    tmp_path: Path, clean: list[Series], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = _folder(tmp_path, clean, "")
    (folder / "export.csv").unlink()
    assert hil("tower", "align", folder, "--out", tmp_path / "record") == 2
    assert "give a folder of Parquet or CSV files with the columns timestamp, tag, value" in capsys.readouterr().err
