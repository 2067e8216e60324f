"""Time stamps of CSV stores about changes of clock, in three zones: each sample is at its moment, however written."""

from __future__ import annotations

import datetime
import zoneinfo
from pathlib import Path

import numpy as np
import pytest

from hil.record import ReadingOptions, RecordError
from hil.tower.station import open_samples
from hil.tower.station.csv_store import CsvStore
from twin.historian.defects.clocks import Shift, corrected
from twin.historian.tags import Series, Tag

CHANGES = {
    "Europe/Madrid": ("2022-03-26", "2022-10-29"),
    "America/New_York": ("2022-03-12", "2022-11-05"),
    "Australia/Sydney": ("2022-10-01", "2022-04-02"),
}
LINES = {
    "Z": lambda local: local.astimezone(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
    "offset": lambda local: local.isoformat(),
    "name": lambda local: f"{local:%Y-%m-%d %H:%M:%S} {local.tzname()}",
    "none": lambda local: f"{local:%Y-%m-%d %H:%M:%S}",
    "none, day first": lambda local: f"{local:%d.%m.%Y %H:%M:%S}",
}


def _moments(day: str) -> np.ndarray:
    start = datetime.datetime.fromisoformat(day).replace(tzinfo=datetime.UTC).timestamp()
    return np.asarray(start + 300.0 * np.arange(2 * 288))


@pytest.mark.parametrize("how", LINES)
@pytest.mark.parametrize("zone", CHANGES)
@pytest.mark.parametrize("season", [0, 1])
@pytest.mark.parametrize("layout", ["a row a sample", "a column a tag"])
def test_samples_about_a_change_of_clock_keep_their_moment(
    how: str, zone: str, season: int, layout: str, tmp_path: Path
) -> None:
    time_s = _moments(CHANGES[zone][season])
    local = [datetime.datetime.fromtimestamp(t, zoneinfo.ZoneInfo(zone)) for t in time_s.tolist()]
    stamps = [LINES[how](one) for one in local]
    if layout == "a row a sample":
        lines = ["timestamp,tag,value,quality", *(f"{t},A,{k},192\n{t},B,1,192" for k, t in enumerate(stamps))]
    else:
        lines = ["timestamp,A,B", *(f"{t},{k},{k % 7}" for k, t in enumerate(stamps))]
    file = tmp_path / "export.csv"
    file.write_text("\n".join(lines) + "\n")
    with open_samples(str(file)) as store:
        samples, zoned = store.read(["A"])["A"], store.zoned
    assert zoned is not how.startswith("none")
    series = Series(Tag("A", "degC", "basin_temperature", 1), samples.time_s, samples.value, samples.quality)
    read = series if zoned else corrected(series, Shift(zone))
    order = np.argsort(read.value)
    assert np.array_equal(read.value[order], np.arange(len(time_s)))
    assert np.array_equal(read.time_s[order], time_s)


def test_the_order_of_day_and_month_can_be_given_for_a_store(tmp_path: Path) -> None:
    file = tmp_path / "export.csv"
    file.write_text("timestamp,A\n04/01/2022 11:00:00,1\n05/01/2022 11:00:00,2\n")
    with pytest.raises(RecordError, match="--dates mdy"):
        CsvStore([file])
    first = CsvStore([file], ReadingOptions(dates="mdy")).read(["A"])["A"].time_s[0]
    assert first == datetime.datetime(2022, 4, 1, 11, tzinfo=datetime.UTC).timestamp()


def test_a_text_that_many_rows_repeat_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from hil.record.values import numbers

    read: list[str] = []
    plain = numbers.readings
    monkeypatch.setattr(numbers, "readings", lambda cell: read.append(cell) or plain(cell))
    rows = [f"2022-05-01T00:{k // 40:02d}:00Z,TAG{k % 40},{k},192" for k in range(2000)]
    file = tmp_path / "export.csv"
    file.write_text("\n".join(["timestamp,tag,value,quality", *rows]) + "\n")
    assert len(CsvStore([file]).tags()) == 40
    assert len(read) < len(rows) / 2
