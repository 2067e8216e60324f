"""Times whose form a heading or a second column states, and messages that name the right column."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.record.reader import Record, RecordError, read_record


def _read(tmp_path: Path, text: str) -> Record:
    path = tmp_path / "times.csv"
    path.write_text(text, encoding="utf-8")
    return read_record(path)


@pytest.mark.parametrize(
    ("heading", "step_s"),
    [
        ("Time [hh:mm]", 60.0),
        ("Zeit (hh:mm)", 60.0),
        ("Time (h:mm)", 60.0),
        ("Time [mm:ss]", 1.0),
        ("Elapsed (m:ss)", 1.0),
    ],
)
def test_a_heading_says_whether_two_numbers_are_hours_or_minutes(tmp_path: Path, heading: str, step_s: float) -> None:
    rows = "".join(f"{k // 60:02d}:{k % 60:02d},20\n" for k in range(0, 300, 15))
    record = _read(tmp_path, f"{heading},T_in_C\n{rows}")
    assert np.diff(record.time_s) == pytest.approx([15 * step_s] * 19)


def test_minutes_and_seconds_run_on_beyond_an_hour(tmp_path: Path) -> None:
    record = _read(tmp_path, "Time [mm:ss],T_in_C\n" + "".join(f"{k}:00,20\n" for k in range(50, 70)))
    assert np.diff(record.time_s) == pytest.approx([60.0] * 19)


@pytest.mark.parametrize(
    ("whole", "part", "scale"), [("secs", "nsecs", 1e9), ("sec", "usec", 1e6), ("seconds", "ms", 1e3)]
)
def test_seconds_and_their_parts_in_two_columns_are_one_time(
    tmp_path: Path, whole: str, part: str, scale: float
) -> None:
    rows = "".join(f"{1772618280 + k // 4},{k % 4 * scale / 4:.0f},20\n" for k in range(40))
    record = _read(tmp_path, f"{whole},{part},T_in_C\n{rows}")
    assert np.diff(record.time_s) == pytest.approx([0.25] * 39)


def test_stamps_in_whole_minutes_name_the_column_that_counts_in_finer_steps(tmp_path: Path) -> None:
    rows = "".join(f"2026-03-04 10:{k // 2:02d},{30 * k},{20 + k}\n" for k in range(40))
    with pytest.raises(RecordError, match=r"column 'Elapsed s' counts in finer steps: --time-column 'Elapsed s'"):
        _read(tmp_path, f"Timestamp,Elapsed s,T_in_C\n{rows}")


@pytest.mark.parametrize("blank", ["\u202f", "\u00a0", "\u2009", " "])
def test_any_blank_may_stand_before_am_and_pm(tmp_path: Path, blank: str) -> None:
    rows = "".join(f'"3/14/2026, {9 + k // 30}:{k % 30:02d}:00{blank}AM",20\n' for k in range(20))
    record = _read(tmp_path, f"Time,T_in_C\n{rows}")
    assert np.diff(record.time_s) == pytest.approx([60.0] * 19)


@pytest.mark.parametrize("first", ["LabVIEW Measurement", "LabVIEW Measurement\t", "LabVIEW Measurement,"])
@pytest.mark.parametrize("stated", ["Separator,Comma\n", ""])
def test_labviews_first_line_may_have_another_separator(tmp_path: Path, first: str, stated: str) -> None:
    head = f"{first}\nWriter_Version,2\n{stated}Multi_Headings,Yes\nX_Columns,No\nDate,2026/03/04\nTime,09:58:00\n"
    segment = "***End_of_Header***\n\nChannels,1\nSamples,9\nDate,2026/03/04\nTime,09:58:00\nX0,0.0\nDelta_X,30\n"
    rows = "***End_of_Header***\nX_Value,T_in_C,Comment\n" + "".join(f",{20 + k}.5\n" for k in range(9))
    record = _read(tmp_path, head + segment + rows)
    assert record.time_s == pytest.approx([30.0 * k for k in range(9)])
    assert record.columns["T_in_C"].tolist() == [20.5 + k for k in range(9)]


@pytest.mark.parametrize(("day", "asks"), [(44623, True), (48000, False)])
def test_day_numbers_that_may_count_from_1904_are_named(tmp_path: Path, day: int, asks: bool) -> None:
    record = _read(tmp_path, "Date,T_in_C\n" + "".join(f"{day + k / 2880:.8f},20\n" for k in range(20)))
    assert any("counts from 1904 the record begins on 2026-03-04" in said for said in record.messages) == asks


def test_two_names_for_one_column_are_named(tmp_path: Path) -> None:
    record = _read(tmp_path, "time_s,T_in_C,T_in [°C]\n" + "".join(f"{k},20,30\n" for k in range(9)))
    assert list(record.columns) == ["T_in_C", "T_in [°C]"]
    assert any("'T_in [°C]' is kept under this name without a unit, since there is" in said for said in record.messages)
