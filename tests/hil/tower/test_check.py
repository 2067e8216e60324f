"""`hil check` of a tower's files and folders: kind, content, problems with file, line and remedy, and the exit code."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.hil.tower.made_store import hil, written_station
from twin.historian.tags import Series

TAGS = "tag,unit,cell,role\nT1OUT,degC,1,water_outlet_temperature\n"
LABELS = "time,cell,parameter,kind,value,sd,lo,hi\n2022-05-01,1,fill,interval,,,0.8,0.9\n"
POINTS = (
    "cell,test,water_inlet_C,water_outlet_C,entering_wet_bulb_C,dry_bulb_C,water_flow_kg_s,fan_speed_pct\n"
    "1,a,35,25,18,22,200,100\n"
)


@pytest.fixture(scope="module")
def station(tmp_path_factory: pytest.TempPathFactory, clean: list[Series]) -> Path:
    return written_station(tmp_path_factory.mktemp("check") / "station", clean)


def test_a_store_is_listed_by_tag_with_unit_and_span(station: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert hil("check", station) == 0
    said = capsys.readouterr().out
    assert "T1OUT (water_outlet_temperature, cell 1): " in said and "degC" in said
    assert "a historian store of" in said and "2022-04-15T00:" in said and "no mistakes found" in said


def test_a_store_without_its_dictionary_names_the_command_that_takes_one(
    station: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for file in station.rglob("*.parquet"):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    assert hil("check", tmp_path) == 0
    assert f"hil tower align {tmp_path} --tags TAGS.csv" in capsys.readouterr().out


def test_a_dictionary_beside_a_store_that_lacks_its_tag_is_a_problem_with_its_line(
    clean: list[Series], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = written_station(tmp_path / "station", clean)
    tags = folder / "tags.csv"
    tags.write_text(tags.read_text().replace("T1OUT,", "T1OUTX,"))
    line = next(n for n, text in enumerate(tags.read_text().splitlines(), 1) if text.startswith("T1OUTX"))
    assert hil("check", folder) == 1
    said = capsys.readouterr().out
    assert f"tags.csv:{line}: T1OUTX of the dictionary is not in the store" in said and "rename it" in said


def test_stamps_of_a_clock_that_was_set_wrong_are_named_as_the_alignment_moves_them(
    clean: list[Series], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def off(one: Series) -> Series:
        hours = (one.time_s - one.time_s[0]) / 3600.0
        return replace(one, time_s=one.time_s - np.where((hours >= 50.0) & (hours < 62.0), 7200.0, 0.0))

    folder = written_station(tmp_path / "station", [off(one) for one in clean])
    assert hil("check", folder) == 1
    said = " ".join(capsys.readouterr().out.split())
    assert "min behind: the clock was set" in said and "hil tower align moves them back" in said
    assert "go back" not in said  # moved, they are in order


def test_an_aligned_record_is_told_by_cell_and_a_damaged_one_is_a_problem(
    station: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record = tmp_path / "record"
    assert hil("tower", "align", station, "--out", record) == 0
    capsys.readouterr()
    assert hil("check", record) == 0
    said = capsys.readouterr().out
    assert "an aligned record of 2 cells; no mistakes found" in said and "t_out_C 99 %" in said
    assert hil("check", record / "station.json") == 1
    assert f"check its folder, {record}" in capsys.readouterr().out
    (record / "cell2.parquet").write_bytes(b"PAR1 cut")
    assert hil("check", record) == 1
    said = capsys.readouterr().out
    assert "1 problem" in said and "cell2.parquet: cannot be read" in said and "align the store again" in said


@pytest.mark.parametrize(
    ("name", "content", "wrong", "words", "problem"),
    [
        ("dictionary.csv", TAGS, ("degC", "degX"), "a tag dictionary of 1 tag; cells with an outlet: 1", ":2: T1OUT"),
        ("seen.csv", LABELS, ("fill", "fil"), "1 labels of cell 1", ":2: parameter 'fil' is unknown"),
        ("tests.csv", POINTS, ("200", "x"), "cell 1: 1 test point, water 200 to 200 kg/s", ":2: water_flow_kg_s"),
        (
            "log.csv",
            "time,cell,event\n2022-05-01,1,cleaning\n",
            ("2022", "x"),
            "1 event, 1 of which may",
            ":2: 'x-05-01'",
        ),
        (
            "sheet.json",
            '{"station": "X", "timezone": "Europe/Madrid", "design": {"water_flow_kg_s": 200}}',
            ("Madrid", "Madrit"),
            "the datasheet of station X; no mistakes found",
            "'Europe/Madrit' is no time zone",
        ),
    ],
)
def test_a_table_is_known_by_its_heading_and_its_mistake_has_a_line(
    name: str,
    content: str,
    wrong: tuple[str, str],
    words: str,
    problem: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    file = tmp_path / name
    file.write_text(content)
    assert hil("check", file) == 0
    assert words in capsys.readouterr().out
    file.write_text(content.replace(*wrong))
    assert hil("check", file) == 1
    said = capsys.readouterr().out
    assert "1 problem" in said and f"{file}{problem if problem.startswith(':') else ': ' + problem}" in said


@pytest.mark.parametrize(
    ("name", "content", "problems"),
    [
        (
            "dictionary.csv",
            "tag,unit,cell,role,scan_s\n"
            "T1OUT,degX,1,water_outlet_temperature,60\n"
            "T1IN,degC,one,water_inlet_temperature,never\n"
            "F1,degC,1,water_flow,60\n"
            "T1OUT,degC,1,basin_temperature,60\n"
            "SI1,%,,fan_speed,60\n",
            [
                ":2: T1OUT: ",
                ":3: T1IN has scan_s 'never'",
                ":3: T1IN has cell 'one'",
                ":4: F1 is in degC, a unit of temperature; a water_flow is a mass flow",
                ":5: T1OUT is there twice",
                ":6: SI1 has role fan_speed and no cell",
            ],
        ),
        (
            "seen.csv",
            "time,cell,parameter,kind,value,sd,lo,hi\n"
            "noon,x,fil,span,,,,\n"
            "2022-05-01,1,fill,interval,,,0.8,0.9\n"
            "2022-05-02,1,fill,interval,,,0.9,0.8\n",
            [
                ":2: 'noon' is no time",
                ":2: cell is 'x'",
                ":2: parameter 'fil' is unknown",
                ":2: kind 'span'",
                ":4: lo 0.9 is not below hi 0.8",
            ],
        ),
        (
            "tests.csv",
            POINTS + "1,b,95,25,18,22,x,100\n2,c,25,35,18,22,200,100\nz,d,35,25,18,22,200,100\n",
            [
                ":3: water_inlet_C is 95, outside 0 to 70",
                ":3: water_flow_kg_s is 'x', which is no number",
                ":4: the outlet, 35 degC, is not below the inlet",
                ":5: cell is 'z', which is no number",
            ],
        ),
        (
            "log.csv",
            "time,precision,cell,event\nnoon,week,1,cleaning\n2022-05-01,day,half,cleaning\n",
            [":2: precision is 'week'", ":2: 'noon' is no time", ":3: cleaning has cell 'half'"],
        ),
        (
            "sheet.json",
            '{"station": "X", "timezone": "Europe/Madrit", "fan": {"speed_100pct": "60 kg"}, '
            '"design": {"pressure_kPa": 990}}',
            [": 'Europe/Madrit' is no time zone", ": design.pressure_kPa is 990", ": fan.speed_100pct"],
        ),
        (
            "other.json",
            '{"station": 7, "timezone": "Europe/Madrid", "cells_in_station": "two", "design": {}}',
            [": station is 7, which is not a text", ": cells_in_station is 'two'"],
        ),
    ],
)
def test_all_mistakes_of_a_file_are_listed_with_their_lines(
    name: str, content: str, problems: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / name
    file.write_text(content)
    assert hil("check", file) == 1
    lines = capsys.readouterr().out.splitlines()
    assert f"{len(problems)} problems" in "".join(lines)
    listed = sorted(line.strip() for line in lines if line.startswith(f"  {file}"))
    assert len(listed) == len(problems)
    for line, problem in zip(listed, sorted(problems), strict=True):
        assert line.startswith(f"{file}{problem}")


def test_the_mistakes_of_all_files_of_a_store_are_listed(
    clean: list[Series], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = written_station(tmp_path / "station", clean)
    (folder / "tags.csv").write_text((folder / "tags.csv").read_text().replace("degC", "degX", 2))
    (folder / "datasheet.json").write_text('{"timezone": "Europe/Madrit", "station": "X"}')
    (folder / "events.csv").write_text("time,cell,event\nnoon,1,cleaning\n")
    assert hil("check", folder) == 1
    said = capsys.readouterr().out
    assert "4 problems" in said and said.count("tags.csv:") == 2
    assert "datasheet.json: " in said and "events.csv:2: " in said


def test_a_long_list_ends_with_the_number_of_the_others_and_a_command_states_the_first(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "dictionary.csv"
    file.write_text(TAGS + "".join(f"T{k},degX,1,basin_temperature\n" for k in range(2, 32)))
    assert hil("check", file) == 1
    lines = capsys.readouterr().out.splitlines()
    assert "30 problems" in lines[0] and lines[-1].strip() == "and 10 more" and len(lines) == 22
    (tmp_path / "store").mkdir()
    (tmp_path / "store" / "raw.csv").write_text("timestamp,tag,value\n2022-05-01T00:00:00Z,T1OUT,20\n")
    assert hil("tower", "align", tmp_path / "store", "--tags", file, "--out", tmp_path / "record") == 2
    said = " ".join(capsys.readouterr().err.split())
    assert f"{file}:3: T2" in said and f"(29 more: `hil check {file}` lists them)" in said
