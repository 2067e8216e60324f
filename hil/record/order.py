"""Rows of a record in time order, and messages about irregular steps between them."""

from __future__ import annotations

import dataclasses

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


def without_set_back(raw: RawRecord, axis: TimeAxis, signs: dict[str, Sign]) -> tuple[TimeAxis, list[str]]:
    """Return the axis with times that go on where a clock was set back by a little, and a message.

    The rows after it have times that the file has already and other values: the rig went on meanwhile. Left out, they
    would take minutes out of the record without a gap. Rows with the values of those before are repeated ones, which
    `order` leaves out, and more than `may_be_lost` may be another record.
    """
    rows = np.flatnonzero(np.isfinite(axis.seconds))
    stamps = axis.seconds[rows]
    steps = np.diff(stamps)
    if "segment" in raw.names or not (steps < 0).any() or not (steps > 0).any():
        return axis, []
    second, _ = _second_segments(raw, axis, rows, signs)
    begins = np.flatnonzero(np.diff(second.astype(np.int8), prepend=0) > 0)
    if not len(begins) or second.sum() > may_be_lost(len(rows)):
        return axis, []
    typical, seconds = float(np.median(steps[steps > 0])), axis.seconds.copy()
    back, places = [], []
    for at in begins:
        end = int(at) + int(np.argmin(np.append(second[at:], False)))
        goes_on = at > 0 and end < len(stamps) and stamps[at - 1] == stamps[:at].max() and steps[at - 1] < 0.0
        if not goes_on or _repeated(raw, rows, stamps, signs, slice(int(at), end)):
            continue
        seconds[rows[at] :] += typical - steps[at - 1]
        back.append(-float(steps[at - 1]))
        places.append(raw.place(int(rows[at])))
    if not back:
        return axis, []
    again = "once" if len(back) == 1 else f"{len(back)} times"
    said = (
        f"{axis.column} goes back {again}, by up to {span(max(back))} (first at {places[0]}), to times that the file "
        "has already and with other values, as a clock that was set back: the times go on there, and later ones are by "
        "as much later than the file has them"
    )
    return dataclasses.replace(axis, seconds=seconds), [said]


def _repeated(
    raw: RawRecord,
    rows: NDArray[np.int64],
    stamps: NDArray[np.float64],
    signs: dict[str, Sign],
    block: slice,
) -> bool:
    """Return True if most rows of a block have the values of earlier rows at the same times."""
    before = {float(stamp): k for k, stamp in enumerate(stamps[: block.start])}
    pairs = [(k, before[float(stamps[k])]) for k in range(block.start, block.stop) if float(stamps[k]) in before]
    if 2 * len(pairs) <= block.stop - block.start:
        return False
    here, there = (rows[[pair[side] for pair in pairs]] for side in (0, 1))
    same = np.ones(len(pairs), dtype=np.bool_)
    for name, cells in zip(raw.names, raw.cells, strict=True):
        numbers = parse(cells, signs.get(name, "."))
        if numbers is not None:
            same &= np.equal(numbers.values[here], numbers.values[there]) | ~np.isfinite(numbers.values[here])
    return bool(2 * same.sum() > len(same))


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
