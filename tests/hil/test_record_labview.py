"""LabVIEW measurement files: segments, columns of x, dates and decimal signs."""

from __future__ import annotations

import datetime
from pathlib import Path

import numpy as np
import pytest

from hil.record.reader import Record, RecordError, read_record
from tests.hil.command_line import hil

CLOCK = "10:00:00,345000011920928955078"


def head(x_columns: str, sign: str = ".") -> str:
    keys = {"Writer_Version": "2", "Separator": "Tab", "Decimal_Separator": sign, "Multi_Headings": "Yes"}
    keys |= {"X_Columns": x_columns, "Time_Pref": "Absolute", "Date": "2026/03/04", "Time": CLOCK}
    return "LabVIEW Measurement\t\n" + "".join(f"{k}\t{v}\n" for k, v in keys.items()) + "***End_of_Header***\t\n\t\n"


def segment(
    x_columns: str, rows: int = 20, *, clock: str = CLOCK, x0: float = 0.0, sign: str = ".", more: str = ""
) -> str:
    apart = "\t\t" if x_columns == "Multi" else "\t"
    header = {"Channels": "2", "Samples": "10", "Date": "2026/03/04", "Time": clock, "Y_Unit_Label": "Deg C"}
    header |= {"X_Dimension": "Time", "X0": f"{x0:.6f}", "Delta_X": "0.500000"}
    text = "Channels\t2\t\t\n" + "".join(
        f"{tag}\t{value}{apart}{value if tag != 'Y_Unit_Label' else 'W'}\t\n" for tag, value in header.items()
    )
    names = ("Tank", "X_Value\tPower") if x_columns == "Multi" else ("Tank", "Power")
    text += "***End_of_Header***\t\t\t\nX_Value\t" + "\t".join(names) + "\tComment\n"
    for row in range(rows):
        x = "" if x_columns == "No" else f"{x0 + 0.5 * row:.6f}"
        cells = (x, f"{20 + row / 8:.6f}", *([x] if x_columns == "Multi" else []), "1.234" if row else "700.5")
        text += "\t".join(cells) + (f"\t{more}" if more and not row else "") + "\n"
    return text.replace(".", sign) if sign == "," else text


def read(tmp_path: Path, text: str) -> Record:
    path = tmp_path / "measured.lvm"
    path.write_text(text, encoding="utf-8")
    return read_record(path)


@pytest.mark.parametrize("x_columns", ["One", "Multi", "No"])
@pytest.mark.parametrize("sign", [".", ","])
def test_one_segment_is_read_wherever_its_x_stand(tmp_path, x_columns, sign):
    record = read(tmp_path, head(x_columns, sign) + segment(x_columns, sign=sign, more="began"))
    np.testing.assert_allclose(record.time_s, 0.5 * np.arange(20), atol=1e-9)
    np.testing.assert_allclose(record.columns["Tank_C"], 20 + np.arange(20) / 8)
    assert record.columns["Power_W"][1] == 1.234  # The header decides, where 1,234 alone may be a thousand.
    assert record.start == datetime.datetime(2026, 3, 4, 10, 0, 0, 345000, datetime.UTC)


def test_each_segment_stands_at_its_own_date(tmp_path):
    text = head("One") + segment("One") + "\n" + segment("One", clock="10:01:00.345")
    record = read(tmp_path, text.replace("\n", "\r\n"))
    assert len(record.time_s) == 40
    np.testing.assert_allclose(record.time_s[[0, 19, 20, 39]], [0.0, 9.5, 60.0, 69.5], atol=1e-6)
    assert any("2 segments" in said for said in record.messages)


def test_x_that_go_on_as_the_dates_do_count_from_the_first_date(tmp_path):
    record = read(tmp_path, head("One") + segment("One") + segment("One", clock="10:01:00.345", x0=60.0))
    np.testing.assert_allclose(record.time_s[[19, 20]], [9.5, 60.0], atol=1e-6)


def test_x_and_dates_that_contradict_each_other_are_refused(tmp_path):
    with pytest.raises(RecordError, match=r"begin 20 s and its date 60 s after .*split the file at its segments"):
        read(tmp_path, head("One") + segment("One") + segment("One", clock="10:01:00.345", x0=20.0))


@pytest.mark.parametrize("first", [("One", "."), ("Multi", "."), ("No", "."), ("One", ",")], ids=str)
@pytest.mark.parametrize("second", [("One", "."), ("Multi", "."), ("No", "."), ("One", ",")], ids=str)
def test_a_file_that_was_appended_has_its_own_header(tmp_path, first, second):
    text = head(*first) + segment(first[0], sign=first[1])
    text += "\n" + head(*second) + segment(second[0], sign=second[1], clock="10:01:00.345")
    record = read(tmp_path, text)
    np.testing.assert_allclose(record.time_s[[0, 19, 20, 39]], [0.0, 9.5, 60.0, 69.5], atol=1e-6)
    np.testing.assert_allclose(record.columns["Tank_C"], np.tile(20 + np.arange(20) / 8, 2))
    np.testing.assert_allclose(record.columns["Power_W"], np.tile(np.r_[700.5, np.full(19, 1.234)], 2))


def test_a_segment_without_a_header_begins_at_the_date_of_the_file(tmp_path):
    rows = "X_Value\tTank (Deg C)\tComment\n0.0\t20.0\n0.5\t20.1\n1.0\t20.2\n"
    record = read(tmp_path, head("One") + rows + head("One").replace("10:00:00", "10:00:05") + rows)
    np.testing.assert_allclose(record.time_s, [0.0, 0.5, 1.0, 5.0, 5.5, 6.0], atol=1e-6)
    assert record.start == datetime.datetime(2026, 3, 4, 10, 0, 0, 345000, datetime.UTC)


def test_an_appended_header_that_does_not_end_is_named(tmp_path):
    cut = head("One").replace("***End_of_Header***", "")
    with pytest.raises(RecordError, match=r"line 43 begins a header of LabVIEW that no line 'X_Value'"):
        read(tmp_path, head("One") + segment("One") + cut)


def test_a_later_channel_is_missing_before(tmp_path):
    wider = (
        segment("One", clock="10:01:00.345")
        .replace("Power\tComment", "Power\tRoom\tComment")
        .replace("W\t", "W\tDeg C")
    )
    record = read(tmp_path, head("One") + segment("One") + wider.replace("\t1.234\n", "\t1.234\t21.000000\n"))
    assert np.isnan(record.columns["Room_C"][:21]).all()
    assert (record.columns["Room_C"][21:] == 21.0).all()


def test_large_x_count_from_1904(tmp_path):
    record = read(tmp_path, head("One") + segment("One", x0=3_855_463_200.5))
    assert record.start == datetime.datetime(2026, 3, 4, 10, 0, 0, 500000, datetime.UTC)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("X_Dimension\tTime", "X_Dimension\tFrequency", r"line 18 gives 'Frequency' for the x of the rows"),
        ("X_Value\tTank\tPower\tComment\n", "", r"line 22 holds numbers where a segment begins; write a line X_Value"),
        ("***End_of_Header***", "", r"line 1 begins a header of LabVIEW that no line 'X_Value' with names follows"),
    ],
)
def test_a_file_that_is_no_table_over_time_is_refused_with_the_line(tmp_path, old, new, said):
    with pytest.raises(RecordError, match=said):
        read(tmp_path, (head("One") + segment("One")).replace(old, new))


def test_a_unit_that_changes_between_segments_is_refused(tmp_path):
    later = segment("One", clock="10:01:00.345").replace("Deg C", "Volts")
    with pytest.raises(RecordError, match=r"gives the unit 'Volts' for channel 'Tank', and line 17 gives 'Deg C'"):
        read(tmp_path, head("One") + segment("One") + later)


def test_check_takes_the_file_for_a_record(tmp_path):
    path = tmp_path / "measured.lvm"
    path.write_text(head("No") + segment("No"), encoding="utf-8")
    code, printed = hil("check", path)
    assert code == 0 and "20 samples" in printed
