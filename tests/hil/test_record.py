"""Records: everything that real ones suffer from, round trips, and equality with the journal."""

from __future__ import annotations

import datetime
import json
import os
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.signals.points import Quality, Signal
from hil.journal.writer import Header, JournalWriter
from hil.record import plausibility as record_plausible
from hil.record.reader import SENTINELS, Record, RecordError, export_record, read_record, write_record

CODES = (*record_plausible.CODES, *record_plausible.TEMPERATURE_CODES)
DATA = Path(os.environ.get("HIL_DATA", Path(__file__).parents[2].parent / "shared" / "data"))
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"no records at {DATA}; set HIL_DATA to have them read")


def _csv(tmp_path: Path, text: str | bytes, name: str = "record.csv") -> Path:
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def _parquet(tmp_path: Path, **columns: Any) -> Path:
    path = tmp_path / "record.parquet"
    pq.write_table(pa.table(columns), path)
    return path


def _rows(*times: float) -> str:
    return "time_s,T_tank_C\n" + "".join(f"{t:g},{20 + i / 10:g}\n" for i, t in enumerate(times))


def test_a_clean_record_has_no_messages(tmp_path: Path) -> None:
    record = read_record(_csv(tmp_path, _rows(0, 1, 2, 3)))
    assert record.messages == ()
    assert record.time_s.tolist() == [0, 1, 2, 3]
    assert record.columns["T_tank_C"].tolist() == [20, 20.1, 20.2, 20.3]
    assert record.period_s == 1
    assert len(record.sha256) == 64


@pytest.mark.parametrize(
    ("name", "content", "problem", "remedy"),
    [
        ("r.csv", b"", "is empty", "at least one row"),
        ("r.csv", b"# nothing\n\n", "holds nothing but comments", "give a record"),
        ("r.csv", b"time_s,T_tank_C\n", "holds no samples, only a header", "at least one row"),
        ("r.csv", b"time_s,T_tank_C", "holds no samples, only a header", "at least one row"),
        ("r.csv", b'time_s,"T_tank_C\n0,1\n', "line 1 is no header", "name the columns"),
        ("r.csv", b"time_s,T_tank_C\n?,1\n", "no readable time in column 'time_s'", "write seconds"),
        ("r.csv", b"T_tank_C,T_heater_C\n1,2\n", "line 1 has no column time_s (it has T_tank_C", "name the column"),
        ("r.csv", b"# rig\nT_tank_C,T_heater_C\n1,2\n", "line 2 has no column time_s", "name the column"),
        ("r.csv", b"0,20\n1,21\n2,22\n", "line 1 holds numbers where column names", "add a header line"),
        ("r.csv", b"time_s\n0\n1\n", "no column of numbers besides time_s", "signals"),
        ("r.csv", b"time_s,note\n0,a\n1,b\n", "no column of numbers besides time_s", "signals"),
        ("r.csv", b"time_s,T_tank_C\nnoon,20\n1pm,21\n", "no readable time", "ISO 8601"),
        ("r.csv", b"time_s,T_tank_C\n0,20,5\n1,20,6\n2,20,7\n", "line 2 does not have the 2 fields", "semicolons"),
        ("r.csv", b"\0\1\2\3" * 9, "neither Parquet nor text", "export the record"),
        ("r.csv", b"\xff\xfe" + b"\x00\xd8" * 9, "begins as UTF-16 text and is damaged", "UTF-8"),
        ("r.parquet", b"time_s,T_tank_C\n0,20\n", "is not a Parquet file", ".csv"),
        ("r.parquet", b"PAR1" + b"\0" * 50, "is cut off", "copy it again"),
        ("r.parquet", b"PAR1" + b"\1" * 50 + b"PAR1", "is a damaged Parquet file", "copy it again"),
        ("r.xlsx", b"PK\x03\x04rest", "a zip file or a spreadsheet", "save the sheet as CSV"),
        ("r.sqlite", b"SQLite format 3\0", "is a journal", "hil export"),
        ("r.csv.gz", b"\x1f\x8b\x08", "gzip", "unpack it first"),
    ],
)
def test_what_is_no_record_is_refused_in_one_sentence(
    tmp_path: Path, name: str, content: bytes, problem: str, remedy: str
) -> None:
    path = _csv(tmp_path, content, name)
    with pytest.raises(RecordError) as caught:
        read_record(path)
    sentence = str(caught.value)
    assert sentence.startswith(str(path))
    assert problem in sentence
    assert remedy in sentence
    assert "\n" not in sentence


def test_a_missing_file_and_a_truncated_copy_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match=r"none\.csv cannot be read \(No such file or directory\); give the path"):
        read_record(tmp_path / "none.csv")
    path = _parquet(tmp_path, time_s=[0.0, 1.0], T_tank_C=[20.0, 21.0])
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(RecordError, match="is cut off"):
        read_record(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (_rows(*range(20), *range(360, 380), *range(387, 400)), "2 gaps longer than 5 s, the longest 341 s at 19 s"),
        (_rows(*range(11400), *range(11740, 11800)), "1 gap longer than 5 s, the longest 341 s at 3 h 10 min"),
        (_rows(0, 1, 2, 2, 3), "1 repeated time stamps: the last value of each column is kept"),
        (_rows(0, 1, 3, 2, 4), "time goes back once, by up to 1 s (first at line 5): rows sorted"),
        (_rows(*range(200), *range(9)), "if these are two records in one file, split it"),
        (_rows(0, 1, 2.5, 3, 4.7, 5, 6.4), "sampling is irregular: steps of 0.35 to 1.65 s, typically 1.2 s"),
        ("time_s,T_tank_C\n0,20\n,21\nnan,22\n3,23\n", "2 rows have no readable time (the first is line 3): dropped"),
        ("time_s,T_tank_C\n0,20\n1,\n2,NaN\n3,23\n", "T_tank_C: 2 of 4 values missing, the longest stretch 2 samples"),
        ("time_s,T_tank_C\n0,20\n1,ERR\n2,20\n3,23\n", "1 cell is no number (the first, line 3, is 'ERR'): missing"),
        ("time_s,T_tank_C\n0,20\n1,inf\n2,20\n3,23\n", "T_tank_C: 1 values are infinite: missing"),
        ("time_s,T_tank_C\n0,20\n1,-9999\n2,20\n3,23\n", "1 values are -9999, a mark for no measurement: missing"),
        ("time_s,T_tank_C,note\n0,20,a\n1,21,b\n", "column 'note' holds text: dropped"),
        ("time_s,T_tank_C,T_tank_C\n0,20,1\n1,21,2\n", "column 'T_tank_C' stands twice"),
        ("time_s,T_tank_C,x\n0,20,1\n1,21,2\n", "no unit suffix: x (kept as they are)"),
        ("time_s,heater_power_kW\n0,0.6\n1,0.7\n", "heater_power_kW is in kW: converted to heater_power_W"),
        ("time_s,T_tank_K\n0,300\n1,301\n", "T_tank_K is in K: converted to T_tank_C"),
        ("time_s,T_tank_C\n0,300\n1,301\n", "T_tank_C has a median of 300.5: is it in kelvin?"),
        ("time_s,T_room_C\n0,78\n1,79\n", "T_room_C has a median of 78.5: is it in degrees Fahrenheit?"),
        ("time_s;T_ambient_C\n0;50\n1;51\n", "T_ambient_C has a median of 50.5: is it in degrees Fahrenheit?"),
        ("time_s\tT_room_K\n0\t300\n1\t301\n", "T_room_K is in K: converted to T_room_C"),
        ("time_s,fan_speed_pct\n0,0.6\n1,0.7\n", "fan_speed_pct is 0.6 to 0.7: is it a fraction of 1?"),
        ("time_s,fan_speed_rpm\n0,600\n1,700\n", "fan_speed_rpm is in rpm where a record has fan_speed_pct"),
        ("time_s,T_tank_degC\n0,20\n1,21\n", "column 'T_tank_degC' is read as T_tank_C"),
        ("time_s,m_flow_kg_s\n0,1\n1,1\n", "m_flow_kg_s: its unit would be told from the name m_flow_kg_per_s"),
        ("Time,T_tank_C\n0,20\n1,21\n", "column 'Time' is taken for time_s, in seconds"),
        ("time_min,T_tank_C\n0,20\n1,21\n", "column 'time_min' is taken for time_s, in minutes"),
        ("time_s,T_tank_C,T_heater_C\n0,20,1\n1,21,1\n2,2", "1 line has not the 3 fields of the header (the last one"),
        ("time_s;T_tank_C\n0;20,5\n1;21,5\n", "T_tank_C: 2 decimal commas read as points"),
        ("time_s,T_tank_C\n" + "".join(f"{i},0.0\n" for i in range(200)), "T_tank_C is 0 throughout: is the channel"),
        (
            "time_s,T_ambient_C\n" + "".join(f"{i},21\n" for i in range(200)),
            "T_ambient_C is constant at 21 degC: assumed, or is the channel dead?",
        ),
        ("time_s,T_tank_C,T_heater_C\n0,20,\n1,21,\n", "T_heater_C: no value at all"),
    ],
)
def test_what_a_record_suffers_from_is_said(tmp_path: Path, text: str, message: str) -> None:
    record = read_record(_csv(tmp_path, text))
    assert any(message in said for said in record.messages), record.messages
    assert (np.diff(record.time_s) > 0).all()
    assert all(values.shape == record.time_s.shape for values in record.columns.values())
    assert all(values.dtype == np.float64 for values in record.columns.values())
    assert not any(np.isinf(values).any() for values in record.columns.values())


def test_rows_are_sorted_and_repeats_keep_the_last_known_value(tmp_path: Path) -> None:
    text = "time_s,a_W,b_W\n2,30,\n0,10,1\n1,20,2\n1,21,\n2,,3\n"
    record = read_record(_csv(tmp_path, text))
    assert record.time_s.tolist() == [0, 1, 2]
    assert record.columns["a_W"].tolist() == [10, 21, 30]
    assert record.columns["b_W"].tolist() == [1, 2, 3]


def test_a_line_is_named_rightly_below_dropped_and_blank_lines(tmp_path: Path) -> None:
    text = "# c\ntime_s,T_tank_C\n0,20\n\n1,2,3\n2,21\n3,bad\n4,22\n5,22\n"
    record = read_record(_csv(tmp_path, text))
    assert record.time_s.tolist() == [0, 2, 3, 4, 5]
    assert any("the first, line 7, is 'bad'" in said for said in record.messages), record.messages
    assert any("the first is line 5" in said for said in record.messages), record.messages


def test_converted_values_are_right(tmp_path: Path) -> None:
    record = read_record(_csv(tmp_path, "time_s,heater_power_kW,T_tank_K\n0,0.6,300\n1,0.7,301\n"))
    assert record.columns["heater_power_W"] == pytest.approx([600, 700])
    assert record.columns["T_tank_C"] == pytest.approx([26.85, 27.85])


@pytest.mark.parametrize(
    ("stamps", "how"),
    [
        (["2026-11-02T10:00:00Z", "2026-11-02T10:00:01.5Z", "2026-11-02T10:00:03Z"], "ISO 8601"),
        (["2026-11-02 10:00:00", "2026-11-02 10:00:01.5", "2026-11-02 10:00:03"], "ISO 8601 without a time zone"),
        (["2026-11-02T11:00:00+01:00", "2026-11-02T11:00:01.5+01:00", "2026-11-02T11:00:03+01:00"], "ISO 8601"),
        (["2.11.2026 10:00", "02.11.2026 10:00:01.5", "2.11.2026  10:00:03"], "day.month.year without a time zone"),
        (["02.11.2026 11:00:00+01:00", "02.11.2026 11:00:01.5+01:00", "02.11.2026 11:00:03+01:00"], "day.month.year:"),
        (["1793613600", "1793613601.5", "1793613603"], "seconds since 1970"),
        (["1793613600000", "1793613601500", "1793613603000"], "milliseconds since 1970"),
        (["1793613600000000000", "1793613601500000000", "1793613603000000000"], "nanoseconds since 1970"),
    ],
)
def test_absolute_times_are_shifted_to_zero(tmp_path: Path, stamps: list[str], how: str) -> None:
    record = read_record(_csv(tmp_path, "time_s,T_tank_C\n" + "".join(f"{stamp},20\n" for stamp in stamps)))
    assert record.time_s == pytest.approx([0, 1.5, 3], abs=1e-6)
    assert record.start == datetime.datetime(2026, 11, 2, 10, tzinfo=datetime.UTC)
    (message,) = record.messages
    assert f"time_s is {how}" in message
    assert "shifted so that 2026-11-02 10:00:00 UTC is 0 s" in message and ",:" not in message


def test_parquet_types_are_all_read(tmp_path: Path) -> None:
    start = datetime.datetime(2026, 11, 2, 10, tzinfo=datetime.UTC)
    path = _parquet(
        tmp_path,
        when=pa.array([start, start + datetime.timedelta(seconds=1), None], pa.timestamp("us", "UTC")),
        heater_power_W=pa.array([600, None, 1], pa.int16()),
        T_tank_C=pa.array([20.5, 21.5, 22.5], pa.float32()),
        alarm=pa.array([True, False, None]),
        T_heater_C=pa.array(["20,5", "21", ""]).dictionary_encode(),
        T_pm1_C=pa.array([None, None, None], pa.null()),
        trace=pa.array([[1], [2], [3]]),
    )
    record = read_record(path)
    assert record.time_s.tolist() == [0, 1]
    assert record.start == start
    assert np.array_equal(record.columns["heater_power_W"], [600, np.nan], equal_nan=True)
    assert record.columns["T_tank_C"].tolist() == [20.5, 21.5]
    assert record.columns["alarm"].tolist() == [1, 0]
    assert record.columns["T_heater_C"].tolist() == [20.5, 21]
    assert np.isnan(record.columns["T_pm1_C"]).all()
    assert any("column 'trace' holds list" in said for said in record.messages)


def test_integer_epoch_keeps_its_nanoseconds_and_drops_an_unset_clock(tmp_path: Path) -> None:
    first = 1_793_613_600_000_000_000
    path = _parquet(tmp_path, time_s=pa.array([5, first, first + 100, None]), T_tank_C=[1.0, 2.0, 3.0, 4.0])
    record = read_record(path)
    assert record.time_s == pytest.approx([0, 1e-7], abs=1e-12)
    assert record.columns["T_tank_C"].tolist() == [2, 3]
    assert any("2 rows have no readable time" in said for said in record.messages)


def test_a_header_that_numpy_commented_out_is_found(tmp_path: Path) -> None:
    record = read_record(_csv(tmp_path, "# time_s,T_tank_C\n0,20\n1,21\n"))
    assert record.columns["T_tank_C"].tolist() == [20, 21]


def test_a_byte_order_mark_windows_lines_and_latin_1_are_read(tmp_path: Path) -> None:
    record = read_record(_csv(tmp_path, b"\xef\xbb\xbftime_s,T_tank_C\r\n0,20\r\n1,21\r\n"))
    assert record.columns["T_tank_C"].tolist() == [20, 21]
    assert record.messages == ()
    record = read_record(_csv(tmp_path, b"time_s,T_tank_C\r0,20\r1,21\r"))
    assert record.columns["T_tank_C"].tolist() == [20, 21]
    record = read_record(_csv(tmp_path, b"time_s,T_tank_C,\xb0\n0,20,1\n1,21,1\n"))
    assert "line 1 is not UTF-8; read as Latin-1" in record.messages
    assert "°" in record.columns


def test_missing_columns_are_named_with_the_nearest(tmp_path: Path) -> None:
    record = read_record(_csv(tmp_path, "time_s,T_tank_C,T_heater_C\n0,20,\n1,21,\n"))
    record.require("T_tank_C")
    with pytest.raises(RecordError) as caught:
        record.require("T_tnk_C", "T_heater_C", "pump_speed_pct")
    sentence = str(caught.value)
    assert sentence.startswith(str(record.path))
    for part in (
        "T_tnk_C (did you mean T_tank_C?)",
        "T_heater_C (there, but without a value)",
        "pump_speed_pct; it has",
    ):
        assert part in sentence


names = st.lists(
    st.sampled_from(["heater_power_W", "fan_speed_pct", "T_tank_C", "T_pm1_C", "flow_L_per_min"]),
    min_size=1,
    unique=True,
)
cells = st.one_of(st.just(float("nan")), st.floats(-200, 500).filter(lambda x: x not in (*SENTINELS, *CODES)))
"""Numbers that are possible in every unit of `names`."""


@st.composite
def records(draw: st.DrawFn) -> Record:
    """Records of 1 to 40 samples with missing values anywhere."""
    time_s = np.cumsum(draw(st.lists(st.floats(1e-3, 1e3), min_size=1, max_size=40)))
    n = len(time_s)
    columns = {name: np.array(draw(st.lists(cells, min_size=n, max_size=n))) for name in draw(names)}
    return Record(time_s, columns)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(record=records(), suffix=st.sampled_from([".csv", ".parquet"]))
def test_what_is_written_reads_back_exactly(tmp_path: Path, record: Record, suffix: str) -> None:
    path = tmp_path / f"drawn{suffix}"
    write_record(record, path)
    again = read_record(path)
    assert np.array_equal(again.time_s, record.time_s)
    assert list(again.columns) == list(record.columns)
    for name, values in record.columns.items():
        assert np.array_equal(again.columns[name], values, equal_nan=True)
    assert list(tmp_path.iterdir()) == [path]
    path.unlink()


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(record=records(), order=st.randoms(use_true_random=False))
def test_shuffled_rows_read_as_the_sorted_record(tmp_path: Path, record: Record, order: Any) -> None:
    rows = list(range(len(record.time_s)))
    order.shuffle(rows)
    shuffled = Record(record.time_s[rows], {name: values[rows] for name, values in record.columns.items()})
    write_record(shuffled, tmp_path / "shuffled.parquet")
    again = read_record(tmp_path / "shuffled.parquet")
    assert np.array_equal(again.time_s, record.time_s)
    for name, values in record.columns.items():
        assert np.array_equal(again.columns[name], values, equal_nan=True)


def test_an_unknown_suffix_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match=r"suffix '.mat'; a record is written as .parquet or .csv"):
        write_record(Record(np.zeros(1), {"T_tank_C": np.zeros(1)}), tmp_path / "r.mat")


SIGNALS = (
    Signal("heater_power_set", "W", "setpoint"),
    Signal("alarm_bits", "1", "status"),
    Signal("heater_power", "W", role="heater_power"),
    Signal("T_tank", "degC"),
    Signal("T_pm1", "degC", bus="can"),
)
"""In an order that an export must change: measured before set-points before status."""


def _journal(path: Path, n: int) -> tuple[np.ndarray, np.ndarray]:
    """A journal of `n` ticks at `path`; its values `(n, 5)` and qualities `(n, 5)`."""
    rng = np.random.default_rng(3)
    values = rng.normal(20, 3, (n, len(SIGNALS)))
    quality = np.zeros(values.shape, dtype=np.uint8)
    quality[n // 3 : n // 2, 4] = Quality.SENSOR_FAULT
    values[n // 3 : n // 2, 4] = 327.67
    quality[-1, 4], values[-1, 4] = Quality.LINK_FAULT, np.nan
    writer = JournalWriter(path, Header(SIGNALS, {"T_tank_C": ("T_tank_C",)}, ("static",), "p", float(n), 1.0, {}))
    for tick in range(n):
        writer.sample(tick, float(tick), 0.0, 0.0, values[tick].tolist(), quality[tick].tolist(), [tick] * len(SIGNALS))
    writer.close()
    return values, quality


def test_the_record_equals_the_journal_sample_for_sample(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.journal.export.PAGE", 64)
    values, quality = _journal(tmp_path / "journal.sqlite", 300)
    (tmp_path / "run.json").write_text('{"uid": "abc"}')
    made = export_record(tmp_path / "journal.sqlite", tmp_path / "record.parquet")
    assert (made.rows, made.columns, made.not_always_good) == (300, 6, ("T_pm1_C",))
    assert made.size == (tmp_path / "record.parquet").stat().st_size
    record = read_record(tmp_path / "record.parquet")
    assert list(record.columns) == ["heater_power_W", "T_tank_C", "T_pm1_C", "heater_power_set_W", "alarm_bits"]
    assert record.time_s.tolist() == list(range(300))
    for index, signal in enumerate(SIGNALS):
        expected = np.where(quality[:, index] == Quality.GOOD, values[:, index], np.nan)
        assert np.array_equal(record.columns[signal.column], expected, equal_nan=True), signal.name
    assert np.array_equal(record.quality["T_pm1_C"], quality[:, 4])
    assert list(record.quality) == ["T_pm1_C"]
    assert record.messages == (
        "T_pm1_C: 51 of 300 values missing (sensor fault, link fault), the longest stretch 50 samples at 1 min 40 s",
    )
    assert json.loads(record.metadata["hil"])["run"] == {"uid": "abc"}
    schema = pq.read_schema(tmp_path / "record.parquet")
    assert schema.names[0] == "time_s"
    assert schema.field("T_pm1_C").metadata[b"bus"] == b"can"
    assert schema.field("T_pm1_C").metadata[b"unit"] == b"degC"
    assert pq.ParquetFile(tmp_path / "record.parquet").metadata.row_group(0).column(0).compression == "ZSTD"


def test_quality_survives_a_csv_copy(tmp_path: Path) -> None:
    _, quality = _journal(tmp_path / "journal.sqlite", 60)
    export_record(tmp_path / "journal.sqlite", tmp_path / "record.parquet", metadata={"uid": "x"})
    write_record(read_record(tmp_path / "record.parquet"), tmp_path / "copy.csv")
    assert np.array_equal(read_record(tmp_path / "copy.csv").quality["T_pm1_C"], quality[:, 4])


def test_a_run_that_never_ticked_exports_an_empty_record(tmp_path: Path) -> None:
    header = Header(SIGNALS, {}, (), "p", 60.0, 1.0, {})
    JournalWriter(tmp_path / "journal.sqlite", header).close()
    assert export_record(tmp_path / "journal.sqlite", tmp_path / "record.parquet").rows == 0
    with pytest.raises(RecordError, match="holds no samples"):
        read_record(tmp_path / "record.parquet")


def test_a_failed_export_leaves_the_old_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _journal(tmp_path / "journal.sqlite", 10)
    (tmp_path / "record.parquet").write_bytes(b"old")

    def full_disk(table: pa.Table, where: BinaryIO, **options: Any) -> None:
        where.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pyarrow.parquet.write_table", full_disk)
    with pytest.raises(OSError, match="No space"):
        export_record(tmp_path / "journal.sqlite", tmp_path / "record.parquet")
    assert (tmp_path / "record.parquet").read_bytes() == b"old"
    assert not list(tmp_path.glob("*.part"))


@needs_data
@pytest.mark.parametrize(("name", "rows"), [("commissioning", 36_000), ("campaign", 144_000)])
def test_a_stranger_record_reads_without_a_word(name: str, rows: int) -> None:
    record = read_record(DATA / "stranger" / "d0" / f"{name}.parquet")
    assert record.messages == ()
    assert len(record.time_s) == rows
    record.require("heater_power_W", "pump_speed_pct", "fan_speed_pct", "T_ambient_C", "T_heater_C", "T_tank_C")


@needs_data
@pytest.mark.parametrize(
    ("name", "rows", "messages"),
    [
        ("tclab/mimo_train.csv", 600, ["column 'Time' is taken for time_s", "no unit suffix: H1, H2, T1, T2"]),
        ("heated_pipe/ulg_151202.csv", 179, ["sampling is irregular", "T_pipe_out_C is 0 throughout", "m_flow_kg_s"]),
        ("heated_pipe/ulg_160104_2.csv", 2038, ["steps of 3.2 to 7.72 s, typically 4.8 s", "m_flow_kg_s"]),
    ],
)
def test_public_time_series_read_with_sensible_messages(name: str, rows: int, messages: list[str]) -> None:
    record = read_record(DATA / "real" / name)
    assert len(record.time_s) == rows
    assert len(record.messages) == len(messages)
    for message in messages:
        assert any(message in said for said in record.messages), record.messages


@needs_data
@pytest.mark.parametrize("name", ["psa_cooling/wct_exp1_exp.csv", "tower_reference/kern_ch17_examples.csv"])
def test_public_steady_states_are_refused_for_want_of_a_time(name: str) -> None:
    with pytest.raises(RecordError, match=r"line \d has no column time_s .* name the column of sample times"):
        read_record(DATA / "real" / name)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time_s,T1_F\n0,70\n1,71\n", "T1_F is in degrees Fahrenheit by its name, and twins read degC: subtract 32"),
        ("time_s,T1_K\n0,293\n1,294\n", "T1_K is in kelvin by its name, and twins read degC: subtract 273.15"),
        ("time_s,T1_K\n0,20\n1,21\n", "T1_K is in kelvin by its name, but its median is 20.5: if it is in degC"),
        ("time_s,T_in_K\n0,20\n1,21\n", "T_in_C has a median of -252.6: was it in degC before?"),
        ("time_s,heater_1_pct,T1_C\n0,0,20\n1,0.5,21\n", "heater_1_pct is 0 to 0.5: is it a fraction of 1?"),
        (
            "time_s,heater_1_pct,T_amb_C,T1_C\n0,50,21,69.8\n1,50,21,80\n",
            "T1_C begins at 69.8 in a room of 21 degC, which",
        ),
        ("time_s,heater_1_pct,T_amb_C,T1_C\n0,0,21,90\n1,0,21,80\n", "with everything off: is the rig hot from before"),
    ],
)
def test_numbers_that_their_unit_does_not_bear_out_are_asked_about(tmp_path: Path, text: str, message: str) -> None:
    assert any(message in said for said in read_record(_csv(tmp_path, text)).messages)


@pytest.mark.parametrize(
    "text",
    [
        "time_s,heater_1_pct,T_amb_C,T1_C\n0,0,21,21\n1,50,21,70\n",
        "time_s,heater_1_pct,T_amb_C,T1_C\n0,50,21,90\n1,50,21,90\n",
        "time_s,heater_1_pct,T1_C\n0,0,20\n1,0,21\n",
        "time_s,T1_C,dT_K\n0,20,1\n1,21,2\n",
    ],
)
def test_ordinary_numbers_are_not_asked_about(tmp_path: Path, text: str) -> None:
    assert read_record(_csv(tmp_path, text)).messages == ()


def test_a_missing_column_is_looked_for_under_other_spellings_and_units(tmp_path: Path) -> None:
    record = read_record(_csv(tmp_path, "time_s,HEATER_1_PCT,t1_c,T2_F,heater_2_pct\n0,0,20,70,1\n1,50,21,71,2\n"))
    with pytest.raises(RecordError) as caught:
        record.require("heater_1_pct", "heater_2_pct", "heater_3_pct", "T1_C", "T2_C")
    for part in (
        "heater_1_pct (did you mean HEATER_1_PCT?)",
        "heater_3_pct, T1_C (did you mean t1_c?)",
        "T2_C (T2_F is in degrees Fahrenheit by its name: subtract 32 and divide by 1.8, and call it T2_C)",
    ):
        assert part in str(caught.value)
