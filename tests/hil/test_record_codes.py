"""Codes that devices write instead of a temperature, inside the range of their sensor, and values that are none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.record.reader import Record, read_record

AT = [30, 31, 32, 55, 70]


def _read(tmp_path: Path, name: str, cells: list[str]) -> Record:
    path = tmp_path / "codes.csv"
    path.write_text(f"time_s,{name}\n" + "".join(f"{k},{cell}\n" for k, cell in enumerate(cells)), encoding="utf-8")
    return read_record(path)


def _with(code: str, cells: list[str], at: list[int]) -> list[str]:
    return [code if k in at else cell for k, cell in enumerate(cells)]


LOOP = [f"{30 + 8 * np.sin(k / 9):.2f}" for k in range(100)]
FURNACE = [f"{20 + 9 * k}" for k in range(100)]


@pytest.mark.parametrize("code", ["1370", "-242.02", "-99.99", "2048.0", "150.00", "-40"])
@pytest.mark.parametrize("name", ["T_in_C", "T_in [°C]", "boiler_C"])
def test_a_value_repeated_exactly_far_from_all_others_is_missing(tmp_path: Path, code: str, name: str) -> None:
    record = _read(tmp_path, name, _with(code, LOOP, AT))
    (values,) = record.columns.values()
    assert np.flatnonzero(np.isnan(values)).tolist() == AT
    assert any(f"5 values are {float(code):g}, a code for no measurement" in said for said in record.messages)


@pytest.mark.parametrize("code", ["1370", "1600.5"])
def test_a_code_within_a_wide_span_is_missing_where_no_step_else_is_as_large(tmp_path: Path, code: str) -> None:
    record = _read(tmp_path, "T_furnace_C", _with(code, FURNACE, AT))
    assert np.flatnonzero(np.isnan(record.columns["T_furnace_C"])).tolist() == AT


def test_two_codes_of_a_column_are_missing(tmp_path: Path) -> None:
    record = _read(tmp_path, "T_in_C", _with("1370", _with("-242.02", LOOP, [5, 6, 7]), AT))
    assert np.flatnonzero(np.isnan(record.columns["T_in_C"])).tolist() == [5, 6, 7, *AT]


@pytest.mark.parametrize(
    ("name", "cells"),
    [
        ("T_set_C", _with("120", LOOP, AT)),  # levels of a set-point
        ("T_in_C", _with("0.00", LOOP, AT)),  # zero may be a temperature that is held
        ("T_in_C", _with("45.5", LOOP, AT)),  # within reach in a step
        ("T_in_C", ["120.0"] * 9 + LOOP),  # a record that begins hot
        ("T_in_C", _with("150", LOOP, [30, 31])),  # a value seen twice
        ("fan_W", _with("1500", LOOP, AT)),  # a power that is switched
        ("T_in_C", ["20", "90"] * 40),  # two levels
    ],
)
def test_other_values_far_from_all_others_stay(tmp_path: Path, name: str, cells: list[str]) -> None:
    record = _read(tmp_path, name, cells)
    assert not np.isnan(record.columns[name]).any()
