"""Files whose time goes back, tables side by side, and damaged lines."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from hil.record.reader import Record, RecordError, read_record


def _read(tmp_path: Path, stamps: Sequence[object], name: str = "time_s") -> Record:
    rows = "".join(f"{stamp},{20 + k / 8}\n" for k, stamp in enumerate(stamps))
    return _text(tmp_path, f"{name},T_in_C\n{rows}")


def _text(tmp_path: Path, text: str | bytes) -> Record:
    path = tmp_path / "clock.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_record(path)


def _from(first: float, count: int, step: float = 10.0) -> list[float]:
    return [first + step * k for k in range(count)]


@pytest.mark.parametrize(
    ("stamps", "line"),
    [
        ([*_from(0, 30), *_from(3, 30)], 32),  # began again with another phase
        ([*_from(0, 30), *_from(0, 30)], 32),
        ([*_from(0, 30), *_from(204, 30)], 32),  # set back by some rows
        ([*_from(0, 30), *_from(5, 20, 12.3)], 32),
        ([*_from(600, 30), *_from(450, 30)], 32),
    ],
)
def test_a_second_segment_among_the_times_of_the_first_is_refused(
    tmp_path: Path, stamps: list[float], line: int
) -> None:
    with pytest.raises(RecordError, match=rf"line {line}: the time goes back by .* would interleave.*split it"):
        _read(tmp_path, stamps)


def test_the_times_go_on_where_a_clock_was_set_back_by_a_few_rows(tmp_path: Path) -> None:
    record = _read(tmp_path, [*_from(0, 100), *_from(943, 100)])
    assert record.time_s == pytest.approx(_from(0, 200))
    assert record.columns["T_in_C"] == pytest.approx([20 + k / 8 for k in range(200)])
    (said,) = [m for m in record.messages if "goes back once, by up to 47 s (first at line 102)" in m]
    assert "as a clock that was set back: the times go on there" in said


def test_a_few_rows_that_are_repeated_are_left_out(tmp_path: Path) -> None:
    values = [*range(100), *range(95, 200)]
    record = _text(tmp_path, "time_s,T_in_C\n" + "".join(f"{10 * k},{20 + k / 8}\n" for k in values))
    assert record.time_s.tolist() == _from(0, 200)
    assert any("rows from line 102 on are left out, since the file has their times" in m for m in record.messages)


@pytest.mark.parametrize(
    "stamps",
    [
        [*_from(0, 20), *_from(300, 20), *_from(200, 10)],  # a gap that is filled later
        [*_from(300, 20), *_from(0, 20)],  # two files joined in the wrong order
        [0, 10, 30, 20, 40, 60, 50, *_from(70, 20)],  # late rows
        list(reversed(_from(0, 40))),  # the newest first
        [10.0 * k for k in np.random.default_rng(3).permutation(80).tolist()],  # no order
    ],
)
def test_rows_in_another_order_are_sorted_and_none_is_lost(tmp_path: Path, stamps: list[float]) -> None:
    record = _read(tmp_path, stamps)
    assert record.time_s.tolist() == sorted(stamps)
    by_time = [20 + k / 8 for k in np.argsort(stamps, kind="stable")]
    assert record.columns["T_in_C"].tolist() == by_time


def test_a_restart_in_a_file_with_the_newest_row_first_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="would interleave"):
        _read(tmp_path, list(reversed([*_from(0, 30), *_from(3, 30)])))


def test_a_segment_that_begins_a_file_with_the_newest_row_first_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match=r"goes back by .* to times that the file has already"):
        _read(tmp_path, [*_from(0, 30), *_from(3, 25)][::-1])


def test_columns_with_rows_of_their_own_may_follow_each_other(tmp_path: Path) -> None:
    rows = "".join(f"{t:g},{t / 10},\n" for t in _from(0, 30)) + "".join(f"{t:g},,500\n" for t in _from(3, 30))
    record = _text(tmp_path, f"time_s,T_in_C,fan_W\n{rows}")
    assert len(record.time_s) == 60 and not any("goes back" in said for said in record.messages)


@pytest.mark.parametrize("first", ["2000-01-01", "1970-01-01"])
def test_a_clock_that_lost_its_date_is_refused(tmp_path: Path, first: str) -> None:
    stamps = [f"{day} 08:{k:02}:00" for day in ("2025-07-09", first) for k in range(30)]
    with pytest.raises(RecordError, match=r"line 32: the time goes back by [\d.]+ years, as that of a clock"):
        _read(tmp_path, stamps, "Time")


def test_tables_side_by_side_keep_the_times_of_their_columns(tmp_path: Path) -> None:
    rows = "".join(f"{10 * k},{20 + k},{15 * k + 5},{500 + k}\n" for k in range(12)) + "120,32,,\n"
    record = _text(tmp_path, f"Time,T_in_C,Time,fan_W\n{rows}")
    known = np.isfinite(record.columns["fan_W"])
    assert record.time_s[known].tolist() == [15.0 * k + 5 for k in range(12)]
    assert record.time_s[np.isfinite(record.columns["T_in_C"])].tolist() == [10.0 * k for k in range(13)]
    assert any("2 tables with times of their own stand side by side ('Time')" in said for said in record.messages)


def test_times_that_are_repeated_are_left_out(tmp_path: Path) -> None:
    rows = "".join(f"{10 * k},{20 + k},{10 * k},{500 + k}\n" for k in range(12))
    record = _text(tmp_path, f"Time,T_in_C,Time,fan_W\n{rows}")
    assert list(record.columns) == ["T_in_C", "fan_W"] and len(record.time_s) == 12


def test_times_of_which_a_column_may_have_either_are_refused(tmp_path: Path) -> None:
    rows = "".join(f"{10 * k},{10 * k + 3},{500 + k}\n" for k in range(12))
    with pytest.raises(RecordError, match=r"'Time' stand 2 times with different cells.*give a file for each"):
        _text(tmp_path, f"Time,Time,fan_W\n{rows}")


@pytest.mark.parametrize("row", [40, 9000])
def test_zero_bytes_in_a_line_are_named_with_it(tmp_path: Path, row: int) -> None:
    lines = [b"time_s,T_in_C", *(f"{k},20.{k % 10}".encode() for k in range(row + 20))]
    lines[row - 1] = b"\0" * 64
    with pytest.raises(RecordError, match=rf"clock.csv line {row} holds 64 zero bytes, as a logger"):
        _text(tmp_path, b"\n".join(lines))


def test_a_quote_that_does_not_end_is_named_with_its_line(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="line 4 has a quote that does not end there"):
        _text(tmp_path, "time_s,T_in_C\n0,20\n1,21\n" + '2,"22\n' + "3,23\n4,24\n")


def test_a_note_over_two_lines_is_read(tmp_path: Path) -> None:
    record = _text(tmp_path, "time_s,T_in_C,note\n" + "".join(f'{k},20,"first\nsecond"\n' for k in range(9)))
    assert len(record.time_s) == 9


@pytest.mark.parametrize(
    ("name", "bits", "count_s", "step", "rows"),
    [
        ("time_s", 16, 1.0, 1, 100),
        ("time_ms", 32, 1e-3, 500, 100),
        ("time_us", 32, 1e-6, 250_000, 100),
        ("time_ms", 16, 1e-3, 500, 400),  # It begins again three times.
    ],
)
def test_a_counter_that_began_again_goes_on(
    tmp_path: Path, name: str, bits: int, count_s: float, step: int, rows: int
) -> None:
    counts = [2**bits - 40 * step + step * k for k in range(rows)]
    record = _read(tmp_path, [count % 2**bits for count in counts], name)
    assert np.diff(record.time_s) == pytest.approx([step * count_s] * (rows - 1))
    assert record.columns["T_in_C"] == pytest.approx([20 + k / 8 for k in range(rows)])
    assert any(f"a counter of {bits} bits that began again" in said for said in record.messages)


@pytest.mark.parametrize("back", [70_000, 65_000, 3_000])
def test_other_steps_back_are_no_rollover(tmp_path: Path, back: int) -> None:
    stamps = [*range(70_000, 70_100), *range(70_100 - back, 70_200 - back)]
    path = tmp_path / "again.csv"
    path.write_text("time_s,T_in_C\n" + "".join(f"{stamp},20\n" for stamp in stamps))
    assert not any("began again" in said for said in read_record(path).messages)
