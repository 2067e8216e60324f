"""Time zones as written in cells and in names of times, in one table."""

from __future__ import annotations

import datetime
import re
import zoneinfo

_EUROPE = "z=0 utc=0 gmt=0 ut=0 wet=0 west=60 cet=60 cest=120 mez=60 mesz=120 eet=120 eest=180 oez=120 oesz=180 msk=180"
_FURTHER = "jst=540 kst=540 hkt=480 sast=120 est=-300 edt=-240 cdt=-300 mst=-420 mdt=-360 pst=-480 pdt=-420 akst=-540"
_SOUTH = "akdt=-480 hst=-600 brt=-180 awst=480 acst=570 acdt=630 aest=600 aedt=660 nzst=720 nzdt=780"
ABBREVIATIONS = {
    name: int(ahead) for name, ahead in (pair.split("=") for pair in f"{_EUROPE} {_FURTHER} {_SOUTH}".split())
}
"""Minutes ahead of UTC; American ones are those of RFC 5322, 4.3. CST, IST and BST have several meanings each."""
_OFFSET = r"[+-]\d{1,2}(?::?\d{2})?"
CELL = rf"(?:UTC|GMT){_OFFSET}|" + "|".join(sorted(ABBREVIATIONS, key=len, reverse=True)) + r"|[+-]\d{2}(?::?\d{2})?"
"""Pattern of a zone behind a time, for letters of any case."""
_IN_NAME = re.compile(
    rf"(?<![A-Za-z])(?:(?P<base>UTC|GMT)\s*(?P<after>{_OFFSET})?|(?P<short>{'|'.join(ABBREVIATIONS)})|(?P<bare>[+-]\d{{2}}(?::?\d{{2}})?)"
    r"(?=\s*(?:[)\]]|$)))(?![A-Za-z0-9])",
    re.IGNORECASE,
)
_REGION = re.compile(r"\b([A-Z][A-Za-z_]+(?:/[A-Z][A-Za-z_-]+){1,2})\b")


def minutes_of(zone: str) -> int:
    """Return minutes ahead of UTC of a zone as a cell has it: `CET`, `UTC+1`, `+05:30`."""
    bare = re.sub(r"^(?:utc|gmt)(?=[+-])", "", zone.strip().lower())
    return ABBREVIATIONS[bare] if bare in ABBREVIATIONS else _minutes(bare)


def zone_of(name: str) -> tuple[str, float | zoneinfo.ZoneInfo] | None:
    """Return the time zone in a name of times and its seconds ahead of UTC, or a region of the IANA database.

    `Date Time, GMT+01:00`, `Zeit [MEZ]`, `Timestamp_CEST` and `Time (Europe/Berlin)` have one; None for any other.
    """
    if (region := _REGION.search(name)) is not None:
        try:
            return region[1], zoneinfo.ZoneInfo(region[1])
        except (zoneinfo.ZoneInfoNotFoundError, ValueError, OSError):
            pass
    found = _IN_NAME.search(name.replace("_", " "))
    if found is None or found[0].strip().lower() == "z":
        return None
    if found["short"]:
        return found[0], ABBREVIATIONS[found["short"].lower()] * 60.0
    offset = found["after"] or found["bare"]
    return found[0].strip(), 60.0 * (_minutes(offset) if offset else 0)


def without_zone(name: str) -> str:
    """Return a name of times without its zone in brackets or behind it."""
    zone = zone_of(name)
    if zone is None:
        return name
    left = name.replace("_", " ").replace(zone[0].replace("_", " "), "")
    return re.sub(r"[\[(]\s*[\])]", "", left).strip(" ,_-")


def moment_in(zone: float | zoneinfo.ZoneInfo, local: datetime.datetime) -> datetime.datetime:
    """Return the UTC time of a local time that carries the zone UTC by mistake."""
    if isinstance(zone, zoneinfo.ZoneInfo):
        return local.replace(tzinfo=zone).astimezone(datetime.UTC)
    return local - datetime.timedelta(seconds=zone)


def _minutes(offset: str) -> int:
    digits = offset[1:].replace(":", "")
    digits = digits.zfill(2).ljust(4, "0") if len(digits) < 3 else digits.zfill(4)
    return (-1 if offset[0] == "-" else 1) * (int(digits[:2]) * 60 + int(digits[2:]))
