"""Parts of a second in a column of their own, beside times in whole seconds: `Date,Time,ms`."""

from __future__ import annotations

import datetime
import re
from dataclasses import replace

import numpy as np

from hil.record.raw import RawRecord
from hil.record.times.seconds import Seconds
from hil.record.values import Sign, parse

_PARTS = (
    (1e-3, r"ms|msecs?|millis?|milliseconds?|millisekunden?|millisecondes?|milisegundos|millisecondi"),
    (1e-6, r"us|µs|usecs?|micros?|microseconds?|mikrosekunden?|microsecondes?"),
    (1e-9, r"ns|nsecs?|nanos?|nanoseconds?|nanosekunden?"),
    (1e-2, r"hundredths?|hundertstel|centi[eè]mes|centiseconds?"),
    (1e-1, r"tenths?|zehntel|dixi[eè]mes"),
)
_NAME = r"(?:time|zeit|timestamp|sub|fraction|frac|fractional)?[\s_.\[(]*(?:{})[\])]?"


def with_subseconds(
    raw: RawRecord, columns: tuple[str, ...], read: Seconds, signs: dict[str, Sign]
) -> tuple[tuple[str, ...], Seconds, list[str]]:
    """Return the columns and the times with the parts of a second that a column of its own gives, and messages.

    Its name is a part of a second, and all its numbers are whole and below one second. Times that have fractions
    themselves are complete.
    """
    known = np.isfinite(read.seconds)
    whole = read.seconds[known]
    if not len(whole) or (np.abs(whole - np.round(whole)) > 1e-6).any():
        return columns, read, []
    for name, cells in zip(raw.names, raw.cells, strict=True):
        if name in columns or (part := _part_of(name)) is None:
            continue
        numbers = parse(cells, signs.get(name, "."))
        if numbers is None or numbers.bad or not np.isfinite(numbers.values[known]).all():
            continue
        counts = numbers.values
        there = counts[known]
        if (there < 0.0).any() or (there * part >= 1.0).any() or (there != np.round(there)).any():
            return columns, read, [f"column '{name}' has numbers that are no parts of a second: not added to the times"]
        seconds = np.round((read.seconds + counts * part) / part) * part
        first = float(np.nanmin(seconds)) if read.start is not None else 0.0
        start = None if read.start is None else read.start + datetime.timedelta(seconds=first)
        said = [f"column '{name}' gives the parts of a second of the times"] if there.any() else []
        return (*columns, name), replace(read, seconds=seconds - first, start=start), said
    return columns, read, []


def _part_of(name: str) -> float | None:
    bare = name.strip().lower()
    return next((part for part, words in _PARTS if re.fullmatch(_NAME.format(words), bare)), None)
