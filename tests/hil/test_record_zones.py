"""Time zones in names and cells of times, parts of a second in a column of their own, and lines of tags."""

from __future__ import annotations

import datetime
from pathlib import Path

import numpy as np
import pytest

from hil.record.reader import Record, RecordError, read_record


def _read(tmp_path: Path, lines: list[str]) -> Record:
    path = tmp_path / "zones.csv"
    path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
    return read_record(path)


def _clock(k: int) -> str:
    return f"2025-02-19 12:{k:02}:00"


ZONES = [("CET", 11), ("MEZ", 11), ("CEST", 10), ("EST", 17), ("PDT", 19), ("JST", 3), ("UTC+2", 10), ("GMT-03:30", 15)]


@pytest.mark.parametrize(("zone", "hour"), [*ZONES, ("UTC", 12), ("Europe/Paris", 11), ("+0530", 6)])
@pytest.mark.parametrize("pattern", ["Time ({})", "Zeit [{}]"])
def test_a_zone_in_the_name_of_the_times_counts(tmp_path: Path, zone: str, hour: int, pattern: str) -> None:
    record = _read(tmp_path, [f'"{pattern.format(zone)}",T_in_C', *(f"{_clock(k)},{20 + k}" for k in range(20))])
    assert record.start is not None and record.start.hour == hour
    assert any(f"in {zone}:" in said for said in record.messages)


@pytest.mark.parametrize(("zone", "hour"), ZONES)
def test_a_zone_in_the_cells_counts(tmp_path: Path, zone: str, hour: int) -> None:
    record = _read(tmp_path, ["Time,T_in_C", *(f"{_clock(k)} {zone},{20 + k}" for k in range(20))])
    assert record.start is not None and record.start.hour == hour


def test_a_zone_in_the_line_of_units_counts(tmp_path: Path) -> None:
    record = _read(tmp_path, ["Time,tank", "CET,°C", *(f"{_clock(k)},{20 + k}" for k in range(20))])
    assert record.start == datetime.datetime(2025, 2, 19, 11, tzinfo=datetime.UTC)


def test_letters_of_no_known_zone_are_reported(tmp_path: Path) -> None:
    record = _read(tmp_path, ["Time (IST),T_in_C", *(f"{_clock(k)},{20 + k}" for k in range(20))])
    assert record.start is not None and record.start.hour == 12
    assert any("'IST' in its name is no zone of one meaning" in said for said in record.messages)


def test_a_local_time_of_a_region_is_continuous_over_a_change_of_clocks(tmp_path: Path) -> None:
    stamps = [f"2025-10-26 {hour:02}:{minute:02}" for hour in (1, 2, 2, 3) for minute in range(0, 60, 15)]
    record = _read(tmp_path, ["Time (Europe/Berlin),T_in_C", *(f"{s},{20 + k}" for k, s in enumerate(stamps))])
    assert np.diff(record.time_s).tolist() == [900.0] * 15
    assert record.start == datetime.datetime(2025, 10, 25, 23, tzinfo=datetime.UTC)


@pytest.mark.parametrize(
    ("name", "step"), [("ms", 250), ("Milliseconds", 125), ("µs", 250_000), ("Hundredths", 25), ("Millisekunde", 200)]
)
@pytest.mark.parametrize("heading", ["Date,Time,{},T_in_C", "{},Date,Time,T_in_C", "Date,{},Time,T_in_C"])
def test_parts_of_a_second_in_a_column_belong_to_the_times(tmp_path: Path, name: str, step: int, heading: str) -> None:
    second = {"µs": 1_000_000, "Hundredths": 100}.get(name, 1000)
    rows = []
    for k in range(40):
        fields = {"Date": "2025-02-19", "Time": f"12:00:{k * step // second:02}", name: f"{k * step % second:03}"}
        rows.append(",".join([*(fields[part] for part in heading.format(name).split(",")[:3]), str(20 + k)]))
    record = _read(tmp_path, [heading.format(name), *rows])
    assert record.time_s == pytest.approx([k * step / second for k in range(40)])
    assert list(record.columns) == ["T_in_C"]


def test_whole_seconds_with_milliseconds_of_zero_lose_only_the_column(tmp_path: Path) -> None:
    record = _read(tmp_path, ["time_s,ms,T_in_C", *(f"{k},0,{20 + k}" for k in range(20))])
    assert record.time_s.tolist() == list(range(20)) and list(record.columns) == ["T_in_C"]


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("ms", [700 + 50 * k for k in range(20)]),
        ("latency_ms", list(range(20))),
        ("ms", [0.5 + k for k in range(20)]),
    ],
)
def test_other_columns_of_milliseconds_are_not_added(tmp_path: Path, name: str, values: list[float]) -> None:
    record = _read(tmp_path, [f"Time,{name},T_in_C", *(f"{_clock(k)},{x},{20 + k}" for k, x in enumerate(values))])
    assert np.diff(record.time_s).tolist() == [60.0] * 19 and name in record.columns


def test_times_with_fractions_take_no_further_parts(tmp_path: Path) -> None:
    record = _read(tmp_path, ["time_s,ms,T_in_C", *(f"{k / 4},{250 * k % 1000},{20 + k}" for k in range(20))])
    assert record.time_s[-1] == 4.75 and "ms" in record.columns


def test_channels_of_one_name_are_called_after_the_line_of_their_tags(tmp_path: Path) -> None:
    lines = ["Unit 7,lab,,", "Tag,,inlet,outlet", "Unit,,degC,degC", "Date,Time,Value,Value"]
    record = _read(tmp_path, [*lines, *(f"2025-02-19,12:00:{k:02},{20 + k},{30 + k}" for k in range(20))])
    assert list(record.columns) == ["inlet_C", "outlet_C"]


def test_a_zone_beside_a_clock_that_goes_back_does_not_hide_it(tmp_path: Path) -> None:
    stamps = [_clock(k % 30) for k in range(60)]
    with pytest.raises(RecordError, match="line 32: the time goes back by"):
        _read(tmp_path, ["Time (CET),T_in_C", *(f"{s},{20 + k}" for k, s in enumerate(stamps))])


@pytest.mark.parametrize(
    ("name", "zone", "hour"),
    [("TZ", "CET", 11), ("Time zone", "UTC+2", 10), ("utc_offset", "-5", 17)],
)
def test_a_column_of_zones_belongs_to_the_times(tmp_path: Path, name: str, zone: str, hour: int) -> None:
    record = _read(tmp_path, [f"Time,{name},T_in_C", *(f"{_clock(k)},{zone},{20 + k}" for k in range(20))])
    assert record.start is not None and record.start.hour == hour and list(record.columns) == ["T_in_C"]


def test_zones_that_change_with_the_rows_give_continuous_times(tmp_path: Path) -> None:
    rows = [(f"2025-10-26 02:{minute:02}:00", zone) for zone in ("CEST", "CET") for minute in range(0, 60, 5)]
    record = _read(tmp_path, ["Time,TZ,T_in_C", *(f"{t},{zone},{20 + k}" for k, (t, zone) in enumerate(rows))])
    assert np.diff(record.time_s).tolist() == [300.0] * 23


def test_a_column_of_zones_that_are_not_known_is_named(tmp_path: Path) -> None:
    record = _read(tmp_path, ["Time,TZ,T_in_C", *(f"{_clock(k)},lab,{20 + k}" for k in range(20))])
    assert any("column 'TZ' has 'lab' (line 2), no known zone: not used" in said for said in record.messages)


def test_times_of_which_some_have_a_zone_are_refused_or_reported(tmp_path: Path) -> None:
    def lines(zone: str) -> list[str]:
        return ["Time,T_in_C", *(f"{_clock(k)}{zone if k < 9 else ''},{20 + k}" for k in range(20))]

    with pytest.raises(RecordError, match=r"12:00:00\+02:00' has a time zone and '.*12:09:00' has none; write"):
        _read(tmp_path, lines("+02:00"))
    assert any("11 times without a zone are taken as UTC" in said for said in _read(tmp_path, lines("Z")).messages)
