"""Numbers of a record: one decimal sign for a column, and nothing believed that no instrument reads."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from drivers.signals.units import PLAUSIBLE, SUFFIX_OF_UNIT, column_name
from hil.record.reader import ReadingOptions, Record, RecordError, read_record
from hil.record.values.numbers import readings

POWERS = [480 + 37 * k for k in range(30)]
"""480 W to 1553 W: some below a thousand, more above."""


def _read(tmp_path: Path, text: str, **choice: object) -> Record:
    path = tmp_path / "numbers.csv"
    path.write_text(text, encoding="utf-8")
    return read_record(path, choice=ReadingOptions(**choice))  # type: ignore[arg-type]


def _table(heading: str, row: Callable[[int], str], rows: int = 30) -> str:
    return heading + "\n" + "".join(row(k) + "\n" for k in range(rows))


def _swiss(value: float) -> str:
    return f"{value:,.1f}".replace(",", "'")


@pytest.mark.parametrize(
    "text",
    [
        _table("time_s;T_in_C;pump_W", lambda k: f"{k};2{k % 10},5;" + f"{POWERS[k]:,}".replace(",", ".")),
        _table("time_s;T_in_C;pump_W", lambda k: f"{k};21,5;" + f"{POWERS[k]:,}".replace(",", ".") + ",0"),
        _table("time_s,T_in_C,pump_W", lambda k: f'{k},21.5,"{POWERS[k]:,}"'),
        _table("time_s,T_in_C,pump_W", lambda k: f'{k},21.5,"{POWERS[k]:,}.0"'),
        _table("time_s;T_in_C;pump_W", lambda k: f"{k};21.5;{_swiss(POWERS[k])}"),
        _table("time_s\tT_in_C\tpump_W", lambda k: f"{k}\t21.5\t" + f"{POWERS[k]:,}".replace(",", "\u202f")),
        _table("time_s\tT_in_C\tpump_W", lambda k: f"{k}\t21.500\t{POWERS[k]}.000"),
    ],
)
def test_marks_between_thousands_are_told_from_decimal_signs_by_the_other_numbers(tmp_path: Path, text: str) -> None:
    record = _read(tmp_path, text)
    assert record.columns["pump_W"].tolist() == POWERS
    assert np.nanmax(record.columns["T_in_C"]) < 30


@pytest.mark.parametrize(
    ("heading", "row", "point", "comma"),
    [
        ("time_s;pump_W", lambda k: f"{k};{2 + k / 8:.3f}", 2.0, 2000.0),
        ("time_s,pump_W", lambda k: f'{k},"{2 + k},000"', 2000.0, 2.0),
    ],
)
def test_a_column_that_may_be_read_in_two_ways_is_refused_until_the_sign_is_given(
    tmp_path: Path, heading: str, row: Callable[[int], str], point: float, comma: float
) -> None:
    text = _table(heading, row)
    with pytest.raises(RecordError, match=r"column 'pump_W' can be read in two ways: line 2, .* give --decimal"):
        _read(tmp_path, text)
    assert _read(tmp_path, text, decimal=".").columns["pump_W"][0] == point
    assert _read(tmp_path, text, decimal=",").columns["pump_W"][0] == comma


def test_a_file_with_commas_between_columns_has_decimal_points(tmp_path: Path) -> None:
    record = _read(tmp_path, _table("time_s,pump_W", lambda k: f"{k},{2 + k / 8:.3f}"))
    assert record.columns["pump_W"][1] == 2.125


def test_a_temperature_that_only_one_sign_makes_possible_settles_the_file(tmp_path: Path) -> None:
    record = _read(tmp_path, _table("time_s;T_in_C;pump_W", lambda k: f"{k};41.{k:03};{600 + k}.125"))
    assert record.columns["T_in_C"][3] == 41.003 and record.columns["pump_W"][3] == 603.125


def test_a_column_that_mixes_both_signs_is_refused(tmp_path: Path) -> None:
    text = _table("time_s;T_in_C", lambda k: f"{k};" + (f"{k},5" if k % 2 else f"{k}.5"))
    with pytest.raises(RecordError, match=r"'T_in_C' has decimal points \(line 2, '0.5'\) and decimal commas \(line 3"):
        _read(tmp_path, text)


@pytest.mark.parametrize(
    ("cell", "expected"),
    [
        ("12", (12, 12)),
        ("-1.5e-3", (-0.0015, None)),
        ("1,5E3", (None, 1500)),
        ("0.125", (0.125, None)),
        ("1.125", (1.125, 1125)),
        ("1,125", (1125, 1.125)),
        ("1234.125", (1234.125, None)),
        ("1.234.567", (None, 1234567)),
        ("12,34,567.8", (1234567.8, None)),
        ("\u22127,5", (None, -7.5)),
        ("1 234,5", (None, 1234.5)),
        ("1.2.3", (None, None)),
        ("1_000", (None, None)),
        (".", (None, None)),
        ("\u0663", (None, None)),
    ],
)
def test_a_cell_is_read_with_either_sign_or_not_at_all(cell: str, expected: tuple[float | None, float | None]) -> None:
    assert readings(cell) == expected


@pytest.mark.parametrize("unit", [unit for unit in SUFFIX_OF_UNIT if unit != "1"])
@pytest.mark.parametrize("overload", [9.9e37, -9.9e37, 1e30])
def test_an_overload_is_missing_in_every_unit(tmp_path: Path, unit: str, overload: float) -> None:
    name = column_name("x", unit)
    text = _table(f"time_s,{name}", lambda k: f"{k},{overload if k == 4 else k % 5}")
    record = _read(tmp_path, text)
    assert np.flatnonzero(np.isnan(record.columns[name])).tolist() == [4]
    assert any("(the first, line 6, is" in said and said.endswith("missing") for said in record.messages)


def test_every_unit_has_a_plausible_range_around_zero() -> None:
    assert set(PLAUSIBLE) == set(SUFFIX_OF_UNIT)
    assert all(low < 0.0 < high for low, high in PLAUSIBLE.values())


def test_the_range_is_that_of_the_unit_after_conversion(tmp_path: Path) -> None:
    record = _read(
        tmp_path, _table("time_s,T_in_K,heater_power_kW", lambda k: f"{k},{300 if k else -5},{9 if k else 2e4}")
    )
    assert np.isnan(record.columns["T_in_C"][0]) and np.isnan(record.columns["heater_power_W"][0])
    assert record.columns["T_in_C"][1] == pytest.approx(26.85) and record.columns["heater_power_W"][1] == 9000


def test_a_column_without_a_unit_holds_what_a_register_can(tmp_path: Path) -> None:
    record = _read(tmp_path, _table("time_s,count", lambda k: f"{k},{9.9e37 if k == 2 else 2**63}"))
    assert np.isnan(record.columns["count"]).sum() == 1


def test_a_column_that_is_outside_throughout_is_asked_about(tmp_path: Path) -> None:
    record = _read(tmp_path, _table("time_s,T_in_C,T_out_C", lambda k: f"{k},{20_000 + k},20"))
    assert any("T_in_C: 30 values are outside" in s and "is the column in another unit?" in s for s in record.messages)


def test_a_range_that_the_file_declares_is_used(tmp_path: Path) -> None:
    path = tmp_path / "declared.parquet"
    fields = [pa.field("time_s", pa.float64()), pa.field("T_in_C", pa.float64(), metadata={"plausible": "[0, 60]"})]
    pq.write_table(pa.table([[0.0, 1.0, 2.0], [20.0, 61.0, 21.0]], schema=pa.schema(fields)), path)
    assert np.isnan(read_record(path).columns["T_in_C"]).tolist() == [False, True, False]


@pytest.mark.parametrize("code", [85.0, -127.0, 850.0, 327.67, 999.9])
def test_a_code_far_from_all_readings_is_missing(tmp_path: Path, code: float) -> None:
    record = _read(tmp_path, _table("time_s,T_in_C", lambda k: f"{k},{code if k % 9 == 4 else 20 + k / 10}"))
    assert np.flatnonzero(np.isnan(record.columns["T_in_C"])).tolist() == [4, 13, 22]


@pytest.mark.parametrize(
    ("heading", "row"),
    [
        ("time_s,T_in_C", lambda k: f"{k},{70 + k}"),  # passes through 85
        ("time_s,T_in_C", lambda k: f"{k},{85 if k > 20 else 20 + 3 * k}"),  # goes up to 85 and stays
        ("time_s,pump_W", lambda k: f"{k},{9999 if k % 9 == 4 else 0}"),  # on or off
        ("time_s,pump_pct", lambda k: f"{k},{85 if k % 9 == 4 else 20 + k / 10}"),  # an input may jump
    ],
)
def test_a_reading_that_only_looks_like_a_code_is_kept(tmp_path: Path, heading: str, row: Callable[[int], str]) -> None:
    record = _read(tmp_path, _table(heading, row))
    assert not any(np.isnan(values).any() for values in record.columns.values())


def test_words_of_an_instrument_are_missing_and_other_words_are_refused(tmp_path: Path) -> None:
    def row(word: str) -> Callable[[int], str]:
        return lambda k: f"{k},{word if k % 6 == 3 else 20 + k / 10}"

    record = _read(tmp_path, _table("time_s,T_in_C", row("OVLD")))
    assert np.isnan(record.columns["T_in_C"]).sum() == 5
    assert any("5 cells are no numbers (the first, line 5, is 'OVLD'): missing" in said for said in record.messages)
    with pytest.raises(RecordError, match=r"column 'T_in_C' has 5 of 30 cells that are no numbers \(the first, line 5"):
        _read(tmp_path, _table("time_s,T_in_C", row("20 bis 21")))


def test_a_cell_with_a_line_break_does_not_break_the_sentence() -> None:
    assert str(RecordError("line 2, 'a\nb', is no number")) == "line 2, 'a b', is no number"
