"""Files that were cut off inside their last number."""

from __future__ import annotations

import pytest

from hil.profile.load_profile import read_profile
from hil.record.reader import read_record

ROWS = [(10 * k, 500 + k, f"{20 + 0.11 * k:.2f}") for k in range(12)]


def read(tmp_path, text):
    path = tmp_path / "record.csv"
    path.write_bytes(text.encode())
    return read_record(path)


def table(last, end, rows=ROWS):
    lines = [f"{time},{power},{tank}" for time, power, tank in rows]
    return "time_s,heater_W,T_tank_C\n" + "\n".join(lines) + f"\n{last}{end}"


@pytest.mark.parametrize("last", ["120,512,2", "120,512,21", "120,512,21.", "120,512,21.3"])
def test_a_last_number_with_fewer_decimals_and_no_line_end_is_dropped_with_its_line(tmp_path, last):
    record = read(tmp_path, table(last, ""))
    assert len(record.time_s) == 12
    assert record.columns["T_tank_C"].min() >= 20.0
    (said,) = [m for m in record.messages if "cut off" in m]
    assert "line 14" in said and "T_tank_C" in said


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_last_line_that_ends_is_kept(tmp_path, end):
    record = read(tmp_path, table("120,512,21", end))
    assert len(record.time_s) == 13
    assert not any("cut off" in m for m in record.messages)


def test_a_complete_last_number_without_a_line_end_is_kept(tmp_path):
    record = read(tmp_path, table("120,512,21.32", ""))
    assert record.columns["T_tank_C"][-1] == 21.32
    assert not any("cut off" in m for m in record.messages)


def test_a_writer_that_leaves_zeros_out_is_no_sign_of_a_cut(tmp_path):
    rows = [(time, power, str(float(tank) if time else 20)) for time, power, tank in ROWS]
    assert len(read(tmp_path, table("120,512,21", "", rows)).time_s) == 13


def test_a_power_of_ten_that_lacks_digits_is_cut(tmp_path):
    rows = [(time, power, f"{float(tank):.3e}") for time, power, tank in ROWS]
    assert len(read(tmp_path, table("120,512,2.132e+0", "", rows)).time_s) == 12


def test_a_shorter_whole_number_is_kept_and_asked_about(tmp_path):
    text = "time_s,T_tank_C,heater_W\n" + "".join(f"{t},{c},{p}\n" for t, p, c in ROWS) + "120,21.32,51"
    record = read(tmp_path, text)
    assert record.columns["heater_W"][-1] == 51.0
    assert any("'51' of heater_W (line 14)" in m and m.endswith("cut off there?") for m in record.messages)


@pytest.mark.parametrize(("end", "notes"), [("80", 1), ("800", 0), ("80\n", 0)])
def test_a_profile_whose_last_number_may_be_cut_gets_a_note(tmp_path, end, notes):
    path = tmp_path / "load.csv"
    path.write_text(f"time_s,heater_power_W\n0,300\n600,800\n1200,{end}")
    found = read_profile(path).notes
    assert len(found) == notes
    assert all("line 4 ends in 80" in note for note in found)
