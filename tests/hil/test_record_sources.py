"""Rows of several devices or sensors in one table: a column for each of them, and columns of states that name none."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hil.record.reader import Record, RecordError, read_record

OWN = [round(30 + 0.1 * k + 0.03 * (k % 3), 2) for k in range(40)]
"""Temperatures of the first source; the second is 20 K warmer."""


def _read(tmp_path: Path, heading: str, rows: list[str]) -> Record:
    path = tmp_path / "sources.csv"
    path.write_text("".join(f"{line}\n" for line in [heading, *rows]), encoding="utf-8")
    return read_record(path)


def _in_turn(labels: list[str], step_s: float = 15.0) -> list[str]:
    count = len(labels)
    return [f"{k * step_s:g},{labels[k % count]},{OWN[k // count] + 20 * (k % count)}" for k in range(40)]


@pytest.mark.parametrize(
    ("heading", "labels", "columns"),
    [
        ("time_s,device,T_in_C", ["a1", "b2"], ["a1_T_in_C", "b2_T_in_C"]),
        ("time_s,Sensor ID,T_in_C", ["7", "9"], ["Sensor_7_T_in_C", "Sensor_9_T_in_C"]),
        ("time_s,Messstelle,T_in [°C]", ["Vorlauf", "Rücklauf"], ["Vorlauf_T_in_C", "Rücklauf_T_in_C"]),
        ("time_s,node,value", ["1", "2"], ["node_1", "node_2"]),
        ("time_s,channel,T_in_C", ["1", "2", "3"], [f"channel_{k}_T_in_C" for k in (1, 2, 3)]),
    ],
)
@pytest.mark.parametrize("step_s", [15.0, 0.0])
def test_sources_whose_rows_alternate_have_a_column_each(
    tmp_path: Path, heading: str, labels: list[str], columns: list[str], step_s: float
) -> None:
    rows = _in_turn(labels)
    if not step_s:  # All sources at the same times.
        rows = [f"{k // len(labels)},{row.split(',', 1)[1]}" for k, row in enumerate(rows)]
    record = _read(tmp_path, heading, rows)
    assert list(record.columns) == columns
    for number, name in enumerate(columns):
        values = record.columns[name][np.isfinite(record.columns[name])]
        expected = [OWN[k] + 20 * number for k in range(len(range(number, 40, len(labels))))]
        assert values == pytest.approx(expected)
    assert any(f"names {len(labels)} sources whose rows alternate" in said for said in record.messages)


def test_sources_of_different_rates_are_told_apart(tmp_path: Path) -> None:
    draw = random.Random(3)
    labels = ["slow" if draw.random() < 0.1 else "fast" for _ in range(200)]
    rows = [f"{k},{label},{50 if label == 'slow' else 20}" for k, label in enumerate(labels)]
    record = _read(tmp_path, "time_s,logger,T_in_C", rows)
    assert {name: np.nanmax(values) for name, values in record.columns.items()} == {
        "fast_T_in_C": 20.0,
        "slow_T_in_C": 50.0,
    }


def test_sources_with_decimal_commas_are_told_apart(tmp_path: Path) -> None:
    rows = [f"{k};{('a', 'b')[k % 2]};{20 + 30 * (k % 2)},5" for k in range(40)]
    record = _read(tmp_path, "time_s;device;T_in_C", rows)
    assert {name: np.nanmean(values) for name, values in record.columns.items()} == {"a_T_in_C": 20.5, "b_T_in_C": 50.5}
    with pytest.raises(RecordError, match="column 'where' names 2 sources"):
        _read(tmp_path, "time_s;where;T_in_C", rows)


def test_each_source_has_the_unit_of_its_rows(tmp_path: Path) -> None:
    rows = [f"{k // 2},{('heater', 'tank')[k % 2]},{('W', '°C')[k % 2]},{700 - 670 * (k % 2)}" for k in range(40)]
    record = _read(tmp_path, "time_s,statistic_id,unit,mean", rows)
    assert {name: values[0] for name, values in record.columns.items()} == {"heater_mean_W": 700, "tank_mean_C": 30}


def test_sources_of_a_parquet_file_are_told_apart(tmp_path: Path) -> None:
    path = tmp_path / "sources.parquet"
    table = {
        "time_s": [float(k) for k in range(40)],
        "device": pa.array(["x", "y"] * 20).dictionary_encode(),
        "T_in_C": [20.0 + 30 * (k % 2) for k in range(40)],
    }
    pq.write_table(pa.table(table), path)
    record = read_record(path)
    assert np.nanmax(record.columns["x_T_in_C"]) == 20 and np.nanmin(record.columns["y_T_in_C"]) == 50


def test_texts_of_another_name_that_alternate_with_a_temperature_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match=r"column 'where' names 2 sources whose rows alternate \('in', 'out'\), or"):
        _read(tmp_path, "time_s,where,T_in_C", _in_turn(["in", "out"]))


def test_rows_of_one_time_name_the_column_that_may_tell_them_apart(tmp_path: Path) -> None:
    rows = [f"{k // 2},{('x', 'y')[k % 2]},{k}" for k in range(40)]
    with pytest.raises(RecordError, match=r"if column 'where' names devices or sensors, call it 'device' for"):
        _read(tmp_path, "time_s,where,fan_W", rows)


@pytest.mark.parametrize(
    ("name", "labels"),
    [
        ("status", ["running"] * 10 + ["stopped"] * 10),
        ("mode", ["heat", "idle"]),
        ("device", ["rig"]),
        ("device", ["first"] * 20 + ["second"] * 20),
        ("phase", ["1", "2"]),
        ("active_channel", ["1", "2"]),
        ("step", ["1"] * 5 + ["2"] * 5),
        ("quality", ["Good", "Good"]),
        ("remark", [f"note {k}" for k in range(40)]),
    ],
)
def test_states_of_one_device_are_no_sources(tmp_path: Path, name: str, labels: list[str]) -> None:
    rows = [f"{k},{labels[k % len(labels)]},{OWN[k]},{700 * (k % 2)}" for k in range(40)]
    record = _read(tmp_path, f"time_s,{name},T_in_C,heater_W", rows)
    assert record.columns["T_in_C"] == pytest.approx(OWN)
