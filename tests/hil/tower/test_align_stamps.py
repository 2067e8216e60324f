"""`hil tower align`: time stamps in zones, clocks that change, and stamps far from the record."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.hil.tower.made_store import hil, written_station
from tests.twin.historian.made_station import START_S, ZONE, clean_store
from twin.historian.stamps import without_strays
from twin.historian.tags import Series

DAY_S = 86400.0


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
    folder = written_station(tmp_path / "station", series)
    assert hil("tower", "align", folder, "--out", tmp_path / "record") == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert (
        "the times of TRET go back 1 times in the store, first in row" in shown and "check the logger's clock" in shown
    )
    assert "TSUP has no sample from 20" in shown


def _without_zone(folder: Path) -> None:
    for path in folder.glob("*.parquet"):
        table = pq.read_table(path)
        at = table.schema.get_field_index("timestamp")
        pq.write_table(table.set_column(at, "timestamp", table["timestamp"].cast(pa.timestamp("ms"))), path)


def test_stamps_with_a_zone_of_their_own_never_move(
    tmp_path: Path, clean: list[Series], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = written_station(tmp_path / "station", clean)
    assert hil("tower", "align", folder, "--out", tmp_path / "a") == 0
    capsys.readouterr()
    assert hil("tower", "align", folder, "--stamps", ZONE, "--out", tmp_path / "b") == 0
    assert "--stamps Europe/Madrid is not used" in " ".join(capsys.readouterr().out.split())
    first, second = (pq.read_table(tmp_path / name / "cell1.parquet") for name in "ab")
    assert first["time"].equals(second["time"])
    assert np.array_equal(first["t_out_C"].to_numpy(), second["t_out_C"].to_numpy(), equal_nan=True)


def test_stamps_in_a_named_zone_are_converted(tmp_path: Path, clean: list[Series]) -> None:
    moved = [replace(one, time_s=one.time_s + 7200.0) for one in clean]  # Madrid in April
    right, local = written_station(tmp_path / "right", clean), written_station(tmp_path / "local", moved)
    _without_zone(local)
    assert hil("tower", "align", right, "--out", tmp_path / "a") == 0
    assert hil("tower", "align", local, "--stamps", ZONE, "--out", tmp_path / "b") == 0
    first, second = (pq.read_table(tmp_path / name / "cell1.parquet") for name in "ab")
    assert first["time"].equals(second["time"])
    assert np.array_equal(first["t_out_C"].to_numpy(), second["t_out_C"].to_numpy(), equal_nan=True)
    assert hil("tower", "align", local, "--stamps", "Mars/Olympus", "--out", tmp_path / "c") == 2


def test_times_that_all_fall_back_an_hour_ask_for_the_zone(
    tmp_path: Path, clean: list[Series], capsys: pytest.CaptureFixture[str]
) -> None:
    change = START_S + 4 * DAY_S
    series = [replace(one, time_s=one.time_s - 3600.0 * (one.time_s >= change)) for one in clean]
    folder = written_station(tmp_path / "station", series)
    (folder / "datasheet.json").write_text("{}")
    assert hil("tower", "align", folder, "--out", tmp_path / "record") == 0
    assert "name the station's zone as timezone in the datasheet" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("stray", [0.0, 3.0e9, 1.65e11])
def test_a_stamp_far_from_the_record_is_left_out_and_named(
    tmp_path: Path, clean: list[Series], capsys: pytest.CaptureFixture[str], stray: float
) -> None:
    series = list(clean)
    time_s = series[0].time_s.copy()
    time_s[5] = stray
    series[0] = replace(series[0], time_s=time_s)
    folder = written_station(tmp_path / "station", series)
    assert hil("tower", "align", folder, "--out", tmp_path / "record") == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "tags.csv:2: 1 samples of T1IN lie further from the others than these span" in shown
    assert json.loads((tmp_path / "record" / "alignment.json").read_text())["minutes"] < 8 * 1440


def test_two_campaigns_far_apart_are_both_of_the_record() -> None:
    first = clean_store(np.random.default_rng(60), 2.0)
    both = [
        replace(one, time_s=np.where(np.arange(len(one.time_s)) % 2, one.time_s, one.time_s + 30 * DAY_S))
        for one in first
    ]
    found, remarks = without_strays(both, {})
    assert remarks == [] and all(len(a.time_s) == len(b.time_s) for a, b in zip(found, both, strict=True))
