"""Files that describe a station: tag dictionary, datasheet and events."""

from __future__ import annotations

import difflib
import math
import zoneinfo
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hil.record import RecordError
from hil.tower.station.errors import Mistakes
from hil.tower.station.input_files import read_datasheet, read_rows
from hil.tower.station.times import iso, seconds
from twin.historian import (
    INFLUENCE,
    OF_CELL,
    OF_STATION,
    SPEEDS,
    Event,
    Ratings,
    Tag,
    UnitError,
    full_speed_of,
    influence_of,
    unit_of,
)
from twin.tower import SEA_LEVEL_KPA

REQUIRED = ("tag", "unit", "role")
DEFAULT_SPEED = "60 Hz"
"""Speed of a fan at 100 % where the datasheet does not give it."""


@dataclass(frozen=True)
class Station:
    """Description of a station: tags by name, datasheet as in its file, events in the order of time, and remarks."""

    tags: dict[str, Tag]
    datasheet: dict[str, Any] = field(default_factory=dict)
    events: tuple[Event, ...] = ()
    remarks: tuple[str, ...] = ()
    places: dict[str, str] = field(default_factory=dict)
    """File and line of each tag in the dictionary."""

    @property
    def timezone(self) -> str | None:
        """Time zone of the site, IANA."""
        found = self.datasheet.get("timezone")
        return str(found) if found else None

    @property
    def cells(self) -> tuple[int, ...]:
        """Cells with an outlet thermometer, in order: those that a record can be made of."""
        return tuple(
            sorted({t.cell for t in self.tags.values() if t.cell is not None and t.role == "water_outlet_temperature"})
        )

    @property
    def pressure_kPa(self) -> float:
        """Pressure of the site by its datasheet; of sea level where it is not given."""
        return float(self.datasheet.get("design", {}).get("pressure_kPa", SEA_LEVEL_KPA))

    @property
    def ratings(self) -> Ratings:
        """Ratings of the datasheet against which tags are held."""
        design, fan = (_numbers(self.datasheet.get(name)) for name in ("design", "fan"))
        cells = self.datasheet.get("cells_in_station")
        return Ratings(
            design.get("water_flow_kg_s"),
            design.get("pressure_kPa"),
            fan.get("power_at_design_kW"),
            fan.get("rated_power_kW"),
            self.full_speed,
            cells if isinstance(cells, int) and cells > 0 else None,
        )

    @property
    def full_speed(self) -> str:
        """Speed of a fan at 100 %, with its unit, such as `60 Hz`."""
        return str(self.datasheet.get("fan", {}).get("speed_100pct", DEFAULT_SPEED))


def _numbers(section: object) -> dict[str, float]:
    """Return the positive numbers of a section of the datasheet."""
    if not isinstance(section, dict):
        return {}
    return {name: float(value) for name, value in section.items() if isinstance(value, int | float) and value > 0}


def read_station(tags: Path, datasheet: Path | None = None, events: Path | None = None) -> Station:
    """Return the station of these files.

    Raises
    ------
    RecordError
        A file cannot be read, lacks a column, or a line of it has an unknown unit, role or time; the message names
        file, line, tag and remedy.
    """
    dictionary, remarks, places = _tags(tags)
    sheet = checked_datasheet(datasheet) if datasheet is not None else {}
    _refuse_other_speeds(tags, dictionary, sheet, places, datasheet)
    happened = read_events(events) if events is not None else ()
    if events is not None:
        remarks += _doubtful_events(events, happened, {tag.cell for tag in dictionary.values()})
    return Station(dictionary, sheet, happened, tuple(remarks), places)


def _doubtful_events(path: Path, events: tuple[Event, ...], cells: set[int | None]) -> list[str]:
    """Return a sentence for each event of a cell without a tag, and for each class that moves no parameter."""
    remarks = []
    for event in events:
        day = iso(event.time_s)[:10]
        if event.cell and event.cell not in cells:
            remarks.append(
                f"{path.name}: {event.kind} of {day} is of cell {event.cell}, which has no tag in the dictionary; it "
                f"changes nothing: give the number of its cell, or 0 for the station"
            )
    for kind in sorted({event.kind for event in events if event.kind not in INFLUENCE}):
        if not any(influence_of(kind, event.text).parameters for event in events if event.kind == kind):
            remarks.append(
                f"{path.name}: class {kind!r} is not known, and its words name no part; it lets no parameter jump: "
                f"use one of {', '.join(sorted(INFLUENCE))}"
            )
    return remarks


def _tags(path: Path) -> tuple[dict[str, Tag], list[str], dict[str, str]]:
    found: dict[str, Tag] = {}
    places: dict[str, str] = {}
    taken: dict[tuple[str, int | None], str] = {}
    names: set[str] = set()
    remarks = []
    mistakes = Mistakes(path)
    for line, row in read_rows(path, REQUIRED):
        name, role = row["tag"], row["role"]
        with mistakes.noted():
            if not name:
                raise RecordError(f"{path}:{line}: the tag has no name; give one or remove the line")
            if name in names:
                raise RecordError(f"{path}:{line}: {name} is there twice; remove one line")
        names.add(name)
        known = role in OF_CELL or role in OF_STATION
        with mistakes.noted():
            _refuse_unit(path, line, row, known)
        if not known:
            near = difflib.get_close_matches(role, (*OF_CELL, *OF_STATION), n=1, cutoff=0.8)
            hint = f"; is it {near[0]}? then mend it" if near else ""
            remarks.append(
                f"{path.name}:{line}: {name} has role {role!r}, which no column of the record takes; it is left "
                f"out{hint}"
            )
            continue
        with mistakes.noted():
            scan = _number(path, line, name, row.get("scan_s", "") or "60")
        with mistakes.noted():
            cell = _cell(path, line, name, row.get("cell", ""))
            if (role in OF_CELL) and cell is None:
                raise RecordError(f"{path}:{line}: {name} has role {role} and no cell; give the number of its cell")
            first = taken.setdefault((role, cell), name)
            if first != name:
                remarks.append(
                    f"{path.name}:{line}: {name} has role and cell of {first}, which is used; it is left out"
                )
                continue
            places[name] = f"{path.name}:{line}"
            if not mistakes:
                found[name] = Tag(name, row["unit"], role, cell, scan, row.get("description", ""))
    mistakes.refuse()
    if not found:
        raise RecordError(f"{path}: no tag has a role that is known; roles are {', '.join((*OF_CELL, *OF_STATION))}")
    return found, remarks, places


def _refuse_unit(path: Path, line: int, row: dict[str, str], known_role: bool) -> None:
    """Raise RecordError for an unknown unit, and for one of another dimension than its role's."""
    name, role = row["tag"], row["role"]
    wanted = (OF_CELL.get(role) or OF_STATION[role]).dimension if known_role else ""
    usable = (wanted, *SPEEDS) if role.startswith("fan_speed") else (wanted,)
    try:
        dimension = unit_of(row["unit"], usable if wanted else ()).dimension
    except UnitError as error:
        raise RecordError(f"{path}:{line}: {name}: {error}") from error
    if not known_role:
        return
    if dimension != wanted and not (wanted == "share" and dimension in (*SPEEDS, "state")):
        raise RecordError(f"{path}:{line}: {name} is in {row['unit']}, a unit of {dimension}; a {role} is a {wanted}")


def _cell(path: Path, line: int, name: str, text: str) -> int | None:
    if not text:
        return None
    try:
        number = float(text)
        cell = int(number)
    except (ValueError, OverflowError):
        number, cell = math.nan, 0
    if number != cell:
        raise RecordError(f"{path}:{line}: {name} has cell {text!r}; give a whole number, or nothing for the station")
    return cell if cell > 0 else None


def _number(path: Path, line: int, name: str, text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not 0.0 < seconds < math.inf:
        raise RecordError(f"{path}:{line}: {name} has scan_s {text!r}; give seconds as a number above 0")
    return max(seconds, 1.0)


def checked_datasheet(path: Path) -> dict[str, Any]:
    """Return the datasheet of a station whose zone, pressure and full speed are possible.

    Raises
    ------
    RecordError
        The file cannot be read, or one of them is not.
    """
    found = read_datasheet(path)
    mistakes = Mistakes(path)
    zone = found.get("timezone")
    with mistakes.noted():
        if zone is not None and zone not in zoneinfo.available_timezones():
            raise RecordError(f"{path}: {zone!r} is no time zone; give one of the IANA names, such as Europe/Madrid")
    design, fan = found.get("design"), found.get("fan")
    pressure = design.get("pressure_kPa") if isinstance(design, dict) else None
    column = OF_STATION["barometric_pressure"]
    with mistakes.noted():
        if isinstance(pressure, int | float) and not column.low <= pressure <= column.high:
            raise RecordError(
                f"{path}: design.pressure_kPa is {pressure:g}, which no site has; give it in kPa, {column.low:g} to "
                f"{column.high:g}"
            )
    speed = fan.get("speed_100pct") if isinstance(fan, dict) else None
    with mistakes.noted():
        try:
            full_speed_of(str(speed) if speed is not None else DEFAULT_SPEED)
        except UnitError as error:
            raise RecordError(f"{path}: fan.speed_100pct {error}") from error
    mistakes.refuse()
    return found


def _refuse_other_speeds(
    path: Path, tags: dict[str, Tag], sheet: dict[str, Any], places: dict[str, str], datasheet: Path | None
) -> None:
    """Raise RecordError for speeds in rpm where 100 % is given in Hz, or the other way round."""
    text = Station(tags, sheet).full_speed
    full = full_speed_of(text)[1]
    mistakes = Mistakes(path)
    for tag in tags.values():
        unit = unit_of(tag.unit)
        with mistakes.noted():
            if unit.dimension not in SPEEDS or unit.dimension == full.dimension:
                continue
            raise RecordError(
                f"{places[tag.name]}: {tag.name} is in {tag.unit}, but {datasheet or 'the default'} gives 100 % speed "
                f"as {text}; write fan.speed_100pct of the datasheet in {tag.unit}"
            )
    mistakes.refuse()


def read_events(path: Path) -> tuple[Event, ...]:
    """Return the events of a station in the order of time.

    Raises
    ------
    RecordError
        A column is missing, or a line has no time or cell that can be read.
    """
    found = []
    mistakes = Mistakes(path)
    for line, row in read_rows(path, ("time", "event")):
        text = row["time"]
        precision = row.get("precision", "").lower()
        with mistakes.noted():
            if precision not in ("", "minute", "day"):
                raise RecordError(f"{path}:{line}: precision is {row['precision']!r}; write minute or day, or nothing")
        with mistakes.noted():
            cell = _cell(path, line, row["event"], row.get("cell", ""))
        by_day = precision == "day" or len(text) <= 10
        with mistakes.noted():
            try:
                time_s = seconds(text)
            except ValueError:
                raise RecordError(
                    f"{path}:{line}: {text!r} is no time from 1970 on; write it as 2024-07-31T14:05:00Z or 2024-07-31"
                ) from None
            if not mistakes:
                found.append(Event(time_s, by_day, cell or 0, row["event"], row.get("source", ""), row.get("text", "")))
    mistakes.refuse()
    return tuple(sorted(found, key=lambda event: event.time_s))
