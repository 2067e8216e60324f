"""Rows of a record in time order, and messages about irregular steps between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hil.record.raw import RawRecord
from hil.record.times import GAP_PERIODS, TimeAxis, span


def order(raw: RawRecord, axis: TimeAxis) -> tuple[NDArray[np.int64], list[str]]:
    """Return the rows with a readable time in time order, equal times in file order, and messages."""
    rows = np.flatnonzero(np.isfinite(axis.seconds))
    stamps = axis.seconds[rows]
    steps = np.diff(stamps)
    messages = []
    if (steps < 0).any():
        first = int(np.argmax(steps < 0)) + 1
        count = int((steps < 0).sum())
        again = "once" if count == 1 else f"{count} times"
        back = -steps.min()
        message = f"time goes back {again}, by up to {span(back)} (first at {raw.place(int(rows[first]))}): rows sorted"
        if back > max(60.0, 0.1 * np.ptp(stamps)):
            message += "; if these are two records in one file, split it"
        messages.append(message)
        rows = rows[np.argsort(stamps, kind="stable")]
    return rows, messages


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
