"""Dates and times written as text to microseconds, in one format for a whole column.

`03/04/2026` is in March or in April, depending on the writer. A column shows which by a number above twelve, or by
days that follow each other at midnight; where neither does and the times between rows differ, it is refused.
"""

from __future__ import annotations

import datetime
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from hil.record.times.wall_clock import TimeTextError, require_full_clock
from hil.record.times.zones import CELL, minutes_of

Read = TypeVar("Read")

Order = Literal["ymd", "dmy", "mdy"]
ORDERS: tuple[Order, ...] = ("dmy", "mdy", "ymd")
WORDS = {"dmy": "day.month.year", "mdy": "month/day/year", "ymd": "year/month/day"}
MICROS_PER_DAY = 86_400_000_000
_EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)
_MICRO = datetime.timedelta(microseconds=1)

_MONTHS = {
    "jan": 1,
    "feb": 2,
    "mar": 3,
    "apr": 4,
    "may": 5,
    "jun": 6,
    "jul": 7,
    "aug": 8,
    "sep": 9,
    "oct": 10,
    "nov": 11,
    "dec": 12,
    "mär": 3,
    "mrz": 3,
    "mai": 5,
    "okt": 10,
    "dez": 12,
}
_TIME = (
    r"(?P<hour>\d{1,3}):(?P<minute>[0-5]\d)(?::(?P<second>[0-5]\d|60)(?:[.,:](?P<fraction>\d{1,9}))?)?"
    r"(?:\s*(?P<half>[AaPp])\.?\s?[Mm]\.?)?"
    rf"\s*(?:(?P<zone>(?i:{CELL}))(?:\s*\([A-Za-z ]+\))?)?"
)
_DATE = (
    r"(?:[A-Za-z]{2,9}\.?,?\s+)?(?:(?P<a>\d{1,4})(?P<sep>[-/.])(?P<b>\d{1,2})(?P=sep)(?P<c>\d{1,4})"
    r"|(?P<day>\d{1,2})[-/. ]+(?P<month>[A-Za-zä]{3,9})\.?[-/., ]+(?P<year>\d{4}|\d{2})"
    r"|(?P<month2>[A-Za-zä]{3,9})\.?\s+(?P<day2>\d{1,2}),?\s+(?P<year2>\d{4})"
    r"|(?P<compact>(?:19|20|21)\d{6}))"
)
_STAMP = re.compile(rf"{_DATE}(?:[T\s,_-]+{_TIME})?|(?P<long>(?:19|20|21)\d{{6}})[T_ -]?(?P<clock>\d{{6}})", re.ASCII)
_CLOCK = re.compile(rf"(?:(?P<days>\d{{1,5}})\s*d(?:ays?)?,?\s+)?{_TIME}", re.ASCII)
"""Time of day, or time from the beginning with its days before it: `1 days 02:03:04`, `0d 02:03:04`."""
_FOUR = re.compile(r"(\d{1,3}):([0-5]\d):([0-5]\d):(\d\d)", re.ASCII)
"""Days, hours, minutes and seconds, or hours, minutes, seconds and hundredths."""
_MINUTES = re.compile(r"(\d{1,5}):([0-5]\d[.,]\d+)", re.ASCII)
"""Minutes and seconds with decimals, `00:30.0`."""
_ZONE_BEHIND = re.compile(rf":\d{{2}}(?:[.,]\d+)?\s*(?:[AaPp]\.?\s?[Mm]\.?)?\s*({CELL})(?:\s*\(.*\))?$", re.IGNORECASE)
"""Zone at the end of a time."""
_HOUR = re.compile(r"(?:^|[T\s,_-])(\d{1,2}):[0-5]\d")


@dataclass(frozen=True, eq=False)
class Stamps:
    """Microseconds `(n,)` since 1970, None for a cell that is no date; their format, and True for a time zone.

    `dated` is False for times of day without a date. `note` is a sentence about what stays open, or "".
    """

    micros: list[int | None]
    how: str
    zoned: bool
    dated: bool = True
    note: str = ""


@dataclass(frozen=True, slots=True)
class _DateParts:
    """Date as three numbers in the order of the cell, and the time after midnight UTC in microseconds."""

    numbers: tuple[int, int, int] | None
    fixed: tuple[int, int, int] | None
    micros: int
    sep: str
    zoned: bool
    lengths: tuple[int, int] = (2, 4)


def read_stamps(cells: Sequence[str | None], order: Order | None = None) -> Stamps:
    """Return the moments of text `cells`, None for missing ones; `order` is that of day, month and year, if given.

    Raises
    ------
    TimeTextError
        More than one order fits and the times between rows differ, or a clock of twelve hours lacks AM and PM.
    """
    stamps = _read_stamps(cells, order)
    _require_full_clock(cells, stamps.micros)
    return _with_zones_in_all(cells, stamps) if stamps.zoned else stamps


def _with_zones_in_all(cells: Sequence[str | None], stamps: Stamps) -> Stamps:
    """Return stamps with a note on those without a zone; raise TimeTextError where the others are not in UTC."""
    dated = [cell for cell, x in zip(cells, stamps.micros, strict=True) if cell is not None and x is not None]
    zones = {cell: _ZONE_BEHIND.search(cell) for cell in dict.fromkeys(dated)}
    without = [cell for cell in dated if zones[cell] is None]
    other = next((cell for cell, zone in zones.items() if zone and minutes_of(zone[1])), None)
    if not without or len(without) == len(dated):
        return stamps
    if other is not None:
        raise TimeTextError(f"'{other}' has a time zone and '{without[0]}' has none; write the zone in all times")
    return replace(stamps, note=f"{len(without)} times without a zone are taken as UTC like the others")


def _read_stamps(cells: Sequence[str | None], order: Order | None) -> Stamps:
    plain = _of_each(_iso, cells)
    there = sum(cell is not None for cell in cells)
    if order is None and there and sum(x is not None for x in plain) == there:
        return Stamps(plain, "ISO 8601", any(_has_zone(cell) for cell in set(cells) if cell))
    parts = _of_each(_parts, cells)
    if sum(part is not None for part in parts) < sum(x is not None for x in plain):
        return Stamps(plain, "ISO 8601", any(_has_zone(cell) for cell in set(cells) if cell))
    zoned = any(part.zoned for part in parts if part is not None)
    open_parts = [part for part in parts if part is not None and part.numbers is not None]
    if not open_parts:
        return Stamps([_moment(part, "ymd") for part in parts], "a date", zoned)
    found = _orders(open_parts) if order is None else [order]
    read = {one: [_moment(part, one) for part in parts] for one in found}
    most = max((sum(x is not None for x in micros) for micros in read.values()), default=0)
    read = {one: m for one, m in read.items() if most and sum(x is not None for x in m) == most}
    if not read:
        return Stamps([None] * len(cells), "", zoned)
    kept, note = _decided(read, cells)
    how = WORDS[kept] if open_parts[0].sep == "." else WORDS[kept].replace(".", "/")
    return Stamps(read[kept], how, zoned, note=note)


def _of_each(read: Callable[[str], Read | None], cells: Sequence[str | None]) -> list[Read | None]:
    """Return what is read of each cell, each different text once: long tables repeat a time for each tag."""
    found: dict[str | None, Read | None] = {cell: read(cell) for cell in set(cells) if cell is not None}
    return [found.get(cell) for cell in cells]


def read_times_of_day(cells: Sequence[str | None]) -> Stamps | None:
    """Return times of day as microseconds since the first midnight, a day more after each step back by half a day.

    None where the cells are no times of day. Hours above 23 are those of a time since the beginning.

    Raises
    ------
    TimeTextError
        Two numbers each, which may be hours and minutes or minutes and seconds; four, which may begin with days or end
        with hundredths; or a clock of twelve hours without AM and PM.
    """
    if (short := _minutes_and_seconds(cells)) is not None:
        return short
    if (four := _four_fields(cells)) is not None:
        return four
    found = [None if cell is None else _CLOCK.fullmatch(cell) for cell in cells]
    there = [match for match in found if match is not None]
    if not there or len(there) < sum(cell is not None for cell in cells) / 2:
        return None
    if all(match["second"] is None and match["half"] is None for match in there):
        raise TimeTextError(
            f"'{there[0][0]}' may be hours and minutes or minutes and seconds; write hh:mm:ss, or a date before it"
        )
    micros = [
        None if match is None else _micros_of_day(match) + int(match["days"] or 0) * MICROS_PER_DAY for match in found
    ]
    _require_full_clock(cells, micros)
    days = 0
    last: int | None = None
    out: list[int | None] = []
    for value in micros:
        if value is not None:
            days += last is not None and value < last - MICROS_PER_DAY // 2
            last = value
        out.append(None if value is None else value + days * MICROS_PER_DAY)
    how = "days, hours, minutes and seconds" if any(match["days"] for match in there) else "a time of day"
    return Stamps(out, how, False, dated=False)


def _minutes_and_seconds(cells: Sequence[str | None]) -> Stamps | None:
    """Return times of minutes and seconds with decimals, which run on beyond 59 minutes; None for any other cells.

    Raises TimeTextError where they do not: they may lack their hours.
    """
    found = [None if cell is None else _MINUTES.fullmatch(cell) for cell in cells]
    there = [match for match in found if match is not None]
    if len(there) <= sum(cell is not None for cell in cells) / 2:
        return None
    if all(int(match[1]) < 60 for match in there):
        raise TimeTextError(
            f"'{there[0][0]}' looks like minutes and seconds without their hours, as spreadsheets show a time; format "
            "the column as hh:mm:ss.000 or write seconds"
        )
    micros = [
        None if match is None else round((60 * int(match[1]) + float(match[2].replace(",", "."))) * 1e6)
        for match in found
    ]
    return Stamps(micros, "minutes and seconds", False, dated=False)


def _four_fields(cells: Sequence[str | None]) -> Stamps | None:
    """Return times of four fields with colons if they begin with days; None if they end with hundredths.

    Hours above 23 and hundredths above 59 decide, else equal steps between rows by one of the readings alone.
    """
    found = [match for cell in cells if cell is not None and (match := _FOUR.fullmatch(cell))]
    if not found or len(found) < sum(cell is not None for cell in cells):
        return None
    fields = np.array([[int(text) for text in match.groups()] for match in found])
    if fields[:, 1].max() > 23 or fields[:, 3].max() > 59:
        return None
    as_days = fields @ np.array([86400, 3600, 60, 1])
    even_days = len(np.unique(np.diff(as_days))) == 1
    even_clock = len(np.unique(np.diff(fields @ np.array([360000, 6000, 100, 1])))) == 1
    if even_clock and not even_days:
        return None
    if even_days == even_clock:
        raise TimeTextError(
            f"'{found[0][0]}' may be dd:hh:mm:ss or hh:mm:ss and hundredths; write seconds, or hh:mm:ss.00"
        )
    seconds = iter(as_days.tolist())
    micros = [None if cell is None else next(seconds) * 1_000_000 for cell in cells]
    return Stamps(micros, "days, hours, minutes and seconds", False, dated=False)


def _require_full_clock(cells: Sequence[str | None], micros: Sequence[int | None]) -> None:
    """Raise TimeTextError for text of a clock of twelve hours without AM and PM."""
    there = [(cell, x) for cell, x in zip(cells, micros, strict=True) if cell is not None and x is not None]
    different = {cell: _HOUR.search(cell) for cell, _ in there}
    if any(match is None or cell.rstrip(". ").lower().endswith("m") for cell, match in different.items()):
        return
    hours = {cell: int(match[1]) for cell, match in different.items() if match is not None}
    require_full_clock(
        np.array([x for _, x in there], dtype=np.int64),
        np.array([hours[cell] for cell, _ in there], dtype=np.int64),
        lambda row: there[row][0],
    )


def is_time_of_day(cell: str) -> bool:
    """Return True for a cell of hours and minutes without a date."""
    return _CLOCK.fullmatch(cell) is not None


def is_date(cell: str) -> bool:
    """Return True for a cell of a date without a time of day."""
    match = _STAMP.fullmatch(cell)
    return match is not None and match["hour"] is None and match["long"] is None


def is_moment(cell: str) -> bool:
    """Return True for a cell of a date, with or without a time of day."""
    return _STAMP.fullmatch(cell) is not None or _iso(cell) is not None


def _iso(cell: str | None) -> int | None:
    if cell is None or not cell[:4].isdigit() or not cell.isascii():
        return None
    try:
        moment = datetime.datetime.fromisoformat(cell)
    except ValueError:
        return None
    return (moment.replace(tzinfo=moment.tzinfo or datetime.UTC) - _EPOCH) // _MICRO


def _has_zone(cell: str) -> bool:
    return "Z" in cell or "+" in cell or cell.count("-") > 2


def _parts(cell: str) -> _DateParts | None:
    match = _STAMP.fullmatch(cell)
    if match is None:
        return None
    if match["long"]:
        clock = match["clock"]
        seconds = int(clock[:2]) * 3600 + int(clock[2:4]) * 60 + int(clock[4:])
        return _DateParts(None, _whole(match["long"]), seconds * 1_000_000, "", False)
    if match["hour"] and int(match["hour"]) > 24:
        return None
    micros = _micros_of_day(match) if match["hour"] else 0
    zoned = bool(match["zone"])
    if match["compact"]:
        return _DateParts(None, _whole(match["compact"]), micros, "", zoned)
    if match["a"]:
        a, b, c = match["a"], match["b"], match["c"]
        return _DateParts((int(a), int(b), int(c)), None, micros, match["sep"], zoned, (len(a), len(c)))
    name = (match["month"] or match["month2"])[:3].lower()
    if name not in _MONTHS:
        return None
    year = int(match["year"] or match["year2"])
    return _DateParts(None, (_full(year), _MONTHS[name], int(match["day"] or match["day2"])), micros, "", zoned)


def _whole(text: str) -> tuple[int, int, int]:
    return int(text[:4]), int(text[4:6]), int(text[6:8])


def _micros_of_day(match: re.Match[str]) -> int:
    hour = int(match["hour"])
    if match["half"]:
        hour = hour % 12 + (12 if match["half"] in "Pp" else 0)
    fraction = int((match["fraction"] or "0").ljust(9, "0")) // 1000
    seconds = hour * 3600 + int(match["minute"]) * 60 + int(match["second"] or 0)
    ahead = minutes_of(match["zone"]) if match["zone"] else 0
    return (seconds - 60 * ahead) * 1_000_000 + fraction


def _full(year: int) -> int:
    """Return a year of four digits; two are of this century up to 69, as POSIX strptime reads them."""
    return year if year > 99 else year + (2000 if year < 69 else 1900)


def _orders(parts: Sequence[_DateParts]) -> list[Order]:
    """Return the possible orders of day, month and year."""
    first = parts[0]
    if first.lengths[0] == 4:
        return ["ymd"]
    if first.lengths[1] == 4:
        return ["dmy"] if first.sep == "." else ["dmy", "mdy"]
    return ["dmy"] if first.sep == "." else ["dmy", "mdy", "ymd"]


def _moment(part: _DateParts | None, order: Order) -> int | None:
    if part is None:
        return None
    if part.fixed is not None:
        year, month, day = part.fixed
    else:
        assert part.numbers is not None
        year, month, day = (part.numbers[order.index(which)] for which in "ymd")
    try:
        date = datetime.datetime(_full(year), month, day, tzinfo=datetime.UTC)
    except ValueError:
        return None
    return (date - _EPOCH) // _MICRO + part.micros


def _decided(read: dict[Order, list[int | None]], cells: Sequence[str | None]) -> tuple[Order, str]:
    """Return the order to read by, and a note on the rest; raise TimeTextError if the times between rows differ."""
    orders = list(read)
    if len(orders) == 1:
        return orders[0], ""
    elapsed = {one: np.array([x for x in read[one] if x is not None], dtype=np.int64) for one in orders}
    first = next(cell for cell, x in zip(cells, read[orders[0]], strict=True) if x is not None)
    if all(np.array_equal(np.diff(elapsed[one]), np.diff(elapsed[orders[0]])) for one in orders[1:]):
        said = " or ".join(WORDS[one] for one in orders)
        return orders[0], f"'{first}' may be {said}: only the date of the record depends on it (--dates settles it)"
    goes_on = [one for one in orders if _goes_on(elapsed[one])]
    if len(goes_on) == 1:
        return goes_on[0], ""
    options = ", ".join(f"--dates {one}" for one in orders)
    raise TimeTextError(f"'{first}' may be {' or '.join(WORDS[one] for one in orders)}; give one of {options}")


def _goes_on(micros: NDArray[np.int64]) -> bool:
    """Return True if no step is a day or longer and none goes back: a clock that went on over midnight."""
    steps = np.diff(micros)
    return bool(len(steps)) and bool((steps >= 0).all()) and int(steps.max()) < MICROS_PER_DAY
