"""Rows of a record in time order, and messages about irregular steps between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hil.record.clock_jumps import YEAR_S
from hil.record.raw import RawRecord, RecordError
from hil.record.times import GAP_PERIODS, TimeAxis, span
from hil.record.values import Sign, may_be_lost, parse

ORDERED = 4
"""Fewest rows between two steps back of a file in the order of a clock; rows in no order have two in the mean."""
INTERLEAVED = 3
"""Times that a segment must pass earlier rows: fewer are rows that one delivery brought late."""


def order(raw: RawRecord, axis: TimeAxis, signs: dict[str, Sign]) -> tuple[NDArray[np.int64], list[str]]:
    """Return the rows with a readable time in time order, equal times in file order, and messages.

    A clock that was set back, or a logger that began again, gives a second segment of rows at times that the file has
    already. Sorted, the two would interleave: a few such rows are left out, more are refused. Rows that come late, rows
    in no order at all, and rows that fill a gap are sorted.

    Raises
    ------
    RecordError
        Dates go back by more than a year, or more than `may_be_lost` rows of a second segment would interleave with the
        first.
    """
    rows = np.flatnonzero(np.isfinite(axis.seconds))
    stamps = axis.seconds[rows]
    steps = np.diff(stamps)
    messages = []
    if (steps < 0).any() and (steps <= 0).all():
        messages.append("the newest row stands first: rows sorted")
        return rows[np.argsort(stamps, kind="stable")], messages
    if (steps < 0).any():
        first = int(np.argmax(steps < 0)) + 1
        count = int((steps < 0).sum())
        again = "once" if count == 1 else f"{count} times"
        back = -steps.min()
        message = f"time goes back {again}, by up to {span(back)} (first at {raw.place(int(rows[first]))}): rows sorted"
        if axis.start is not None and back > YEAR_S:
            worst = int(np.argmin(steps)) + 1
            where = raw.place(int(rows[worst]))
            raise RecordError(
                f"{raw.path} {where}: the time goes back by {back / YEAR_S:.3g} years, as that of "
                "a clock that was not set; correct the times of the rows before or after it, or take them out"
            )
        second, is_late = _second_segments(raw, axis, rows, signs)
        if not is_late:  # Columns with times of their own: of none of them does the time go back.
            return rows[np.argsort(stamps, kind="stable")], messages
        if second.any():
            at = int(np.argmax(second))
            place = raw.place(int(rows[at]))
            if second.sum() > may_be_lost(len(rows)):
                # Where the newest row stands first, the segment may be the beginning of the file.
                passed = span(float(stamps[:at].max() - stamps[at] if at else back))
                raise RecordError(
                    f"{raw.path} {place}: the time goes back by {passed} to times that the file has already, and "
                    f"{second.sum()} rows would interleave with those before; if these are two records in one file, "
                    "split it there, else correct the times after it"
                )
            message += f"; {second.sum()} rows from {place} on are left out, since the file has their times already"
        if back > max(60.0, 0.1 * np.ptp(stamps)):
            message += "; if these are two records in one file, split it"
        messages.append(message)
        rows, stamps = rows[~second], stamps[~second]
        rows = rows[np.argsort(stamps, kind="stable")]
    return rows, messages


def _second_segments(
    raw: RawRecord, axis: TimeAxis, rows: NDArray[np.int64], signs: dict[str, Sign]
) -> tuple[NDArray[np.bool_], bool]:
    """Return which of `rows (k,)` belong to a segment that interleaves with earlier rows of one of its columns.

    The second result is True where the time of any column goes back.
    """
    is_late = False
    found = np.zeros(len(rows), dtype=np.bool_)
    seen: set[bytes] = set()
    for name, cells in zip(raw.names, raw.cells, strict=True):
        numbers = None if name in axis.columns else parse(cells, signs.get(name, "."))
        if numbers is None or numbers.bad > numbers.present / 2:
            continue
        held = np.isfinite(numbers.values[rows])
        key = np.packbits(held).tobytes()
        if key not in seen:
            seen.add(key)
            at = np.flatnonzero(held)
            found[at] |= _interleaved(axis.seconds[rows[at]])
            is_late |= bool((np.diff(axis.seconds[rows[at]]) < 0).any())
    return found, is_late


def _interleaved(stamps: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which stamps (k,), in file order, are of a segment that goes back and runs on among earlier stamps.

    Rows in no order, whose ascending runs have fewer than `ORDERED` rows in the mean, show no clock.
    """
    out = np.zeros(len(stamps), dtype=np.bool_)
    steps = np.diff(stamps)
    if not (steps < 0).any() or len(stamps) < ORDERED * (int((steps < 0).sum()) + 1):
        if not ((steps > 0).any() and len(stamps) >= ORDERED * (int((steps > 0).sum()) + 1)):
            return out
        return _interleaved(stamps[::-1])[::-1]  # The newest row stands first.
    latest = np.maximum.accumulate(stamps)
    late = stamps < latest
    edges = np.flatnonzero(np.diff(np.concatenate([[0], late.astype(np.int8), [0]])))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        earlier = np.sort(stamps[:begin])
        block = stamps[begin:end]
        # Rows of the block with an earlier row between them and the next one, or at the same time.
        between = np.searchsorted(earlier, block[1:], "right") - np.searchsorted(earlier, block[:-1], "left")
        if (between > 0).sum() >= INTERLEAVED:
            out[begin:end] = True
    return out


def describe_steps(time_s: NDArray[np.float64]) -> list[str]:
    """Return messages about gaps and rate of strictly increasing `time_s (n,)`."""
    steps = np.diff(time_s)
    if len(steps) < 2:
        return []
    messages = []
    typical = float(np.median(steps))
    gaps = steps > GAP_PERIODS * typical
    if gaps.any():
        longest = int(np.argmax(steps))
        count = "1 gap" if gaps.sum() == 1 else f"{gaps.sum()} gaps"
        messages.append(
            f"{count} longer than {span(GAP_PERIODS * typical)}, the longest {steps[longest]:.4g} s at "
            f"{span(time_s[longest])}"
        )
    low, high = np.percentile(steps[~gaps], [5, 95])
    if high - low > 0.1 * typical:
        messages.append(f"sampling is irregular: steps of {low:.3g} to {high:.3g} s, typically {typical:.3g} s")
    return messages
