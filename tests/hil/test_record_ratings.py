"""Columns of a record that rate the values of others: words, flags and codes, in wide and in long tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hil.record.reader import Record, read_record

BAD = (4, 9)


def _read(tmp_path: Path, lines: list[str]) -> Record:
    path = tmp_path / "rated.csv"
    path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
    return read_record(path)


def _wide(heading: str, good: str, bad: str) -> list[str]:
    return [heading, *(f"{k};{20 + k / 4};{bad if k in BAD else good}" for k in range(20))]


def _missing(record: Record, column: str) -> list[int]:
    return np.flatnonzero(np.isnan(record.columns[column])).tolist()


@pytest.mark.parametrize(
    "heading",
    [
        *(
            "T_in_C quality",
            "T_in_C.Quality",
            "T_in Status",
            "Status T_in_C",
            "Quality (T_in_C)",
            "T_in_C-Qualität",
            "T_in Quality Code",
        ),
        *("Status", "Quality", "T_in_Zustand", "T_in Quality Code"),
    ],
)
@pytest.mark.parametrize(("good", "bad"), [("Good", "Bad"), ("OK", "Fehler"), ("gut", "Störung"), ("TRUE", "FALSE")])
def test_values_that_words_rate_bad_are_missing(tmp_path: Path, heading: str, good: str, bad: str) -> None:
    record = _read(tmp_path, _wide(f"time_s;T_in_C;{heading}", good, bad))
    assert _missing(record, "T_in_C") == list(BAD)
    assert any(f"2 values are bad by '{heading}' (words; the first is line 6): missing" in m for m in record.messages)


@pytest.mark.parametrize(
    ("name", "good", "bad"),
    [
        ("valid", "1", "0"),
        ("T_in_C_valid", "1", "0"),
        ("T_in_fault", "0", "1"),
        ("T_in_error", "false", "true"),
        ("T_in_fault", "", "Drahtbruch"),
        ("T_in status", "ok", "open"),
        ("T_in_C status", "0x00000000", "0x80000000"),
    ],
)
def test_a_mark_is_read_with_the_sense_of_its_name(tmp_path: Path, name: str, good: str, bad: str) -> None:
    assert _missing(_read(tmp_path, _wide(f"time_s;T_in_C;{name}", good, bad)), "T_in_C") == list(BAD)


def test_a_repeated_status_rates_the_column_before_it(tmp_path: Path) -> None:
    rows = [f"{k};{20 + k / 4};{'Bad' if k == 4 else 'OK'};{500 + k};{'Bad' if k == 7 else 'OK'}" for k in range(20)]
    record = _read(tmp_path, ["time_s;T [°C];Status;P [W];Status", *rows])
    assert _missing(record, "T_C") == [4] and _missing(record, "P_W") == [7]


def test_a_status_with_decimal_commas_before_it_is_used(tmp_path: Path) -> None:
    record = _read(tmp_path, [line.replace(".", ",") for line in _wide("time_s;T_in_C;Status", "OK", "Fehler")])
    assert _missing(record, "T_in_C") == list(BAD)


@pytest.mark.parametrize("word", ["Uncertain", "fraglich", "Suspect"])
def test_an_uncertain_value_stays_and_is_counted(tmp_path: Path, word: str) -> None:
    record = _read(tmp_path, _wide("time_s;T_in_C;T_in_C quality", "Good", word))
    assert _missing(record, "T_in_C") == []
    assert any("2 values are uncertain by 'T_in_C quality' (the first is line 6): kept" in m for m in record.messages)


def test_a_word_of_no_known_rating_is_named_with_its_line(tmp_path: Path) -> None:
    record = _read(tmp_path, _wide("time_s;T_in_C;T_in_C status", "Good", "Wartung"))
    assert _missing(record, "T_in_C") == []
    assert any("'Wartung' in 'T_in_C status' (line 6; 2 rows) is no known rating" in m for m in record.messages)


@pytest.mark.parametrize(
    ("heading", "good", "bad"),
    [
        ("valve_status", "closed", "open"),  # the state of a device
        ("Status", "RUN", "STOP"),
        ("state", "OK", "Fault"),  # of a machine
        ("pump_status", "0", "1"),
        ("T_in_C_quality", "1", "0"),  # of no known kind
        ("note", "good", "bad"),
        ("error_W", "0", "1"),
    ],
)
def test_columns_that_rate_no_value_take_none(tmp_path: Path, heading: str, good: str, bad: str) -> None:
    record = _read(tmp_path, _wide(f"time_s;T_in_C;{heading}", good, bad))
    assert _missing(record, "T_in_C") == []


@pytest.mark.parametrize(("good", "bad"), [(True, False), ("OK", "FAULT"), (192, 0)])
def test_ratings_of_a_parquet_file_are_used(tmp_path: Path, good: object, bad: object) -> None:
    marks = [bad if k in BAD else good for k in range(20)]
    path = tmp_path / "rated.parquet"
    pq.write_table(pa.table({"time_s": np.arange(20.0), "T_in_C": np.linspace(20, 25, 20), "T_in_status": marks}), path)
    assert _missing(read_record(path), "T_in_C") == list(BAD)


@pytest.mark.parametrize(
    ("column", "good", "bad"),
    [("quality", "True", "False"), ("status", "OK", "FAULT"), ("Status", "gut", "Fehler"), ("valid", "1", "0")],
)
def test_readings_that_are_rated_bad_are_missing_in_a_table_of_readings(
    tmp_path: Path, column: str, good: str, bad: str
) -> None:
    rows = [f"{k},T_in_C,{20 + k / 4},{bad if k in BAD else good}" for k in range(20)]
    record = _read(tmp_path, [f"time,tag,value,{column}", *rows])
    assert list(record.columns) == ["T_in_C"] and _missing(record, "T_in_C") == list(BAD)
    assert any("2 readings are not of good quality (the first is line 6): missing" in m for m in record.messages)


def test_flags_of_a_reading_name_no_series(tmp_path: Path) -> None:
    rows = [f"{k},T_in_C,{20 + k / 4},{k == 4},False,{k == 9}" for k in range(20)]
    record = _read(tmp_path, ["time,tag,value,Questionable,Annotated,Locked", *rows])
    assert list(record.columns) == ["T_in_C"] and _missing(record, "T_in_C") == []
    assert "1 readings are uncertain by 'Questionable' (the first is line 6): kept" in record.messages
    assert "column 'Locked' holds True and False alone: not used" in record.messages
