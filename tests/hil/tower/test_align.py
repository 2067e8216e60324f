"""`hil tower align`: from a store and a tag dictionary to the record, and what it says of bad input."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from drivers.historian import Samples, open_store
from hil.cli import verbs
from tests.twin.historian.made_defects import spoilt_store
from tests.twin.historian.made_station import START_S, ZONE, clean_store
from twin.historian.tags import Series

DAY_S = 86400.0


def _hil(*arguments: object) -> int:
    """Run the command as its entry point does and return the exit code."""
    import sys

    plain = sys.argv
    sys.argv = ["hil", *map(str, arguments)]
    try:
        verbs.main()
    except SystemExit as ended:
        return int(ended.code or 0)
    finally:
        sys.argv = plain
    return 0


def _station(folder: Path, series: list[Series], sheet: dict[str, Any] | None = None, events: str = "") -> Path:
    folder.mkdir(exist_ok=True)
    with open_store(folder, create=True) as store:
        store.append({one.tag.name: Samples(one.time_s, one.value, one.quality) for one in series})
    with (folder / "tags.csv").open("w", newline="") as handle:
        writer = csv.writer(handle)
        writer.writerow(["tag", "description", "unit", "cell", "role", "scan_s"])
        for one in series:
            writer.writerow([one.tag.name, "", one.tag.unit, one.tag.cell or "", one.tag.role, one.tag.scan_s])
    (folder / "datasheet.json").write_text(json.dumps({"station": "X", "timezone": ZONE} | (sheet or {})))
    (folder / "events.csv").write_text("time,precision,cell,source,event,text\n" + events)
    return folder


@pytest.fixture(scope="module")
def clean() -> list[Series]:
    return clean_store(np.random.default_rng(50), 8.0)


def test_a_station_folder_becomes_a_record_of_minutes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    series, seeded, _ = spoilt_store(np.random.default_rng(51), 20.0)
    events = "2022-04-18T10:00:00Z,minute,1,DCS,fan_trip,fan tripped\n"
    folder = _station(tmp_path / "station", series, events=events)
    assert _hil("tower", "align", folder, "--out", tmp_path / "record") == 0
    shown = capsys.readouterr().out
    assert "local_time" in shown and "cell 1:" in shown and "cell 2:" in shown
    report = json.loads((tmp_path / "record" / "alignment.json").read_text())
    assert {one["type"] for one in report["defects"]} == {kind for kind, *_ in seeded.rows}
    assert all(one["from"].endswith("Z") and one["tags"] and one["says"] for one in report["defects"])
    table = pq.read_table(tmp_path / "record" / "cell1.parquet")
    time_ms = table["time"].cast("int64").to_numpy()
    assert np.all(np.diff(time_ms) == 60_000) and abs(len(time_ms) - 20 * 1440) < 300
    speed = table["fan_speed_pct"].to_numpy()
    assert np.isfinite(speed).mean() > 0.9 and set(np.unique(table["fan_speed_pct_how"].to_numpy())) <= {0, 1, 2, 3}
    assert table["disturbed"].to_numpy().sum() == 240
    station = json.loads((tmp_path / "record" / "station.json").read_text())
    assert station["datasheet"]["station"] == "X" and station["events"][0]["kind"] == "fan_trip"


def test_a_clean_store_reports_no_defect(
    tmp_path: Path, clean: list[Series], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = _station(tmp_path / "station", clean)
    assert _hil("tower", "align", folder, "--out", tmp_path / "record") == 0
    assert "no defect was found" in capsys.readouterr().out
    assert json.loads((tmp_path / "record" / "alignment.json").read_text())["defects"] == []


def test_a_fan_in_hertz_is_a_share_of_full_speed(tmp_path: Path, clean: list[Series]) -> None:
    hertz = [
        replace(one, tag=replace(one.tag, unit="Hz"), value=0.5 * one.value) if one.tag.name == "SI1" else one
        for one in clean
    ]
    folder = _station(tmp_path / "station", hertz, {"fan": {"speed_100pct": "50 Hz"}})
    assert _hil("tower", "align", folder, "--out", tmp_path / "record") == 0
    table = pq.read_table(tmp_path / "record" / "cell1.parquet")
    off = table["fan_speed_pct"].to_numpy() - table["fan_command_pct"].to_numpy()
    assert abs(np.nanmedian(off)) < 1.0


def test_a_missing_and_a_renamed_tag_are_named_and_the_rest_goes_on(
    tmp_path: Path, clean: list[Series], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = _station(tmp_path / "station", clean)
    text = (folder / "tags.csv").read_text().replace("TWB,", "TWB.PV,").replace("WS,", "QQQ,")
    (folder / "tags.csv").write_text(text)
    assert _hil("tower", "align", folder, "--out", tmp_path / "record") == 0
    shown = capsys.readouterr().out.replace("\n", " ")
    assert "TWB.PV of the dictionary is not in the store; its column stays missing; is it TWB now?" in shown
    assert "QQQ of the dictionary is not in the store" in shown
    table = pq.read_table(tmp_path / "record" / "cell1.parquet")
    assert not np.isfinite(table["wet_C"].to_numpy()).any() and np.isfinite(table["wet_rh_C"].to_numpy()).mean() > 0.9


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("T1OUT,,degC", "T1OUT,,furlong", r"tags.csv:3: T1OUT: unit 'furlong' is not known; use one of"),
        ("F1,,m3/h", "F1,,kPa", r"tags.csv:4: F1 is in kPa, a unit of pressure; a water_flow is a mass flow"),
        ("T1OUT,,degC,1", "T1OUT,,degC,", r"T1OUT has role water_outlet_temperature and no cell"),
        ("T1OUT,,degC,1", "T1OUT,,degC,one", r"T1OUT has cell 'one'; give a whole number"),
        ("T2OUT", "T1OUT", r"T1OUT is there twice; remove one line"),
        ("tag,description,unit", "name,description,unit", r"tags.csv: lacks the column tag"),
    ],
)
def test_a_wrong_line_of_the_dictionary_is_named(
    tmp_path: Path, clean: list[Series], capsys: pytest.CaptureFixture[str], old: str, new: str, message: str
) -> None:
    import re

    folder = _station(tmp_path / "station", clean)
    text = (folder / "tags.csv").read_text()
    assert old in text
    (folder / "tags.csv").write_text(text.replace(old, new))
    assert _hil("tower", "align", folder, "--out", tmp_path / "record") == 2
    said = capsys.readouterr().err
    assert re.search(message, said) and said.count("\n") == 1
    assert not (tmp_path / "record").exists()


@pytest.mark.parametrize(
    ("name", "factor", "offset", "remedy"),
    [
        ("RHA", 0.01, 0.0, "give it the unit 1 there"),
        ("TDB", 1.8, 32.0, "give it the unit degF there"),
        ("F1", 4.4, 0.0, "gpm"),
        ("SI1", 0.01, 0.0, "give it the unit 1 there"),
    ],
)
def test_a_tag_in_another_unit_throughout_is_left_out_with_the_remedy(
    tmp_path: Path,
    clean: list[Series],
    capsys: pytest.CaptureFixture[str],
    name: str,
    factor: float,
    offset: float,
    remedy: str,
) -> None:
    series = [replace(one, value=factor * one.value + offset) if one.tag.name == name else one for one in clean]
    folder = _station(tmp_path / "station", series, {"design": {"water_flow_kg_s": 180.0}})
    assert _hil("tower", "align", folder, "--out", tmp_path / "record") == 0
    shown = capsys.readouterr().out.replace("\n", " ")
    assert f"{name} has a median of" in shown and "it is left out" in shown and remedy in shown


def test_a_clock_that_goes_back_and_days_of_silence_are_named(
    tmp_path: Path, clean: list[Series], capsys: pytest.CaptureFixture[str]
) -> None:
    series = []
    for one in clean:
        if one.tag.name == "TRET":
            one = one.rows(np.roll(np.arange(len(one.time_s)), 5))
        if one.tag.name == "TSUP":
            one = one.rows((one.time_s < START_S + 2 * DAY_S) | (one.time_s > START_S + 6 * DAY_S))
        series.append(one)
    folder = _station(tmp_path / "station", series)
    assert _hil("tower", "align", folder, "--out", tmp_path / "record") == 0
    shown = capsys.readouterr().out.replace("\n", " ")
    assert (
        "the times of TRET go back 1 times in the store, first in row" in shown and "check the logger's clock" in shown
    )
    assert "TSUP has no sample from 20" in shown


def test_a_second_tag_of_one_role_and_an_unknown_role_are_named(
    tmp_path: Path, clean: list[Series], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = _station(tmp_path / "station", clean)
    with (folder / "tags.csv").open("a") as handle:
        handle.write("T1OUT2,,degC,1,water_outlet_temperature,60\nVIB,,m/s,1,vibration,60\n")
    assert _hil("tower", "align", folder, "--out", tmp_path / "record") == 0
    shown = capsys.readouterr().out.replace("\n", " ")
    assert "T1OUT2 has role and cell of T1OUT, which is used" in shown and "VIB has role 'vibration'" in shown


def test_an_outlet_above_the_inlet_is_marked_and_named(
    tmp_path: Path, clean: list[Series], capsys: pytest.CaptureFixture[str]
) -> None:
    series = [replace(one, value=one.value + 25.0) if one.tag.name == "T1OUT" else one for one in clean]
    folder = _station(tmp_path / "station", series)
    assert _hil("tower", "align", folder, "--out", tmp_path / "record") == 0
    shown = capsys.readouterr().out.replace("\n", " ")
    assert "cell 1: the outlet is above the inlet" in shown and ", first in row " in shown
    assert "check the tags of t_out_C and t_in_C" in shown
    assert (pq.read_table(tmp_path / "record" / "cell1.parquet")["check"].to_numpy() & 8).mean() > 0.3


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        ("datasheet.json", "{", "datasheet.json: is not valid JSON"),
        ("datasheet.json", '{"timezone": "Mars/Olympus"}', "'Mars/Olympus' is no time zone"),
        ("events.csv", "time,event\nyesterday,fan_trip\n", "events.csv:2: 'yesterday' is no time"),
        ("events.csv", "when,event\n", "events.csv: lacks the column time"),
    ],
)
def test_a_wrong_datasheet_or_list_of_events_is_one_sentence(
    tmp_path: Path, clean: list[Series], capsys: pytest.CaptureFixture[str], file: str, text: str, message: str
) -> None:
    folder = _station(tmp_path / "station", clean[:3])
    (folder / file).write_text(text)
    assert _hil("tower", "align", folder, "--out", tmp_path / "record") == 2
    said = capsys.readouterr().err
    assert message in said and said.count("\n") == 1


def test_a_store_without_any_of_the_tags_or_without_dictionary_is_refused(
    tmp_path: Path, clean: list[Series], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = _station(tmp_path / "station", clean[:3])
    (folder / "tags.csv").write_text("tag,unit,role,cell\nX,degC,water_outlet_temperature,1\n")
    assert _hil("tower", "align", folder, "--out", tmp_path / "record") == 2
    assert "the store has none of the dictionary's 1 tags" in capsys.readouterr().err
    (folder / "tags.csv").unlink()
    assert _hil("tower", "align", folder, "--out", tmp_path / "record") == 2
    assert "has no tags.csv" in capsys.readouterr().err
    assert (
        _hil("tower", "align", tmp_path / "nothing", "--tags", folder / "events.csv", "--out", tmp_path / "record") == 2
    )


def test_a_record_that_cannot_be_written_is_one_sentence(
    tmp_path: Path, clean: list[Series], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = _station(tmp_path / "station", clean)

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pq, "write_table", full)
    assert _hil("tower", "align", folder, "--out", tmp_path / "record") == 1
    said = capsys.readouterr().err
    assert "No space left on device" in said and said.count("\n") == 1
    assert not list((tmp_path / "record").glob("*.parquet"))
