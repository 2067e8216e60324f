"""Cells of a record beside the plain number: units in them, codes of quality, marks between thousands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.record.reader import Record, RecordError, read_record


def _read(tmp_path: Path, heading: str, rows: list[str]) -> Record:
    path = tmp_path / "cells.csv"
    path.write_text("".join(f"{line}\n" for line in [heading, *rows]), encoding="utf-8")
    return read_record(path)


@pytest.mark.parametrize(
    ("unit", "name"), [(" °C", "T_in_C"), ("C", "T_in_C"), (" W", "fan_W"), ("l/min", "q_L_per_min")]
)
def test_a_unit_in_the_cells_that_agrees_with_the_name_is_left_out(tmp_path: Path, unit: str, name: str) -> None:
    record = _read(tmp_path, f"time_s;{name}", [f"{k};{k + 20},25{unit}" for k in range(20)])
    assert record.columns[name].tolist() == [k + 20.25 for k in range(20)]
    assert any(said.startswith(f"{name}: the unit") for said in record.messages)


@pytest.mark.parametrize(
    ("name", "cells", "said"),
    [
        ("T_in_C", ["70.1 °F"] * 9, "is in degC by its name and in degF by its cells"),
        ("fan_W", ["1.1 kW"] * 9, "is in W by its name and in kW by its cells"),
        ("fan_W", [*["900 W"] * 8, "1.1 kW"], r"is in W \(line 2\) and in kW \(line 10\) by its cells"),
    ],
)
def test_a_unit_in_the_cells_that_contradicts_is_refused(
    tmp_path: Path, name: str, cells: list[str], said: str
) -> None:
    with pytest.raises(RecordError, match=said):
        _read(tmp_path, f"time_s,{name}", [f"{k},{cell}" for k, cell in enumerate(cells)])


def test_a_column_without_a_unit_in_its_name_is_reported_with_that_of_its_cells(tmp_path: Path) -> None:
    record = _read(tmp_path, "time_s,T_in_C,tank", [f"{k},20,{k + 30.5} °C" for k in range(9)])
    assert any("column 'tank' has the unit degC in its cells" in said for said in record.messages)


@pytest.mark.parametrize("heading", ["T_in_C_quality", "T_in_quality", "T_in_C_status", "Quality"])
@pytest.mark.parametrize(("good", "bad"), [("192", "24"), ("216", "0"), ("Good", "Bad"), ("0", "4")])
def test_values_of_bad_quality_are_missing(tmp_path: Path, heading: str, good: str, bad: str) -> None:
    rows = [f"{k},{20 + k},{bad if k in (3, 5) else '192' if k == 0 and good == '216' else good}" for k in range(20)]
    record = _read(tmp_path, f"time_s,T_in_C,{heading}", rows)
    assert np.flatnonzero(np.isnan(record.columns["T_in_C"])).tolist() == [3, 5]
    assert any(f"T_in_C: 2 values are bad by '{heading}'" in said for said in record.messages)


@pytest.mark.parametrize("codes", [("1", "0"), ("7", "90"), ("fine", "odd")])
def test_codes_of_no_known_kind_are_reported_and_not_used(tmp_path: Path, codes: tuple[str, str]) -> None:
    rows = [f"{k},{20 + k},{codes[k % 2]}" for k in range(20)]
    record = _read(tmp_path, "time_s,T_in_C,T_in_C_quality", rows)
    assert not np.isnan(record.columns["T_in_C"]).any()
    assert any("'T_in_C_quality'" in said and "not used" in said for said in record.messages)


@pytest.mark.parametrize(
    ("heading", "row"),
    [("time_s;T_in_C;fan_W", "{0}.250;20,5;9,5"), ("time_s;T_in_C;heat_kW", "{0};20,5;1.{0}50")],
)
def test_marks_that_only_other_columns_make_thousands_are_refused(tmp_path: Path, heading: str, row: str) -> None:
    with pytest.raises(RecordError, match=r"can be read in two ways.*by the decimal sign of the other columns"):
        _read(tmp_path, heading, [row.format(k) for k in range(1, 10)])


def test_thousands_that_go_on_from_hundreds_are_read_with_a_remark(tmp_path: Path) -> None:
    stamps = ["0", "500", "1.000", "1.500", "2.000"]
    record = _read(tmp_path, "time_s;T_in_C", [f"{stamp};20,5" for stamp in stamps])
    assert record.time_s.tolist() == [0.0, 500.0, 1000.0, 1500.0, 2000.0]
    assert any("time_s: 3 numbers with marks between thousands" in said for said in record.messages)
