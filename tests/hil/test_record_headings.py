"""Names and units of a record that contradict each other: a later heading, a line of units."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil.record.reader import Record, RecordError, read_record

TOP = "time_s,T_in_C,T_out_C,fan_W"


def _read(tmp_path: Path, lines: list[str]) -> Record:
    path = tmp_path / "joined.csv"
    path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
    return read_record(path)


def _joined(heading: str, row: str) -> list[str]:
    return [TOP, *(f"{k},20,30,400" for k in range(9)), heading, *(row.format(k) for k in range(9, 18))]


def test_rows_below_a_heading_in_another_order_are_read_by_name(tmp_path: Path) -> None:
    record = _read(tmp_path, _joined("fan_W,time_s,T_out_C,T_in_C", "400,{},30,20"))
    assert record.time_s.tolist() == list(range(18))
    assert set(record.columns["T_in_C"]) == {20.0} and set(record.columns["T_out_C"]) == {30.0}
    assert any("line 11 names the columns in another order" in said for said in record.messages)


def test_the_same_heading_again_changes_nothing(tmp_path: Path) -> None:
    record = _read(tmp_path, _joined(TOP, "{},20,30,400"))
    assert len(record.time_s) == 18 and not any("another order" in said for said in record.messages)


@pytest.mark.parametrize("heading", ["time_s,T_in_C,T_out_C,fan_kW", "time_min,T_in_C,T_out_C,fan_W", "t,T_in_C,x,y"])
def test_a_later_heading_with_other_names_is_refused(tmp_path: Path, heading: str) -> None:
    with pytest.raises(RecordError, match="line 11 is a heading with other columns than that at the top"):
        _read(tmp_path, _joined(heading, "{},20,30,0.4"))


@pytest.mark.parametrize(
    ("units", "said"),
    [
        ("s,degC,degC,kW", "'fan_W' is in W by its name and in kW"),
        ("s,°F,degC,W", "'T_in_C' is in degC by its name and in degF"),
        ("ms,degC,degC,W", "'time_s' is in s by its name and in ms"),
    ],
)
def test_a_line_of_units_that_contradicts_a_name_is_refused(tmp_path: Path, units: str, said: str) -> None:
    with pytest.raises(RecordError, match=said):
        _read(tmp_path, [TOP, units, *(f"{k},20,30,400" for k in range(9))])


def test_a_line_of_units_that_agrees_is_read(tmp_path: Path) -> None:
    record = _read(tmp_path, [TOP, "sec,°C,[degC],W", *(f"{k},20,30,400" for k in range(9))])
    assert record.time_s[-1] == 8 and list(record.columns) == ["T_in_C", "T_out_C", "fan_W"]
