"""Messages about cells, times, units and names that a logger or a spreadsheet has written in another form."""

from __future__ import annotations

import datetime

import numpy as np
import pytest
from click.testing import CliRunner

from hil.cli import group
from hil.record.raw import RecordError
from hil.record.reader import read_record


def read(tmp_path, text, encoding="utf-8"):
    path = tmp_path / "record.csv"
    path.write_bytes(text.encode(encoding))
    return read_record(path)


def rows(cells, times=None):
    times = times or [10 * k for k in range(len(cells))]
    return "".join(f"{time},{cell}\n" for time, cell in zip(times, cells, strict=True))


@pytest.mark.parametrize(
    ("name", "cells", "shown"),
    [
        ("heater_power_W", ["1.20 K"] * 6, "1.20 K"),
        ("heater_power_W", ["1.20k"] * 6, "1.20k"),
        ("heater", ["1.20 K"] * 6, "1.20 K"),
        ("heater", ["990", "995", "1.01 K", "1.02 K", "1.03 K", "1.04 K"], "1.01 K"),
        ("flow_L_per_min", ["5.9 m", "6.1 m"] * 3, "5.9 m"),
    ],
)
def test_a_prefix_in_place_of_a_unit_is_refused(tmp_path, name, cells, shown):
    with pytest.raises(RecordError, match=rf"'{shown}' \(line \d\), where '.' may stand for a multiple"):
        read(tmp_path, f"time_s,{name}\n{rows(cells)}")


@pytest.mark.parametrize("name", ["T_tank", "tank_K", "T_tank_K"])
def test_cells_in_kelvin_are_no_multiples(tmp_path, name):
    record = read(tmp_path, f"time_s,{name}\n{rows([f'{293 + k} K' for k in range(6)])}")
    assert len(record.columns) == 1


def test_a_check_takes_one_reading_a_row_for_a_record_whatever_its_time_is_called(tmp_path):
    path = tmp_path / "table.csv"
    lines = [f"{10 * k},{name},{value}" for k in range(30) for name, value in (("tank_C", 30 + k), ("heater_W", 600))]
    path.write_text("time_s,series,value\n" + "\n".join(lines) + "\n")
    done = CliRunner().invoke(group, ["check", str(path)])
    assert done.exit_code == 0 and "30 samples" in done.output and "load profile" not in done.output


def test_minutes_without_hours_get_the_remedy_of_a_spreadsheet(tmp_path):
    times = [f"{k // 2:02}:{30 * (k % 2):02}.0" for k in range(6)]
    with pytest.raises(RecordError, match=r"'00:00\.0' looks like minutes and seconds .* hh:mm:ss"):
        read(tmp_path, "Time,T_tank_C\n" + rows([20, 21, 22, 23, 24, 25], times))


def test_minutes_that_run_on_beyond_the_hour_are_read(tmp_path):
    times = [f"{58 + k // 2}:{30 * (k % 2):02}.0" for k in range(6)]
    assert read(tmp_path, "Time,T_tank_C\n" + rows([20, 21, 22, 23, 24, 25], times)).time_s.tolist() == [
        *range(0, 180, 30)
    ]


@pytest.mark.parametrize(
    ("name", "times", "why"),
    [
        (
            "Elapsed time (h)",
            [f"{k // 4 / 100:.2f}" for k in range(40)],
            r"'0\.00' has too few digits .* more decimals",
        ),
        ("Date", [f"{46085.42 + k // 20 / 100:.2f}" for k in range(40)], r"'46085\.42' has too few digits"),
        ("timestamp", [f"{1.77262e12 + 1e7 * (k // 20):.5E}" for k in range(40)], r"without an exponent"),
    ],
)
def test_times_with_too_few_digits_say_so(tmp_path, name, times, why):
    with pytest.raises(RecordError, match=why):
        read(tmp_path, f"{name},T_tank_C\n" + rows([f"{20 + 0.1 * k:.1f}" for k in range(40)], times))


def test_a_column_of_utc_is_taken_before_one_of_local_times(tmp_path):
    lines = "".join(f"2026-03-04 11:00:{k:02},2026-03-04 10:00:{k:02},{20 + k}\n" for k in range(6))
    record = read(tmp_path, "Local Time,UTC,T_tank_C\n" + lines)
    assert record.start == datetime.datetime(2026, 3, 4, 10, tzinfo=datetime.UTC)


@pytest.mark.parametrize(
    ("unit", "encoding", "sign", "cause"),
    [
        ("Â°C", "utf-8", "Â°", "read as Latin-1"),
        ("?C", "utf-8", r"\?", "lacks; write °"),
        ("°C", "cp437", "ø", "code page 437"),
        ("°C", "mac_roman", "¡", "Mac Roman"),
    ],
)
def test_a_broken_degree_sign_is_named_with_its_encoding(tmp_path, unit, encoding, sign, cause):
    record = read(tmp_path, f"time_s,T_tank [{unit}]\n{rows(range(20, 26))}", encoding)
    said = [m for m in record.messages if cause in m]
    assert len(said) == 1 and f"has '{sign.removeprefix(chr(92))}' in its unit" in said[0]


def test_a_heading_that_stands_twice_keeps_its_unit(tmp_path):
    record = read(tmp_path, "time_s,Temp [°C],Temp [°C]\n" + "".join(f"{k},{20 + k},{30 + k}\n" for k in range(6)))
    assert list(record.columns) == ["Temp_C", "Temp_2_C"]
    assert record.columns["Temp_2_C"][0] == 30.0


def test_series_of_a_sensor_on_several_devices_are_named_by_both(tmp_path):
    lines = "".join(f"2026-03-04 10:00:{k:02},{d},T_tank_C,{20 + k}\n" for k in range(6) for d in "ab")
    assert set(read(tmp_path, "time,device,sensor,value\n" + lines).columns) == {"a_T_tank_C", "b_T_tank_C"}
    both = "".join(f"2026-03-04 10:00:{k:02},dev{d},T_{d}_C,{20 + k}\n" for k in range(6) for d in "ab")
    assert set(read(tmp_path, "time,device,sensor,value\n" + both).columns) == {"T_a_C", "T_b_C"}


def test_channels_are_named_by_a_line_of_tags_below_them(tmp_path):
    text = '"Date","Time","CH1","CH2"\n"","","T_tank","heater"\n"","","C","W"\n'
    text += "".join(f"2026/03/04,10:00:{k:02},{20 + k},{500 + k}\n" for k in range(6))
    record = read(tmp_path, text.replace('"C"', '"°C"'))
    assert list(record.columns) == ["T_tank_C", "heater_W"]
    assert "line 2 names the channels" in record.messages
    assert np.allclose(record.columns["heater_W"], 500.0 + np.arange(6))
