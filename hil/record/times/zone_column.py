"""Time zones in a column of their own, row by row: `Date,Time,TZ`."""

from __future__ import annotations

import datetime
import re
from dataclasses import replace

import numpy as np

from hil.record.raw import RawRecord
from hil.record.times.seconds import ZONELESS, Seconds, text_of
from hil.record.times.zones import CELL, minutes_of

_NAMES = (
    "tz",
    "time zone",
    "timezone",
    "zeitzone",
    "utc offset",
    "utcoffset",
    "gmt offset",
    "tz offset",
    "fuseau horaire",
)
_CELL = re.compile(rf"(?:{CELL}|[+-]\d{{1,2}}(?::?\d{{2}})?)", re.IGNORECASE)


def with_zone_column(
    raw: RawRecord, columns: tuple[str, ...], read: Seconds
) -> tuple[tuple[str, ...], Seconds, list[str]]:
    """Return the columns and the times in UTC by a column of zones, and messages; unchanged where there is none."""
    name = next((n for n in raw.names if re.sub(r"[ _]+", " ", n.strip().lower()) in _NAMES), None)
    if name is None or name in columns or not read.zoneless or read.start is None:
        return columns, read, []
    cells = text_of(raw.cells[raw.names.index(name)])
    known = np.isfinite(read.seconds)
    bad = next((row for row, cell in enumerate(cells) if known[row] and (not cell or not _CELL.fullmatch(cell))), None)
    if bad is not None:
        return columns, read, [f"column '{name}' has '{cells[bad] or ''}' ({raw.place(bad)}), no known zone: not used"]
    ahead = np.array([60.0 * minutes_of(cell) if cell and _CELL.fullmatch(cell) else np.nan for cell in cells])
    seconds = read.seconds - ahead
    first = float(np.nanmin(seconds))
    start = read.start + datetime.timedelta(seconds=first)
    how = read.how.replace(ZONELESS, f"in the zones of '{name}'")
    return (*columns, name), replace(read, seconds=seconds - first, start=start, how=how, zoneless=False), []
