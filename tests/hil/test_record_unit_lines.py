"""Units of a record with a factor, in headings, in lines of units and in columns of units row by row."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.record.reader import Record, RecordError, read_record

COUNTS = [205 + k for k in range(20)]


def _read(tmp_path: Path, lines: list[str]) -> Record:
    path = tmp_path / "units.csv"
    path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
    return read_record(path)


def _two(first: str, second: str, numbers: list[int] = COUNTS) -> list[str]:
    return [first, second, *(f"{10 * k};{number}" for k, number in enumerate(numbers))]


@pytest.mark.parametrize(
    ("unit", "column", "factor"),
    [
        ("0.1 °C", "tank_C", 0.1),
        ("0,01°C", "tank_C", 0.01),
        ("[1/10 K]", "tank_K", 0.1),
        ("10^-2 bar", "tank_bar", 0.01),
        ("1e-3 kW", "tank_kW", 0.001),
        ("mK", "tank_K", 0.001),
        ("hPa", "tank_Pa", 100.0),
        ("kΩ", "tank_ohm", 1000.0),
        ("x0.1 °C", "tank_C", 0.1),
    ],
)
@pytest.mark.parametrize("where", ["line", "heading"])
def test_a_multiple_of_a_unit_is_taken_with_its_factor(
    tmp_path: Path, unit: str, column: str, factor: float, where: str
) -> None:
    lines = _two("time;tank", f"s;{unit}") if where == "line" else _two(f"time_s;tank ({unit.strip('[]')})", "0;204")
    record = _read(tmp_path, lines)
    assert record.columns[column][-1] == pytest.approx(COUNTS[-1] * factor)
    assert any(f"its numbers times {factor:g}" in said for said in record.messages)


@pytest.mark.parametrize("unit", ["x10 W", "10 W", "W*10", "W/10", "W (x 0,1)"])
@pytest.mark.parametrize("where", ["line", "heading"])
def test_a_factor_that_may_be_applied_already_gives_no_unit(tmp_path: Path, unit: str, where: str) -> None:
    lines = _two("time;fan", f"s;{unit}") if where == "line" else _two(f"time_s;fan [{unit}]", "0;204")
    record = _read(tmp_path, lines)
    assert "fan_W" not in record.columns and record.columns[f"fan [{unit}]"][-1] == COUNTS[-1]
    assert any("has a factor that may be applied already or not" in said for said in record.messages)


@pytest.mark.parametrize(
    ("unit", "said"),
    [
        ("0.1 °C", r"'T_in_C' is in degC by its name and in 0.1 degC by line 2; write degC there"),
        ("mK", r"'T_in_C' is in degC by its name and in 0.001 K by line 2"),
        ("°C x10", r"'T_in_C' is in degC by its name, and line 2 gives '°C x10' for it"),
        ("furlong", r"'T_in_C' is in degC by its name, and line 2 gives 'furlong' for it"),
    ],
)
def test_a_line_of_units_that_changes_the_unit_of_a_name_is_refused(tmp_path: Path, unit: str, said: str) -> None:
    with pytest.raises(RecordError, match=said):
        _read(tmp_path, _two("time_s;T_in_C", f"s;{unit}"))


@pytest.mark.parametrize(
    "lines",
    [
        ("time_s,heater_W,share_pct,T_in_C", "s,BTU/h,ratio,Rankine"),
        ("Timestamp,T_in_C,flow_L_per_min", ",°Ré,gpm"),
        ("time_s,T_in_C,p_bar,quux", "sec,°C,wobble,frob"),
        ("time_s,p_bar,level,x", "s,psi,furlong,smoot"),
    ],
)
def test_unknown_units_that_contradict_the_names_are_refused_however_many(
    tmp_path: Path, lines: tuple[str, str]
) -> None:
    columns = lines[0].count(",")
    stamps = [f"2026-03-04 10:00:{k:02d}" if "Timestamp" in lines[0] else str(k) for k in range(9)]
    with pytest.raises(RecordError, match=r"by its name, and line 2 gives '.*' for it, which is another unit"):
        _read(tmp_path, [*lines, *(f"{stamp}{',20' * columns}" for stamp in stamps)])


def test_unknown_units_stay_with_their_columns_where_most_are_unknown(tmp_path: Path) -> None:
    rows = [f"{k},20,3,4,5" for k in range(9)]
    record = _read(tmp_path, ["time_s,T_in,flow,p,cond", "s,°C,gpm,psi,µS/cm", *rows])
    assert list(record.columns) == ["T_in_C", "flow [gpm]", "p [psi]", "cond [µS/cm]"]
    assert "line 1 is taken for the heading, and line 2 gives units" in record.messages


@pytest.mark.parametrize("line", ["s,Avg,Smp", ",TT 101,FT 102", ",Avg,Max", ",tank top,HP side"])
def test_a_line_of_processing_or_tags_is_no_line_of_units(tmp_path: Path, line: str) -> None:
    record = _read(tmp_path, ["time_s,T_in_C,fan_W", line, *(f"{k},20,3" for k in range(9))])
    assert list(record.columns) == ["T_in_C", "fan_W"]


def test_a_unit_that_is_not_known_stays_in_the_name(tmp_path: Path) -> None:
    record = _read(tmp_path, ["time;tank;level", "s;°C;furlong", *(f"{k};20;3" for k in range(9))])
    assert list(record.columns) == ["tank_C", "level [furlong]"]
    assert any("line 2 gives 'furlong' for column 'level', no known unit" in said for said in record.messages)


@pytest.mark.parametrize("line", ["s;-;W", ";;", "s;1;W"])
def test_a_line_that_gives_a_column_no_unit_leaves_its_name(tmp_path: Path, line: str) -> None:
    record = _read(tmp_path, ["time_s;share;fan_W", line, *(f"{k};0.5;3" for k in range(9))])
    assert list(record.columns) == ["share", "fan_W"]


def test_a_multiple_of_seconds_for_the_times_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="line 2 gives the unit '10 ms' for the times 'time'; write seconds"):
        _read(tmp_path, _two("time;T_in_C", "10 ms;°C"))


def _beside(units: list[str], heading: str = "time_s,CH1,UNIT", values: list[str] | None = None) -> list[str]:
    return [heading, *(f"{k},{(values or ['21.5'] * len(units))[k]},{unit}" for k, unit in enumerate(units))]


@pytest.mark.parametrize(
    ("unit", "column"), [("C", "CH1_C"), ("°F", "CH1_F"), ("l/min", "CH1_L_per_min"), ("furlong", "CH1 [furlong]")]
)
@pytest.mark.parametrize("name", ["UNIT", "Einheit", "CH1 unit", "unit_CH1", "Unité"])
def test_a_column_of_units_names_the_unit_of_its_values(tmp_path: Path, unit: str, column: str, name: str) -> None:
    record = _read(tmp_path, _beside([unit] * 9, f"time_s,CH1,{name}"))
    assert list(record.columns) == [column]


@pytest.mark.parametrize(
    ("first", "then", "values", "column", "expected"),
    [
        ("C", "F", ["20", "68"], "CH1_C", 20.0),
        ("°F", "°C", ["68", "20"], "CH1_C", 20.0),
        ("kW", "W", ["1.5", "1500"], "CH1_kW", 1.5),
        ("bar", "mbar", ["2", "2000"], "CH1_bar", 2.0),
        ("K", "mK", ["5", "5000"], "CH1_K", 5.0),
    ],
)
def test_a_unit_that_changes_is_converted_row_by_row(
    tmp_path: Path, first: str, then: str, values: list[str], column: str, expected: float
) -> None:
    lines = _beside([first] * 9 + [then] * 9, values=[values[0]] * 9 + [values[1]] * 9)
    record = _read(tmp_path, lines)
    assert record.columns[column] == pytest.approx([expected] * 18)
    assert any(f"changes from {first} to {then} at line 11: 9 values" in said for said in record.messages)


@pytest.mark.parametrize(
    ("units", "said"),
    [
        (["C"] * 5 + ["bar"] * 5, r"changes from C \(line 2\) to bar \(line 7\), which is another quantity; split the"),
        (["C"] * 5 + ["furlong"] * 5, r"'furlong' is no known unit \(line 7\)"),
        (["C"] * 5 + [""] * 5, r"a value has no unit \(line 7\)"),
    ],
)
def test_a_unit_that_changes_to_another_quantity_is_refused(tmp_path: Path, units: list[str], said: str) -> None:
    with pytest.raises(RecordError, match=said):
        _read(tmp_path, _beside(units))


def test_a_column_of_units_that_contradicts_the_name_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match=r"gives F \(line 2\), and the name of that column gives degC; correct one"):
        _read(tmp_path, _beside(["F"] * 9, "time_s,T_in_C,UNIT"))


def test_a_unit_beside_a_missing_value_does_not_count(tmp_path: Path) -> None:
    record = _read(tmp_path, _beside(["C"] * 5 + [""] * 2, values=["20"] * 5 + [""] * 2))
    assert np.isnan(record.columns["CH1_C"]).tolist() == [False] * 5 + [True] * 2


def test_one_column_of_units_after_several_columns_is_not_guessed(tmp_path: Path) -> None:
    rows = [f"{k},20.5,30.5,C" for k in range(9)]
    record = _read(tmp_path, ["time_s,in,out,unit", *rows])
    assert "in" in record.columns and "out" in record.columns
    assert any("column 'unit' may give the unit of 'in' or 'out': not used" in said for said in record.messages)
    with pytest.raises(RecordError, match="unit in column 'unit' changes from C to F at line 11"):
        _read(tmp_path, ["time_s,in,out,unit", *rows, *(f"{k},68.5,86.5,F" for k in range(9, 18))])


def test_a_series_whose_unit_changes_is_one_column(tmp_path: Path) -> None:
    rows = [f"{k},tank,{20 if k < 9 else 68},{'°C' if k < 9 else '°F'}" for k in range(18)]
    record = _read(tmp_path, ["time,sensor,value,unit", *rows])
    assert list(record.columns) == ["tank_C"] and record.columns["tank_C"] == pytest.approx([20.0] * 18)


@pytest.mark.parametrize("name", ["T_diff_K", "T_spread_K", "T_supply_minus_return_K", "dT_tank_K", "T_delta_K"])
def test_a_temperature_difference_in_kelvin_stays(tmp_path: Path, name: str) -> None:
    record = _read(tmp_path, [f"time_s,{name}", *(f"{k},{5 + k / 8}" for k in range(9))])
    assert record.columns[name][0] == 5.0 and record.messages == ()


@pytest.mark.parametrize("name", ["T_drum_K", "T_diffuser_K"])
def test_another_temperature_in_kelvin_is_converted(tmp_path: Path, name: str) -> None:
    record = _read(tmp_path, [f"time_s,{name}", *(f"{k},{300 + k / 8}" for k in range(9))])
    assert record.columns[name.replace("_K", "_C")][0] == pytest.approx(26.85)


@pytest.mark.parametrize("below", ["x1;x0.1", "Scale;0.1", "Faktor;0,1", "Factor:;10", "*1;*10"])
def test_a_line_of_factors_is_refused(tmp_path: Path, below: str) -> None:
    with pytest.raises(RecordError, match=r"line 2 gives factors of the columns .* multiply the numbers"):
        _read(tmp_path, _two("time_s;T_in_C", below))


@pytest.mark.parametrize("below", ["Smp;Avg", "logger;tank", ";"])
def test_another_line_below_the_names_is_left_out(tmp_path: Path, below: str) -> None:
    record = _read(tmp_path, _two("time_s;T_in_C", below, COUNTS[:5]))
    assert record.columns["T_in_C"].tolist() == [205.0, 206.0, 207.0, 208.0, 209.0]


def test_a_temperature_called_t_has_the_unit_of_its_line(tmp_path: Path) -> None:
    record = _read(tmp_path, ["time;T;P", "s;0.1 °C;kW", *(f"{k};{200 + k};0.7" for k in range(9))])
    assert record.columns["T_C"][0] == pytest.approx(20.0) and list(record.columns) == ["T_C", "P_kW"]


def test_a_factor_in_a_name_is_reported(tmp_path: Path) -> None:
    record = _read(tmp_path, ["time_s;p_x10_bar", *(f"{k};{200 + k}" for k in range(9))])
    assert "column 'p_x10_bar' has a factor in its name: its numbers are kept as they are" in record.messages
