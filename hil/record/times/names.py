"""Names of time columns, with the unit if the name has one."""

from __future__ import annotations

import re

from hil.record.times.zones import without_zone

SECONDS_PER: dict[str, float] = {
    "ns": 1e-9,
    "us": 1e-6,
    "µs": 1e-6,
    "ms": 1e-3,
    "msec": 1e-3,
    "s": 1.0,
    "sec": 1.0,
    "secs": 1.0,
    "second": 1.0,
    "seconds": 1.0,
    "min": 60.0,
    "mins": 60.0,
    "minute": 60.0,
    "minutes": 60.0,
    "h": 3600.0,
    "hr": 3600.0,
    "hour": 3600.0,
    "hours": 3600.0,
    "d": 86400.0,
    "day": 86400.0,
    "days": 86400.0,
}
"""Seconds in a unit of time, by its symbol in lower case."""

_ELAPSED = (
    "time",
    "t",
    "elapsed",
    "elapsed time",
    "time elapsed",
    "run time",
    "rel time",
    "relative time",
    "x value",
    "x axis",
    "x-axis",
)
_MOMENT = (
    *("timestamp", "time stamp", "datetime", "date time", "date/time", "date and time", "date", "epoch", "when"),
    *("local time", "utc", "time utc", "utc time", "timestamp utc", "last changed", "last updated", "recorded at"),
    *("unix", "unix time", "unixtime", "unix timestamp", "unix epoch", "epoch time"),
    *("date&time", "date & time", "time string", "timestring", "sourcetimestamp", "source timestamp"),
    *("servertimestamp", "server timestamp"),
    *("modified julian date", "modified julian day", "mjd", "julian date", "julian day", "jd", "datenum"),
    *("datum", "zeit", "uhrzeit", "zeitstempel", "datum/zeit", "datum uhrzeit", "date heure", "heure", "horodatage"),
)
_FORMATS = {"hhmmss": "HHMMSS", "hhmm": "HHMM", "hh:mm:ss": "HHMMSS", "hh:mm": "HHMM"}
"""Forms of a clock's digits, by their spelling in lower case."""
_PAIRS = {"hh:mm": "hh:mm", "h:mm": "hh:mm", "mm:ss": "mm:ss", "m:ss": "mm:ss", "min:sec": "mm:ss", "min:s": "mm:ss"}
"""Forms of two numbers with a colon, by their spelling in lower case."""
_DATE_FORMATS = ("yyyymmdd", "ddmmyyyy", "mmddyyyy", "yymmdd", "ddmmyy", "mmddyy")
_UNIT = re.compile(r"(.+?)[ _]*[\[(]\s*([a-zµ]+)\s*[\])]|(.+?)\s*[/_ ]\s*(?:in\s+)?([a-zµ]+)|([a-zµ]+)")


def seconds_per_unit(name: str) -> float | None:
    """Return seconds per unit of the time column `name`, 1 if the name gives no unit; None if it names no time."""
    low = name.strip().lower()
    if format_of(name) is not None or pair_of(name) is not None or _date_format(low) is not None:
        return 1.0
    if _spelt(low) in (*_ELAPSED, *_MOMENT) or _spelt(without_zone(name).lower()) in (*_ELAPSED, *_MOMENT):
        return 1.0
    parts = _UNIT.fullmatch(low)
    if parts is None:
        return None
    stem, unit = (parts[1], parts[2]) if parts[1] else (parts[3], parts[4]) if parts[3] else ("", parts[5])
    if stem == "t" and not parts[1] and unit != "s":
        return None  # T_min and T_h are temperatures.
    alone = not stem and unit in ("seconds", "minutes", "hours")
    if unit in SECONDS_PER and (alone or _spelt(stem) in (*_ELAPSED, *_MOMENT)):
        return SECONDS_PER[unit]
    return None


def names_unit(name: str) -> bool:
    """Return True for the name of a time that gives its unit."""
    low = name.strip().lower()
    spelt = {_spelt(low), _spelt(without_zone(name).lower())}
    is_clock = format_of(name) is not None or pair_of(name) is not None or _date_format(low) is not None
    return seconds_per_unit(name) is not None and not is_clock and not spelt & {*_ELAPSED, *_MOMENT}


def is_time_name(name: str) -> bool:
    """Return True for a name under which a record may hold its time."""
    return seconds_per_unit(name) is not None


def names_dates(name: str) -> bool:
    """Return True for a name of dates, or of dates with times, and never of a time since the beginning."""
    spelt = {_spelt(name.strip().lower()), _spelt(without_zone(name).lower())}
    return bool(spelt & {*_MOMENT, "time of day"}) and "epoch" not in name.lower()


def names_days(name: str) -> bool:
    """Return True for a name of days, such as `Date` and `MJD`; whole numbers of a `timestamp` may be seconds."""
    low = name.strip().lower()
    named = re.search(r"date|datum|julian|\bm?jd\b", low) is not None or _date_format(low) is not None
    return is_time_name(name) and named


def format_of(name: str) -> str | None:
    """Return HHMMSS or HHMM for a name that says so, alone or behind the name of a time (`Time (HHMM)`); else None."""
    words = _spelt(name.strip().lower()).split(" ")
    stem = " ".join(words[:-1])
    return _FORMATS.get(words[-1]) if stem in ("", *_ELAPSED, *_MOMENT) else None


def pair_of(name: str) -> str | None:
    """Return hh:mm or mm:ss for a name of a time that says so (`Time [mm:ss]`); None for any other name."""
    words = _spelt(name.strip().lower()).split(" ")
    stem = " ".join(words[:-1])
    return _PAIRS.get(words[-1]) if stem in ("", *_ELAPSED, *_MOMENT) else None


def _date_format(low: str) -> str | None:
    """Return the form of a date's digits, such as yyyymmdd, that a name in lower case states; else None."""
    words = _spelt(low).split(" ")
    is_time = " ".join(words[:-1]) in ("", *_ELAPSED, *_MOMENT)
    return words[-1] if is_time and words[-1] in _DATE_FORMATS else None


def _spelt(low: str) -> str:
    return re.sub(r"[ _()\[\]]+", " ", low).strip()
