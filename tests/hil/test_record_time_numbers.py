"""Times of a record that are numbers: the unit of the name, day numbers, counts since 1970, digits of a date."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hil.cli.group import group

from hil.record.reader import Record, RecordError, read_record


def _read(tmp_path: Path, name: str, stamps: list[str]) -> Record:
    path = tmp_path / "numbers.csv"
    path.write_text(f"{name},T_in_C\n" + "".join(f"{s},{20 + k}\n" for k, s in enumerate(stamps)), encoding="utf-8")
    return read_record(path)


@pytest.mark.parametrize(
    ("name", "first", "step", "seconds"),
    [
        ("t [ms]", 250_000_000, 500, 0.5),
        ("elapsed_us", 7_200_000_000, 250_000, 0.25),
        ("time (min)", 1_000_000, 5, 300.0),
        ("time_s", 200_000_000, 10, 10.0),
    ],
)
def test_a_unit_in_the_name_wins_over_the_size_of_the_numbers(
    tmp_path: Path, name: str, first: int, step: int, seconds: float
) -> None:
    record = _read(tmp_path, name, [str(first + k * step) for k in range(20)])
    assert np.diff(record.time_s) == pytest.approx([seconds] * 19) and record.start is None


@pytest.mark.parametrize(("name", "per_s"), [("time_ms", 1000), ("time_min", 1 / 60), ("time_s", 1000), ("t_s", 1)])
def test_a_count_since_1970_in_a_named_unit_is_a_date(tmp_path: Path, name: str, per_s: float) -> None:
    record = _read(tmp_path, name, [f"{(1_780_000_020 + 60 * k) * per_s:.0f}" for k in range(20)])
    assert record.start is not None and record.start.timestamp() == 1_780_000_020 // 60 * 60
    assert record.time_s[-1] == pytest.approx(19 * 60)


@pytest.mark.parametrize("decimals", [4, 5, 6])
@pytest.mark.parametrize("period_s", [120, 3600])
def test_rounded_day_numbers_of_a_spreadsheet_are_days(tmp_path: Path, decimals: int, period_s: int) -> None:
    record = _read(tmp_path, "Time", [f"{45_800.3 + k * period_s / 86400:.{decimals}f}" for k in range(40)])
    assert record.time_s[-1] == pytest.approx(39 * period_s, abs=86400 * 10.0**-decimals)
    assert record.start is not None and record.start.year == 2025


@pytest.mark.parametrize("first", [0.0, 0.25])
def test_parts_of_days_without_a_unit_are_refused_and_read_with_one(tmp_path: Path, first: float) -> None:
    stamps = [f"{first + k * 30 / 86400:.8f}" for k in range(40)]
    with pytest.raises(RecordError, match=r"column 'time'.* looks like a .*day.*give --time-scale 86400, or time_d"):
        _read(tmp_path, "time", stamps)
    assert np.ptp(_read(tmp_path, "time_d", stamps).time_s) == pytest.approx(39 * 30, abs=0.01)


@pytest.mark.parametrize("name", ["time", "Date", "time_d"])
@pytest.mark.parametrize("first", [45_857.5, 60_875.5, 739_817.5, 2_460_876.0])
def test_every_count_of_days_gives_the_same_date(tmp_path: Path, first: float, name: str) -> None:
    record = _read(tmp_path, name, [f"{first + k * 30 / 86400:.8f}" for k in range(40)])
    assert record.time_s[-1] == pytest.approx(39 * 30, abs=0.01)
    assert record.start is not None and f"{record.start:%Y-%m-%d %H}" == "2025-07-19 12"


@pytest.mark.parametrize("name", ["MJD", "mjd [d]", "Modified Julian Date"])
def test_a_modified_julian_date_is_a_time_by_its_name(tmp_path: Path, name: str) -> None:
    record = _read(tmp_path, name, [f"{60_865 + k}" for k in range(20)])
    assert record.time_s[-1] == 19 * 86400 and record.start is not None and record.start.year == 2025


@pytest.mark.parametrize("step", [0.001, 0.02, 0.1, 1 / 60, 0.5])
def test_fast_seconds_without_a_unit_stay_seconds(tmp_path: Path, step: float) -> None:
    assert _read(tmp_path, "time", [f"{k * step:.6f}" for k in range(50)]).time_s[-1] == pytest.approx(49 * step)


@pytest.mark.parametrize("stamps", [["46000.1", "46000.2", "46000.3"], ["46000.12", "46000.19", "46000.47"]])
def test_numbers_that_may_be_days_or_seconds_are_refused(tmp_path: Path, stamps: list[str]) -> None:
    with pytest.raises(RecordError, match="looks like a day number of a spreadsheet"):
        _read(tmp_path, "Time", stamps)


@pytest.mark.parametrize("pattern", ["202507{:02}1155", "2507{:02}115500", "2507{:02}1155"])
def test_digits_of_a_date_are_a_date(tmp_path: Path, pattern: str) -> None:
    record = _read(tmp_path, "Time", [pattern.format(k) for k in range(1, 20)])
    assert np.diff(record.time_s).tolist() == [86400.0] * 18
    assert record.start is not None and f"{record.start:%Y-%m-%d %H:%M}" == "2025-07-01 11:55"


@pytest.mark.parametrize("first", [133_900_000_000_000_000, 175_000_000_000, 500_000_000])
def test_counts_that_are_no_date_of_this_century_are_refused(tmp_path: Path, first: int) -> None:
    with pytest.raises(RecordError, match="is no time between 2000 and 2100"):
        _read(tmp_path, "time", [str(first + 100 * k) for k in range(20)])


def test_the_check_of_a_file_prints_the_span_of_its_times(tmp_path: Path) -> None:
    path = tmp_path / "late.csv"
    path.write_text("time_s,T_in_C\n" + "".join(f"{720_000 + 60 * k},20\n" for k in range(31)), encoding="utf-8")
    printed = CliRunner().invoke(group, ["check", str(path)]).output
    assert "31 samples over 0.50 h" in " ".join(printed.split())
