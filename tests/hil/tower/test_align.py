"""`hil tower align`: from a store and a tag dictionary to the record, and what it says of bad input."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.hil.tower.made_store import hil, written_station
from tests.twin.historian.made_defects import spoilt_store
from tests.twin.historian.made_station import START_S
from twin.historian.tags import Series

DAY_S = 86400.0


def test_a_station_folder_becomes_a_record_of_minutes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    series, seeded, _ = spoilt_store(np.random.default_rng(51), 20.0)
    events = "2022-04-18T10:00:00Z,minute,1,DCS,fan_trip,fan tripped\n"
    folder = written_station(tmp_path / "station", series, events=events)
    assert hil("tower", "align", folder, "--out", tmp_path / "record") == 0
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
    folder = written_station(tmp_path / "station", clean)
    assert hil("tower", "align", folder, "--out", tmp_path / "record") == 0
    assert "no defect was found" in capsys.readouterr().out
    assert json.loads((tmp_path / "record" / "alignment.json").read_text())["defects"] == []


@pytest.mark.parametrize(("unit", "full"), [("Hz", 50.0), ("rpm", 320.0)])
def test_a_fan_in_hertz_or_rpm_is_a_share_of_full_speed(
    tmp_path: Path, clean: list[Series], unit: str, full: float
) -> None:
    turning = [
        replace(one, tag=replace(one.tag, unit=unit), value=0.01 * full * one.value) if one.tag.name == "SI1" else one
        for one in clean
    ]
    folder = written_station(tmp_path / "station", turning, {"fan": {"speed_100pct": f"{full:g} {unit}"}})
    assert hil("tower", "align", folder, "--out", tmp_path / "record") == 0
    table = pq.read_table(tmp_path / "record" / "cell1.parquet")
    off = table["fan_speed_pct"].to_numpy() - table["fan_command_pct"].to_numpy()
    assert abs(np.nanmedian(off)) < 1.0


def test_a_missing_and_a_renamed_tag_are_named_and_the_rest_goes_on(
    tmp_path: Path, clean: list[Series], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = written_station(tmp_path / "station", clean)
    text = (folder / "tags.csv").read_text().replace("TWB,", "TWB.PV,").replace("WS,", "QQQ,")
    (folder / "tags.csv").write_text(text)
    assert hil("tower", "align", folder, "--out", tmp_path / "record") == 0
    shown = " ".join(capsys.readouterr().out.split())
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
        ("T1OUT,,degC,1", "T1OUT,,degC,1.7", r"T1OUT has cell '1.7'; give a whole number"),
        ("T1OUT,,degC,1", "T1OUT,,degC,inf", r"T1OUT has cell 'inf'; give a whole number"),
        ("water_outlet_temperature", "reserve", r"no tag of the dictionary has the role water_outlet_temperature"),
        (
            "SI1,,%",
            "SI1,,rpm",
            r"SI1 is in rpm, but .*datasheet.json gives 100 % speed as 60 Hz; write fan.speed_100pct",
        ),
        ("tag,description,unit", "name,description,unit", r"tags.csv: lacks the column tag"),
    ],
)
def test_a_wrong_line_of_the_dictionary_is_named(
    tmp_path: Path, clean: list[Series], capsys: pytest.CaptureFixture[str], old: str, new: str, message: str
) -> None:
    import re

    folder = written_station(tmp_path / "station", clean)
    text = (folder / "tags.csv").read_text()
    assert old in text
    (folder / "tags.csv").write_text(text.replace(old, new))
    assert hil("tower", "align", folder, "--out", tmp_path / "record") == 2
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
    folder = written_station(tmp_path / "station", series, {"design": {"water_flow_kg_s": 180.0}})
    assert hil("tower", "align", folder, "--out", tmp_path / "record") == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert f"{name} has a median of" in shown and "it is left out" in shown and remedy in shown


def test_a_second_tag_of_one_role_and_an_unknown_role_are_named(
    tmp_path: Path, clean: list[Series], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = written_station(tmp_path / "station", clean)
    with (folder / "tags.csv").open("a") as handle:
        handle.write("T1OUT2,,degC,1,water_outlet_temperature,60\nVIB,,m/s,1,vibration,60\nJIX,,kW,1,fan_powr,60\n")
    assert hil("tower", "align", folder, "--out", tmp_path / "record") == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "T1OUT2 has role and cell of T1OUT, which is used" in shown and "VIB has role 'vibration'" in shown
    assert "is it fan_power? then mend it" in shown


def test_an_outlet_above_the_inlet_is_marked_and_named(
    tmp_path: Path, clean: list[Series], capsys: pytest.CaptureFixture[str]
) -> None:
    series = [replace(one, value=one.value + 25.0) if one.tag.name == "T1OUT" else one for one in clean]
    folder = written_station(tmp_path / "station", series)
    assert hil("tower", "align", folder, "--out", tmp_path / "record") == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "cell 1: the outlet is above the inlet" in shown and ", first in row " in shown
    assert "check the tags of t_out_C and t_in_C" in shown
    assert (pq.read_table(tmp_path / "record" / "cell1.parquet")["check"].to_numpy() & 8).mean() > 0.3


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        ("datasheet.json", "{", "datasheet.json: is not valid JSON"),
        ("datasheet.json", '{"timezone": "Mars/Olympus"}', "'Mars/Olympus' is no time zone"),
        ("datasheet.json", '{"design": {"pressure_kPa": 992}}', "design.pressure_kPa is 992, which no site has"),
        ("datasheet.json", '{"fan": {"speed_100pct": "abc"}}', "fan.speed_100pct 'abc' is no speed; write a number"),
        ("datasheet.json", '{"fan": {"speed_100pct": "40 kW"}}', "fan.speed_100pct '40 kW' is no speed of a fan"),
        ("events.csv", "time,event\nyesterday,fan_trip\n", "events.csv:2: 'yesterday' is no time"),
        ("events.csv", "when,event\n", "events.csv: lacks the column time"),
        ("events.csv", "time,event\n0001-01-01,cleaning\n", "events.csv:2: '0001-01-01' is no time from 1970 on"),
        ("events.csv", "time,event,cell\n2022-05-01,cleaning,inf\n", "events.csv:2: cleaning has cell 'inf'"),
        ("events.csv", "time,event,cell\n2022-05-01,cleaning,1.5\n", "events.csv:2: cleaning has cell '1.5'"),
        (
            "datasheet.json",
            '{"design": {"pressure_kPa": "abc"}}',
            "design.pressure_kPa is 'abc', which is not a number",
        ),
    ],
)
def test_a_wrong_datasheet_or_list_of_events_is_one_sentence(
    tmp_path: Path, clean: list[Series], capsys: pytest.CaptureFixture[str], file: str, text: str, message: str
) -> None:
    folder = written_station(tmp_path / "station", clean[:3])
    (folder / file).write_text(text)
    assert hil("tower", "align", folder, "--out", tmp_path / "record") == 2
    said = capsys.readouterr().err
    assert message in said and said.count("\n") == 1


def test_a_store_without_any_of_the_tags_or_without_dictionary_is_refused(
    tmp_path: Path, clean: list[Series], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = written_station(tmp_path / "station", clean[:3])
    (folder / "tags.csv").write_text("tag,unit,role,cell\nX,degC,water_outlet_temperature,1\n")
    assert hil("tower", "align", folder, "--out", tmp_path / "record") == 2
    assert "the store has none of the dictionary's 1 tags" in capsys.readouterr().err
    (folder / "tags.csv").unlink()
    assert hil("tower", "align", folder, "--out", tmp_path / "record") == 2
    assert "has no tags.csv" in capsys.readouterr().err
    assert (
        hil("tower", "align", tmp_path / "nothing", "--tags", folder / "events.csv", "--out", tmp_path / "record") == 2
    )


def test_a_store_that_is_wrong_is_an_input_to_correct(
    tmp_path: Path, clean: list[Series], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = written_station(tmp_path / "station", clean[:3])
    (stored,) = folder.glob("*.parquet")
    stored.write_bytes(stored.read_bytes()[:-30])
    assert hil("tower", "align", folder, "--out", tmp_path / "record") == 2
    said = capsys.readouterr().err
    assert f"{stored}: is damaged and cannot be read" in said and said.count("\n") == 1
    assert not (tmp_path / "record").exists()


def test_a_cell_of_an_earlier_record_goes_and_other_files_stay(tmp_path: Path, clean: list[Series]) -> None:
    out = tmp_path / "record"
    assert hil("tower", "align", written_station(tmp_path / "both", clean), "--out", out) == 0
    (out / "notes.txt").write_text("mine")
    assert {path.name for path in out.glob("cell*")} == {"cell1.parquet", "cell2.parquet"}
    one = [series for series in clean if series.tag.cell != 2]
    assert hil("tower", "align", written_station(tmp_path / "one", one), "--out", out) == 0
    names = {path.name for path in out.iterdir()}
    assert names == {"cell1.parquet", "alignment.json", "station.json", "notes.txt"}


def test_a_record_that_cannot_be_written_is_one_sentence(
    tmp_path: Path, clean: list[Series], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = written_station(tmp_path / "station", clean)

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pq, "write_table", full)
    assert hil("tower", "align", folder, "--out", tmp_path / "record") == 1
    said = capsys.readouterr().err
    assert "No space left on device" in said and said.count("\n") == 1
    assert not list((tmp_path / "record").glob("*.parquet"))


def test_words_of_values_and_quality_in_parquet_are_read(tmp_path: Path, clean: list[Series]) -> None:
    folder = written_station(tmp_path / "station", clean)
    for path in folder.glob("*.parquet"):
        table = pq.read_table(path)
        names, value = table["tag"].to_pylist(), table["value"].to_pylist()
        rows = [k for k, name in enumerate(names) if name == "T1OUT"]
        bad = {*rows[200:240]}
        text = pa.array(["Bad Input" if k in bad else f"{v:.6g}" for k, v in enumerate(value)])
        words = pa.array(["Bad" if k in bad else "Good" for k in range(len(value))])
        pq.write_table(table.set_column(2, "value", text).set_column(3, "quality", words), path)
    assert hil("tower", "align", folder, "--out", tmp_path / "record") == 0
    found = json.loads((tmp_path / "record" / "alignment.json").read_text())["defects"]
    assert [(one["type"], one["tags"]) for one in found] == [("bad_quality", ["T1OUT"])]


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("2022-04-18,day,8,CMMS,cleaning,Fill washed\n", "cell 8, which has no tag"),
        ("2022-04-18,day,1,CMMS,waschen,\n", "class 'waschen' is not known"),
    ],
)
def test_an_event_that_changes_nothing_is_named(
    tmp_path: Path, clean: list[Series], capsys: pytest.CaptureFixture[str], line: str, said: str
) -> None:
    folder = written_station(tmp_path / "station", clean, events=line)
    assert hil("tower", "align", folder, "--out", tmp_path / "record") == 0
    assert said in " ".join(capsys.readouterr().out.split())


def test_a_precision_that_is_none_is_refused(
    tmp_path: Path, clean: list[Series], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = written_station(tmp_path / "station", clean, events="2022-04-18,tag,1,CMMS,cleaning,\n")
    assert hil("tower", "align", folder, "--out", tmp_path / "record") == 2
    assert "events.csv:2: precision is 'tag'; write minute or day" in " ".join(capsys.readouterr().err.split())


def test_the_table_has_a_row_for_each_tag_and_kind(
    tmp_path: Path, clean: list[Series], capsys: pytest.CaptureFixture[str]
) -> None:
    spoilt = [
        replace(one, value=np.where(np.arange(len(one.value)) % 60 == 5, 365.0, one.value))
        if one.tag.name == "WD"
        else one
        for one in clean
    ]
    folder = written_station(tmp_path / "station", spoilt)
    assert hil("tower", "align", folder, "--out", tmp_path / "record") == 0
    out = capsys.readouterr().out
    assert out.count("out_of_range") == 1 and "more of WD" in " ".join(out.split())
    assert len(json.loads((tmp_path / "record" / "alignment.json").read_text())["defects"]) > 5


def test_values_that_no_instrument_can_show_are_a_defect_and_a_hole(tmp_path: Path, clean: list[Series]) -> None:
    start = START_S + 3.2 * DAY_S
    series = []
    for one in clean:
        if one.tag.name == "T1IN":
            first = int(np.searchsorted(one.time_s, start))
            inside = (np.arange(len(one.time_s)) >= first) & (np.arange(len(one.time_s)) < first + 5)
            one = replace(one, value=np.where(inside, 999.0, one.value))
        series.append(one)
    folder = written_station(tmp_path / "station", series)
    assert hil("tower", "align", folder, "--out", tmp_path / "record") == 0
    found = json.loads((tmp_path / "record" / "alignment.json").read_text())["defects"]
    assert [(one["type"], one["tags"]) for one in found] == [("out_of_range", ["T1IN"])]
    table = pq.read_table(tmp_path / "record" / "cell1.parquet")
    minute = table["time"].cast("int64").to_numpy() / 1e3
    first, last = (np.datetime64(found[0][end].rstrip("Z"), "s").astype(float) for end in ("from", "to"))
    within = (minute >= first) & (minute + 60.0 <= last)
    assert within.any() and np.isnan(table["t_in_C"].to_numpy()[within]).all()
    assert (table["t_in_C_how"].to_numpy()[within] == 0).all()


@pytest.mark.parametrize("scan", ["nan", "inf", "0", "-5"])
def test_a_scan_time_that_is_none_is_refused(
    tmp_path: Path, clean: list[Series], capsys: pytest.CaptureFixture[str], scan: str
) -> None:
    folder = written_station(tmp_path / "station", clean[:3])
    lines = (folder / "tags.csv").read_text().splitlines()
    lines[1] = lines[1].rsplit(",", 1)[0] + f",{scan}"
    (folder / "tags.csv").write_text("\n".join(lines))
    assert hil("tower", "align", folder, "--out", tmp_path / "record") == 2
    assert f"tags.csv:2: T1IN has scan_s '{scan}'; give seconds as a number above 0" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "unit", "factor", "remedy"),
    [("SI1", "Hz", 0.01, "give it the unit 1 there"), ("F1", "m3/h", 1.2 * 4.4, "or gpm there")],
)
def test_a_unit_in_which_the_values_are_just_possible_gives_way_to_the_usual_one(
    tmp_path: Path,
    clean: list[Series],
    capsys: pytest.CaptureFixture[str],
    name: str,
    unit: str,
    factor: float,
    remedy: str,
) -> None:
    series = [
        replace(one, tag=replace(one.tag, unit=unit), value=factor * one.value) if one.tag.name == name else one
        for one in clean
    ]
    folder = written_station(tmp_path / "station", series, {"design": {"water_flow_kg_s": 180.0}})
    assert hil("tower", "align", folder, "--out", tmp_path / "record") == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert f"{name} has a median of" in shown and remedy in shown
