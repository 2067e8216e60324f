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


FLOWS = [f"{3 + k / 250 + (k * 7 % 5) / 300:.3f}" for k in range(60)]
RESTS = [f"{3 + k % 2 / 100:.2f}" for k in range(60)]
"""A quantity of two readings: no more than a switch has."""
EXTREMES = [
    *(
        "655.35",
        "65.535",
        "6553.5",
        "65535",
        "327.67",
        "-327.68",
        "3276.8",
        "32767",
        "-32768",
        "8388607",
        "214748.3647",
    ),
    *("214748.3647", "999.9", "9999", "-9999", "99999.9", "-9999.99", "7999", "-6999", "-999"),
]


@pytest.mark.parametrize("code", EXTREMES)
@pytest.mark.parametrize("name", ["flow_L_per_min", "x", "p_bar", "Q [l/min]"])
@pytest.mark.parametrize("at", [[30], [20, 21, 40], list(range(30, 60)), list(range(15, 60))])
def test_an_end_of_a_raw_range_far_from_all_others_is_missing(
    tmp_path: Path, code: str, name: str, at: list[int]
) -> None:
    if len(at) > 30 and code in ("7999", "-6999", "-999"):
        pytest.skip("a listed code that fills most of a column may be a level")
    record = _read(tmp_path, name, _with(code, FLOWS, at))
    (values,) = record.columns.values()
    assert np.flatnonzero(np.isnan(values)).tolist() == at
    many = "1 values are" if len(at) == 1 else f"{len(at)} values are"
    assert any(many in m and f"{float(code):g}" in m and f"line {at[0] + 2}" in m for m in record.messages)


@pytest.mark.parametrize(
    ("name", "code"), [("Q [0.1 l/min]", "65535"), ("T_in_K", "655.35"), ("heater_power_kW", "6553.5")]
)
def test_a_code_is_one_of_the_numbers_as_they_are_written(tmp_path: Path, name: str, code: str) -> None:
    cells = [f"{300 + float(cell):.2f}" for cell in FLOWS]
    (values,) = _read(tmp_path, name, _with(code, cells, AT[:3])).columns.values()
    assert np.flatnonzero(np.isnan(values)).tolist() == AT[:3]


@pytest.mark.parametrize(("cells", "code"), [(RESTS, "655.35"), (["21.5"] * 60, "327.67"), (["700"] * 60, "9999")])
def test_an_end_of_a_raw_range_is_missing_where_the_rest_rests(tmp_path: Path, cells: list[str], code: str) -> None:
    (values,) = _read(tmp_path, "flow_L_per_min", _with(code, cells, AT[:3])).columns.values()
    assert np.flatnonzero(np.isnan(values)).tolist() == AT[:3]


@pytest.mark.parametrize(
    ("name", "cells"),
    [
        ("flow_L_per_min", _with("655.34", FLOWS, [30])),  # no end of a range
        ("valve_pct", _with("99.9", FLOWS, [30])),  # a valve that opens
        ("x", _with("999", FLOWS, [30])),
        ("n_rpm", [f"{k * 9999 / 59:.1f}" for k in range(60)]),  # passes through it
        ("fan_speed_pct", ["0.99999", "0.0625"]),  # nines, and no full field of them
        ("x", [str((65000 + 9 * k) % 65536) for k in range(120)] + ["65535"]),  # a counter that wraps
        ("heater_power_W", ["0", "9999"] * 30),  # a switch
        ("heater_power_W", [*["0", "500", "9999"] * 20]),
        ("x", ["0", "1", "65535"] * 20),  # bits
        ("P_W", [f"{3000 + 30 * (k % 9)}" for k in range(30)] + ["3276.7"] * 3),  # among the readings
        ("level_mV", [f"{x:.4f}" for x in np.linspace(-4, 4, 100)] + ["3.2767"]),
    ],
)
def test_readings_that_resemble_an_end_of_a_raw_range_stay(tmp_path: Path, name: str, cells: list[str]) -> None:
    (values,) = _read(tmp_path, name, cells).columns.values()
    assert not np.isnan(values).any()


STEADY = [f"{6.2 + 0.3 * np.sin(k / 9):.2f}" for k in range(100)]


@pytest.mark.parametrize("code", ["2048", "150.0", "-1"])
@pytest.mark.parametrize("name", ["flow_L_per_min", "p_bar"])
def test_isolated_rows_of_one_value_far_from_a_measured_quantity_are_missing(
    tmp_path: Path, name: str, code: str
) -> None:
    record = _read(tmp_path, name, _with(code, STEADY, AT))
    assert np.flatnonzero(np.isnan(record.columns[name])).tolist() == AT


STEPPED = [f"{level + 0.05 * np.sin(k / 3):.3f}" for k, level in enumerate([6.0] * 40 + [20.0] * 20 + [6.0] * 40)]


@pytest.mark.parametrize(
    ("name", "cells"),
    [
        ("flow_L_per_min", _with("0", STEADY, AT)),  # a pump that stops
        ("flow_L_per_min", _with("8.5", STEADY, AT)),  # within reach
        ("flow_L_per_min", _with("150.0", STEADY, [30, 31])),  # a value seen twice
        ("flow_L_per_min", _with("150.0", STEADY, list(range(30, 60)))),  # one event
        ("flow_L_per_min", STEPPED),  # a valve
        ("fan_pct", _with("100.0", STEADY, AT)),  # a drive at its limit for single rows
        ("flow_set_L_per_min", _with("150.0", STEADY, AT)),  # levels of a set-point
    ],
)
def test_events_of_a_measured_quantity_stay(tmp_path: Path, name: str, cells: list[str]) -> None:
    record = _read(tmp_path, name, cells)
    assert np.isfinite(record.columns[name]).all()


@pytest.mark.parametrize(
    ("name", "zero", "above"),
    [
        ("T_in_C", "-273.15", 0.0),
        ("T_in_C", "-273", 0.0),
        ("boiler [°C]", "-273.2", 0.0),
        ("T_in_K", "0", 273.15),
        ("T_in_K", "0.000", 273.15),
        ("boiler_K", "0", 273.15),
        ("T_in_F", "-459.67", 60.0),
    ],
)
@pytest.mark.parametrize("at", [[30], [30, 31, 32], [0, 1, 99], list(range(40, 100))])
def test_absolute_zero_is_never_a_reading(tmp_path: Path, name: str, zero: str, above: float, at: list[int]) -> None:
    record = _read(tmp_path, name, _with(zero, [f"{float(cell) + above:.2f}" for cell in LOOP], at))
    (values,) = record.columns.values()
    assert np.flatnonzero(np.isnan(values)).tolist() == at


@pytest.mark.parametrize("name", ["dT_K", "superheat_K", "T_difference_K", "flow_L_per_min", "fan_W"])
def test_zero_is_a_reading_of_a_difference(tmp_path: Path, name: str) -> None:
    record = _read(tmp_path, name, _with("0", LOOP, AT))
    assert np.isfinite(record.columns[name]).all()


def test_a_control_error_in_kelvin_keeps_its_zeros(tmp_path: Path) -> None:
    record = _read(tmp_path, "T_error_K", [f"{0.1 * (k % 30):.2f}" for k in range(100)])
    assert np.isfinite(record.columns["T_error_C"]).all()
