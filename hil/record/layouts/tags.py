"""Samples of tags as historians export them in CSV: a row a sample, or a column a tag."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.historian import BAD, GOOD, UNCERTAIN, Samples
from hil.record.layouts.long_format import SERIES, VALUES, is_numeric
from hil.record.quality import is_rating_name, rating, texts_of
from hil.record.raw import RawRecord, ReadingOptions, RecordError
from hil.record.times import TimeTextError, find_columns, read_seconds
from hil.record.values import DecimalSignError, Sign, decimal_signs, may_be_lost, parse

Array = NDArray[np.float64]


def tag_samples(raw: RawRecord, choice: ReadingOptions | None = None) -> tuple[dict[str, Samples], bool]:
    """Return the samples of each tag in the order of the file, and True if the times are without a zone.

    Times without a zone are left as they are written, as if in UTC: which zone they are in is not the file's to say.
    A table with one column of values and one that names tags has a sample in each row; any other has a column for each
    tag, whose empty cells are no samples. Ratings become OPC codes: good 192, uncertain 64, bad 0.

    Parameters
    ----------
    raw
        Columns as the file stores them.
    choice
        The user's choices for the file.

    Raises
    ------
    RecordError
        The times cannot be read, or may be read in two ways; more cells than `may_be_lost` allows are no numbers.
    """
    choice = choice or ReadingOptions()
    cells = dict(zip(raw.names, raw.cells, strict=True))
    try:
        signs = decimal_signs(cells, raw.place, delimiter=raw.delimiter, given=choice.decimal)
        columns = find_columns(raw, signs, choice)
        read = read_seconds(raw, columns, signs, choice)
    except (TimeTextError, DecimalSignError) as error:
        raise RecordError(f"{raw.path}: {error}") from error
    if read is None or read.start is None:
        raise RecordError(
            f"{raw.path}: column '{', '.join(columns)}' gives no dates; write times as 2026-11-02T10:00:00Z"
        )
    time_s = read.seconds + (read.start - datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)).total_seconds()
    _require_times(raw, time_s, columns)
    low = {name.strip().lower(): name for name in raw.names if name not in columns}
    values = [low[name] for name in low if name in VALUES]
    names = [low[name] for name in SERIES if name in low and not is_numeric(cells[low[name]])]
    if len(values) == 1 and names:
        value = _numbers(raw, values[0], cells[values[0]], signs)
        return _by_row(raw, time_s, texts_of(cells[names[0]]), value), read.zoneless
    found = {}
    for name in raw.names:
        if name in columns or is_rating_name(name) or not is_numeric(cells[name]):
            continue
        value = _numbers(raw, name, cells[name], signs)
        there = np.isfinite(value) & np.isfinite(time_s)
        count = int(there.sum())
        found[name] = Samples(time_s[there], value[there], np.full(count, GOOD, dtype=np.int16))
    if not found:
        raise RecordError(
            f"{raw.path}: holds no samples of tags (it has {', '.join(raw.names)}); give the columns timestamp, tag, "
            f"value, quality, or a column for each tag"
        )
    return found, read.zoneless


def _by_row(raw: RawRecord, time_s: Array, tags: Sequence[str | None], value: Array) -> dict[str, Samples]:
    """Return the samples of a table with one in each row."""
    quality = _quality(raw)
    number = {name: k for k, name in enumerate(sorted({(tag or "").strip() for tag in set(tags)}))}
    names = list(number)
    code = np.fromiter((number[(tag or "").strip()] for tag in tags), dtype=np.intp, count=len(tags))
    known = np.isfinite(time_s) & np.array([bool(name) for name in names], dtype=bool)[code]
    order = np.argsort(code, kind="stable")
    ends = np.cumsum(np.bincount(code, minlength=len(names)))
    found = {}
    for name, rows in zip(names, np.split(order, ends[:-1]), strict=True):
        rows = rows[known[rows]]
        if len(rows):
            found[name] = Samples(time_s[rows], value[rows], quality[rows])
    return found


def _quality(raw: RawRecord) -> NDArray[np.int16]:
    """Return the OPC code of each row, good where no column rates the values."""
    found = np.full(len(raw.cells[0]), GOOD, dtype=np.int16)
    for name, cells in zip(raw.names, raw.cells, strict=True):
        if not is_rating_name(name):
            continue
        rated = rating(name, texts_of(cells))
        if rated is None or rated.unknown is not None:
            place = f" {raw.place(rated.unknown[0])}" if rated is not None and rated.unknown is not None else ""
            raise RecordError(
                f"{raw.path}{place}: column '{name}' has codes that are not known; write 192 for good, 64 for "
                f"uncertain, 0 for bad"
            )
        found[rated.uncertain] = UNCERTAIN
        found[rated.bad] = BAD
    return found


def _numbers(raw: RawRecord, name: str, cells: Any, signs: dict[str, Sign]) -> Array:
    """Return the numbers of a column, NaN for none."""
    numbers = parse(cells, signs.get(name, "."))
    if numbers is None:
        return np.full(len(cells), np.nan)
    if numbers.bad - numbers.marked > may_be_lost(numbers.present):
        raise RecordError(
            f"{raw.path} {raw.place(numbers.row)}: '{numbers.text}' of column '{name}' is no number, as {numbers.bad} "
            f"cells in all; correct them"
        )
    return numbers.values


def _require_times(raw: RawRecord, time_s: Array, columns: tuple[str, ...]) -> None:
    lost = np.flatnonzero(~np.isfinite(time_s))
    if len(lost) > may_be_lost(len(time_s)):
        raise RecordError(
            f"{raw.path} {raw.place(int(lost[0]))}: column '{', '.join(columns)}' has no time that can be read, as "
            f"{len(lost)} rows in all; write all times in one way"
        )
