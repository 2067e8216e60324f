"""Exports of loggers, historians and databases: units in headings and cells, delimiters at line ends, quality codes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.record.reader import Record, RecordError, read_record

WARM = [f"{20 + k / 8:.4f}" for k in range(30)]


def _read(tmp_path: Path, lines: list[str], encoding: str = "utf-8") -> Record:
    path = tmp_path / "logger.csv"
    path.write_bytes("".join(f"{line}\n" for line in lines).encode(encoding))
    return read_record(path)


def _clock(k: int) -> str:
    return f"2025-07-19 08:{k // 2:02}:{30 * (k % 2):02}"


@pytest.mark.parametrize(
    ("heading", "column"),
    [
        ("Tank [°C]", "Tank_C"),
        ("101 (C)", "101_C"),
        ("101 <Tank> (DEG C)", "101 <Tank>_C"),
        ("Tank / °C", "Tank_C"),
        ("Tank, °C (serial 17, sensor 4)", "Tank_C"),
        ("CH1-1['C]", "CH1-1_C"),
        ("n pump [U/min]", "n pump_rpm"),
        ("flow {l/h}", "flow_L_per_h"),
        ("103 (VDC)", "103_V"),
        ("rF [%rF]", "rF_pct"),
        ("T_in_C (°C)", "T_in_C"),
        ("Temp, °C (LGR S/N: 17, SEN S/N: 17, LBL: Tank)", "Tank_C"),
    ],
)
def test_a_unit_in_a_heading_becomes_the_suffix(tmp_path: Path, heading: str, column: str) -> None:
    record = _read(tmp_path, [f"time_s;{heading}", *(f"{k};{cell}" for k, cell in enumerate(WARM))])
    assert record.columns[column][-1] == float(WARM[-1])


def test_impossible_numbers_of_a_unit_in_a_heading_are_missing(tmp_path: Path) -> None:
    record = _read(tmp_path, ["time_s;Tank (°C)", *(f"{k};{'-999' if k == 4 else 21}" for k in range(20))])
    assert np.flatnonzero(np.isnan(record.columns["Tank_C"])).tolist() == [4]


def test_letters_in_brackets_that_are_labels_are_no_units(tmp_path: Path) -> None:
    record = _read(tmp_path, ["time_s,zone (A),zone (B),zone (C)", *(f"{k},1,2,3" for k in range(5))])
    assert list(record.columns) == ["zone (A)", "zone (B)", "zone (C)"]


def test_a_heading_that_gives_two_units_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match=r"column 'fan_W \[kW\]' is in W and in kW by its name; correct it"):
        _read(tmp_path, ["time_s,fan_W [kW]", "0,1", "1,2"])


@pytest.mark.parametrize("lines", [["time,tank", "s,°F"], ["time,tank (°F)"], ["time,tank [F]"]])
def test_degrees_fahrenheit_are_reported_with_the_remedy(tmp_path: Path, lines: list[str]) -> None:
    record = _read(tmp_path, [*lines, *(f"{k},{70 + k}" for k in range(9))])
    said = "tank_F is in degrees Fahrenheit, and twins read degC: subtract 32 and divide by 1.8, and call it tank_C"
    assert said in record.messages and record.columns["tank_F"][0] == 70


def test_a_unit_in_the_cells_of_a_plain_name_becomes_the_suffix(tmp_path: Path) -> None:
    record = _read(tmp_path, ["Time,Tank", *(f"{_clock(k)},{cell} °C" for k, cell in enumerate(WARM))])
    assert record.columns["Tank_C"].tolist() == [float(cell) for cell in WARM]


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
def test_utf_16_text_is_read(tmp_path: Path, encoding: str) -> None:
    lines = ["time_s;T_in_C;µ", *(f"{k};{cell};1" for k, cell in enumerate(WARM))]
    assert _read(tmp_path, lines, encoding).columns["T_in_C"][-1] == float(WARM[-1])


@pytest.mark.parametrize(("head", "row"), [("", ";"), (";", ""), (";", ";")])
def test_a_delimiter_at_the_end_of_lines_is_no_column(tmp_path: Path, head: str, row: str) -> None:
    record = _read(tmp_path, [f"time_s;T_in_C{head}", *(f"{k};{cell}{row}" for k, cell in enumerate(WARM))])
    assert list(record.columns) == ["T_in_C"] and len(record.time_s) == 30


def test_a_column_for_comments_may_be_left_out_of_rows(tmp_path: Path) -> None:
    record = _read(tmp_path, ["X_Value\tT_in_C\tComment", *(f"{k}\t{cell}" for k, cell in enumerate(WARM))])
    assert record.time_s[-1] == 29 and list(record.columns) == ["T_in_C"]


def test_lines_of_channels_and_units_above_the_names_are_no_rows(tmp_path: Path) -> None:
    lines = ["Model,G1", "Ch,,0001,0002", "Unit,,C,L/min", "Date,Time,0001,0002"]
    record = _read(tmp_path, [*lines, *(f"2025/07/19,08:00:{k:02},{cell},8" for k, cell in enumerate(WARM))])
    assert list(record.columns) == ["0001_C", "0002_L_per_min"] and record.time_s[-1] == 29


def test_a_line_of_units_that_names_a_time_is_not_the_heading(tmp_path: Path) -> None:
    lines = ["Number,Date&Time,ms,CH1,CH2", "NO.,Time,ms,degC,degC"]
    record = _read(tmp_path, [*lines, *(f"{k},{_clock(k)},0,{cell},9" for k, cell in enumerate(WARM))])
    assert record.columns["CH1_C"][-1] == float(WARM[-1]) and set(record.columns["CH2_C"]) == {9.0}


@pytest.mark.parametrize(("first", "second", "at"), [(90, 4, 92), (20, 30, 22), (60, 60, 62)])
def test_a_later_heading_with_another_number_of_fields_is_refused(
    tmp_path: Path, first: int, second: int, at: int
) -> None:
    lines = ["time_s,T_in_C", *(f"{k},20" for k in range(first)), "time_s,T_in_C,fan_W"]
    with pytest.raises(RecordError, match=rf"line {at} is a heading of .*columns.*line 1\b.*split the file there"):
        _read(tmp_path, [*lines, *(f"{first + k},20,5" for k in range(second))])


@pytest.mark.parametrize(
    ("heading", "row", "remedy"),
    [
        ("time_s,T_in_C,fan_W", "{},20", "give every row all its fields"),
        ("time_s,T_in_C", "{},20,5", "write decimal points, or separate columns by semicolons"),
        ("time_s,T_in_C,note", "{},20.5,a, b", "quote texts that hold the delimiter ','"),
    ],
)
def test_the_remedy_for_rows_that_do_not_fit_is_that_of_their_cause(
    tmp_path: Path, heading: str, row: str, remedy: str
) -> None:
    full = [f"{k},20,5"[: 4 + 3 * heading.count(",") - 3] for k in range(3)]
    with pytest.raises(RecordError, match=remedy):
        _read(tmp_path, [heading, *full, *(row.format(k) for k in range(3, 40))])


@pytest.mark.parametrize(
    ("heading", "good", "bad"),
    [
        ("ItemID;Timestamp;Value;Quality", "Good, non-specific", "Bad, comm failure"),
        ("ItemID;Timestamp;Value;Quality", "192", "0"),
        ("NodeId;SourceTimestamp;Value;StatusCode", "0x00000000", "0x80000000"),
        ("VarName;TimeString;VarValue;Validity", "1", "0"),
        ("tag;time;value;status", "OK", "Bad"),
    ],
)
def test_a_reading_of_bad_quality_is_missing_by_every_kind_of_codes(
    tmp_path: Path, heading: str, good: str, bad: str
) -> None:
    rows = [f"T_in_C;{_clock(k)};{cell};{bad if k == 7 else good}" for k, cell in enumerate(WARM)]
    record = _read(tmp_path, [heading, *rows])
    assert np.flatnonzero(np.isnan(record.columns["T_in_C"])).tolist() == [7]


def test_quality_of_no_known_kind_is_reported(tmp_path: Path) -> None:
    rows = [f"T_in_C;{_clock(k)};{cell};{k % 3}" for k, cell in enumerate(WARM)]
    record = _read(tmp_path, ["tag;time;value;status", *rows])
    assert "column 'status' has codes of no known kind: not used" in record.messages


def test_payloads_of_topics_become_columns(tmp_path: Path) -> None:
    rows = [f"{name},{value},{1_752_912_000 + k}" for k in range(9) for name, value in (("T_in_C", 20), ("fan_W", 55))]
    record = _read(tmp_path, ["topic,payload,timestamp", *rows])
    assert set(record.columns["T_in_C"]) == {20.0} and set(record.columns["fan_W"]) == {55.0}


@pytest.mark.parametrize("pattern", ["{} days 00:00:30", "{}d 00:00:30.000", "{} day, 0:00:30"])
def test_days_before_a_time_since_the_beginning_are_added(tmp_path: Path, pattern: str) -> None:
    record = _read(tmp_path, ["elapsed;T_in_C", *(f"{pattern.format(k)};{cell}" for k, cell in enumerate(WARM))])
    assert np.diff(record.time_s).tolist() == [86400.0] * 29


@pytest.mark.parametrize(("name", "hour"), [("Date Time; GMT+02:00", 6), ("timestamp (UTC)", 8), ("Time", 8)])
def test_the_zone_in_a_heading_counts(tmp_path: Path, name: str, hour: int) -> None:
    record = _read(tmp_path, [f'"{name}",T_in_C', *(f"{_clock(k)},{cell}" for k, cell in enumerate(WARM))])
    assert record.start is not None and record.start.hour == hour


@pytest.mark.parametrize(("lowest", "asked"), [(293.0, True), (800.0, False), (180.0, False)])
def test_kelvin_is_asked_about_only_where_a_liquid_may_have_it(tmp_path: Path, lowest: float, asked: bool) -> None:
    record = _read(tmp_path, ["time_s,T_in_C", *(f"{k},{lowest + k}" for k in range(60))])
    assert any("is it in kelvin?" in said for said in record.messages) == asked


def test_parts_of_a_second_below_which_their_own_name_stands_belong_to_the_times(tmp_path: Path) -> None:
    rows = [f"{k + 1},{_clock(k)},{500 * (k % 2)},{cell}" for k, cell in enumerate(WARM)]
    record = _read(tmp_path, ["Number,Date&Time,ms,CH1", "NO.,Time,ms,degC", *rows])
    np.testing.assert_allclose(record.time_s[:3], [0.0, 30.5, 60.0])
    assert record.columns["CH1_C"][-1] == float(WARM[-1])


def test_channels_called_by_numbers_keep_the_units_below_them(tmp_path: Path) -> None:
    rows = [f"{-3e-3 + k * 1e-4:.6E},{cell},0.021" for k, cell in enumerate(WARM)]
    record = _read(tmp_path, ["x-axis,1,2", "second,Volt,Volt", *rows])
    assert len(record.time_s) == len(WARM) and list(record.columns) == ["1_V", "2_V"]


def test_a_heading_of_units_takes_its_names_from_the_line_above(tmp_path: Path) -> None:
    head = [" ,,System,System", "timezone: Europe/Berlin,,,", " ,,Tank temperature,AC power"]
    rows = [f"{1772600000000 + 10000 * k},{_clock(k)},{cell},700" for k, cell in enumerate(WARM)]
    record = _read(tmp_path, [*head, "ms since epoch,date,°C,W", *rows])
    assert record.columns["Tank temperature_C"][-1] == float(WARM[-1])
    assert record.columns["AC power_W"][0] == 700.0


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (
            ["(1772600000.5) can0 123#00A0", "(1772600000.6) can0 124#00A0"],
            "is a log of CAN frames; decode it by its DBC",
        ),
        (["date Wed Mar 4 10:00:00 2026", "base hex  timestamps absolute"], "is a log of CAN frames"),
        ([";$FILEVERSION=2.0", ";$COLUMNS=N,O,T,I,d,l,D"], "is a log of CAN frames"),
        (["Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2", "0,00000123,false,Rx,0,2,00,A0"], "is a log of CAN frames"),
        (
            ["timestamp,arbitration_id,extended,remote,error,dlc,data", "0.1,0x12,0,0,0,1,AA=="],
            "is a log of CAN frames",
        ),
        (["rig,host=a T_tank=20.5,P=700 1772600000000000000"], "is line protocol of InfluxDB; query the data as CSV"),
    ],
)
def test_logs_without_columns_of_signals_are_named(tmp_path: Path, lines: list[str], said: str) -> None:
    with pytest.raises(RecordError, match=said):
        _read(tmp_path, lines)
