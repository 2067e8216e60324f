"""Load profiles: breakpoints of named set-points over time.

A profile is a CSV file with the columns `time_s`, `heater_power_W`, `pump_speed_pct`, ...: the set-point's name and
its unit as suffix. Each row holds until the next one (zero-order hold); the time of the last row is the end. Lines
starting with `#` may stand above the header.
"""

from __future__ import annotations

import bisect
import csv
import difflib
import hashlib
import math
import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.signals import SUFFIX_OF_UNIT, column_name, split_column
from hil.files import replacing, require_size, safe_file_name

MAX_LINE = 2000
"""Longest line in characters; a longer one is no table of set-points."""

WINDOW_S = 600.0
"""Length in s of the calibration windows of twins; a shorter run would end before the first."""

EARLY_S = 1e-6
"""Lead time in s at which a breakpoint counts as reached: `tick * period` may round to just below it."""
LONGEST_S = 10.0 * 366.0 * 86400.0
"""Latest time in a profile, s: no rig runs for longer than ten years in one go."""

WRITTEN_UNITS = {
    "w": "W",
    "watt": "W",
    "watts": "W",
    "kw": "kW",
    "%": "%",
    "percent": "%",
    "perc": "%",
    "pc": "%",
    "degc": "degC",
    "°c": "degC",
    "c": "degC",
    "celsius": "degC",
    "k": "K",
    "lpm": "L/min",
    "hz": "Hz",
    "pa": "Pa",
    "kpa": "kPa",
    "sec": "s",
}
"""Unit suffixes as users write them, lower case, and the unit that they mean."""
_NUMBER = re.compile(r"[-+]?\d[\d.eE+-]*", re.ASCII)
_USUAL_UNITS = {"power": "W", "speed": "%", "flow": "L/min"}


class ProfileError(ValueError):
    """Error in reading or checking a profile; one sentence in each line, with the file and the remedy."""


@dataclass(frozen=True, eq=False)
class Profile:
    """Breakpoints: at `time_s[i]` the set-points `columns` become `values[i]` and hold until `time_s[i + 1]`.

    `time_s (n,)` in s starts at 0 and increases strictly, n >= 2; `values (n, k)` in the unit of each column's
    suffix. `lines (n,)` are the rows' lines in the file at `path`, empty where the profile was built in memory;
    `notes` is what reading had to put up with.
    """

    name: str
    time_s: NDArray[np.float64]
    columns: tuple[str, ...]
    values: NDArray[np.float64]
    path: Path | None = None
    sha256: str = ""
    lines: tuple[int, ...] = ()
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n, k = len(self.time_s), len(self.columns)
        if n < 2 or k < 1 or self.values.shape != (n, k):
            raise ProfileError(f"{self.name}: {n} times and {k} columns do not fit values of shape {self.values.shape}")
        if self.time_s[0] != 0 or not (np.diff(self.time_s) > 0).all() or not np.isfinite(self.values).all():
            raise ProfileError(f"{self.name}: times must rise from 0 and every value must be a number")

    @property
    def duration_s(self) -> float:
        """Return the end of the profile, s."""
        return float(self.time_s[-1])

    def at(self, t: float) -> tuple[float, ...]:
        """Return the set-points at `t` seconds, k values in the order of `columns`; the first and last rows hold
        outside.
        """
        times, rows = self._table
        return rows[max(bisect.bisect_right(times, t + EARLY_S) - 1, 0)]

    def sample(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the set-points at `times (n,)` in s, shape (n, k)."""
        row = np.searchsorted(self.time_s, np.asarray(times) + EARLY_S, side="right") - 1
        return self.values[np.maximum(row, 0)]

    def place(self, row: int) -> str:
        """Return the place of `row` for a message: its line, or its time if there is no file."""
        return f"line {self.lines[row]}" if self.lines else f"{self.time_s[row]:g} s"

    @cached_property
    def _table(self) -> tuple[list[float], list[tuple[float, ...]]]:
        return self.time_s.tolist(), [tuple(row) for row in self.values.tolist()]


@dataclass(frozen=True, slots=True)
class SetpointLimit:
    """Limits of one set-point on the rig: values in [`low`, `high`] `unit`, at most `max_rate_per_s` unit/s.

    `setpoint` is the column of the set-point itself; profiles name the one of its readback where it has one.
    """

    low: float
    high: float
    max_rate_per_s: float | None
    unit: str
    setpoint: str = ""


def read_profile(path: Path, unitless: Collection[str] = ()) -> Profile:
    """Read the profile in the CSV file at `path`; `unitless` are set-points of the rig that need no unit suffix.

    Raises ProfileError with one sentence that names the file, the line and the remedy.
    """
    try:
        require_size(path, ProfileError)
        content = path.read_bytes()
    except OSError as error:
        raise ProfileError(f"{path} cannot be read ({error.strerror}); give the path of a profile CSV") from error
    if path.suffix == ".toml":
        raise ProfileError(
            f"{path} is no load profile; give a CSV, a rig file with --rig, and build a scenario with hil profile build"
        )
    text, notes = _text(path, content)
    columns: tuple[str, ...] = ()
    times: list[float] = []
    rows: list[list[float]] = []
    lines: list[int] = []
    for line, raw in enumerate(text.splitlines(), start=1):
        if not raw.strip():
            continue
        if len(raw) > MAX_LINE:
            raise ProfileError(f"{path} line {line} is {len(raw)} characters long; this is not a table of set-points")
        if raw.startswith("#"):
            if columns:
                raise ProfileError(f"{path} line {line} is a comment between rows; move it above the header")
            continue
        if not columns:
            columns = _header(f"{path} line {line}", raw, unitless)
            continue
        time_s, *values = _row(f"{path} line {line}", raw, columns)
        if not times and time_s != 0:
            raise ProfileError(f"{path} line {line} starts at {time_s:g} s; the first row must be at time_s 0")
        if time_s > LONGEST_S:
            raise ProfileError(
                f"{path} line {line} is at {time_s:g} s, more than ten years after the start; correct the time"
            )
        if times and time_s <= times[-1]:
            raise ProfileError(
                f"{path} line {line} is at {time_s:g} s, not after {times[-1]:g} s of line {lines[-1]}; "
                "times must increase, so sort the rows and give each its own time"
            )
        times.append(time_s)
        rows.append(values)
        lines.append(line)
    if not columns:
        raise ProfileError(f"{path} is empty; write a header such as time_s,heater_power_W and at least two rows")
    if len(times) < 2:
        raise ProfileError(
            f"{path} has {len(times)} rows under its header; write at least two, the last one's time is the end"
        )
    digest = hashlib.sha256(content).hexdigest()
    if not text.endswith(("\n", "\r")):
        notes = (*notes, *_doubt_of_end(path, lines[-1], [row[-1] for row in rows]))
    values_array = np.array(rows, dtype=np.float64)
    return Profile(
        safe_file_name(path.stem), np.array(times), columns[1:], values_array, path, digest, tuple(lines), notes
    )


def _doubt_of_end(path: Path, line: int, last_column: list[float]) -> tuple[str, ...]:
    """Return a note on a last number with fewer digits before its point than all others of its column.

    The caller has seen that no line end follows it: the file may have been cut off inside of it.
    """
    *others, last = (len(f"{abs(value):.0f}") for value in last_column)
    if last >= min(others):
        return ()
    return (
        f"{path} line {line} ends in {last_column[-1]:g}, with fewer digits than the numbers above and no line end: is "
        "the file cut off there? End the line to say that it is complete",
    )


def write_profile(profile: Profile, path: Path, comments: Iterable[str] = ()) -> None:
    """Write `profile` to `path`, atomically; every number reads back exactly."""
    lines = [f"# {comment}" for comment in comments]
    lines.append(",".join(("time_s", *profile.columns)))
    for time_s, row in zip(profile.time_s.tolist(), profile.values.tolist(), strict=True):
        lines.append(",".join(_number_text(number) for number in (time_s, *row)))
    with replacing(path) as unfinished:
        unfinished.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def _number_text(number: float) -> str:
    return repr(number).removesuffix(".0")


def _text(path: Path, content: bytes) -> tuple[str, tuple[str, ...]]:
    notes = []
    if content.startswith((b"\xff\xfe", b"\xfe\xff")) or b"\0" in content:
        raise ProfileError(f"{path} line 1 is not plain text (UTF-16 or binary); save it as CSV in UTF-8")
    if content.startswith(b"\xef\xbb\xbf"):
        content = content[3:]
        notes.append(f"{path} starts with a byte-order mark, which was skipped")
    if b"\r" in content:
        notes.append(f"{path} has Windows line ends (CRLF), which read the same")
    try:
        return content.decode("utf-8"), tuple(notes)
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise ProfileError(f"{path} line {line} holds a character that is not UTF-8; save the file as UTF-8") from error


def _fields(place: str, raw: str) -> list[str]:
    try:
        return [field.strip() for field in next(csv.reader([raw], strict=True))]
    except csv.Error as error:
        raise ProfileError(f"{place} has an unfinished quote ({error}); numbers need no quotes") from error


def _header(place: str, raw: str, unitless: Collection[str]) -> tuple[str, ...]:
    for separator, word in ((";", "semicolons"), ("\t", "tabs")):
        if separator in raw:
            raise ProfileError(
                f"{place} separates columns by {word}; save the file with commas between columns and decimal points"
            )
    columns = tuple(_fields(place, raw))
    if columns[0] != "time_s":
        if all(_NUMBER.fullmatch(column) for column in columns):
            raise ProfileError(
                f"{place} holds numbers where column names should stand; add a header such as time_s,heater_power_W"
            )
        what = "in seconds from the beginning; records are for hil check, track and diagnose"
        raise ProfileError(f"{place} begins with column '{columns[0]}'; the first column must be time_s, {what}")
    if len(columns) < 2:
        raise ProfileError(f"{place} names no set-point; add a column such as heater_power_W")
    for index, column in enumerate(columns[1:], start=1):
        if not column:
            raise ProfileError(f"{place} leaves column {index + 1} without a name; name it or delete the column")
        if column in columns[:index]:
            raise ProfileError(f"{place} names column '{column}' twice; keep one of them")
        if split_column(column) is None and column not in unitless:
            raise ProfileError(f"{place}: {_suffix_problem(column)}")
    return columns


def _suffix_problem(column: str) -> str:
    stem, _, tail = column.rpartition("_")
    if stem and (unit := WRITTEN_UNITS.get(tail.lower())):
        return f"column '{column}' ends in '_{tail}', which is no unit suffix; did you mean {column_name(stem, unit)}?"
    known = ", ".join("_" + suffix for suffix in SUFFIX_OF_UNIT.values() if suffix)
    if unit := _USUAL_UNITS.get(tail):
        return f"column '{column}' has no unit suffix; write {column_name(column, unit)} (known suffixes: {known})"
    if not stem or tail.islower():
        return f"column '{column}' has no unit suffix; add one of {known}"
    return f"column '{column}' ends in '_{tail}', which is no known unit suffix; use one of {known}"


def _row(place: str, raw: str, columns: tuple[str, ...]) -> list[float]:
    fields = _fields(place, raw)
    if len(fields) > len(columns):
        raise ProfileError(
            f"{place} has {len(fields)} fields where the header has {len(columns)}; write one number a column, "
            "with a decimal point where this is a decimal comma"
        )
    fields += [""] * (len(columns) - len(fields))
    numbers = []
    for column, field in zip(columns, fields, strict=True):
        if not field:
            raise ProfileError(f"{place} leaves {column} blank; write the value that holds from here on")
        try:
            number = float(field.replace("_", "x"))
        except ValueError:
            remedy = _remedy_of_number(field)
            raise ProfileError(f"{place} has {field!r} for {column}, which is not a number; {remedy}") from None
        if not math.isfinite(number):
            raise ProfileError(f"{place} has {field} for {column}; write the value that holds from here on")
        numbers.append(number)
    return numbers


def _remedy_of_number(field: str) -> str:
    """Return the remedy for a cell that is no number. `1,000` may be a thousand or one: neither is suggested alone."""
    if re.fullmatch(r"[-+]?[1-9]\d{0,2}(?:[,.' \u00a0\u202f]\d{3})+", field):
        thousand = re.sub(r"[^\d+-]", "", field)
        fraction = f", or {field.replace(',', '.')} for the fraction" if field.count(",") == 1 else ""
        return f"write {thousand} for the thousands{fraction}"
    return "use a decimal point instead of the comma" if "," in field else "write a plain number"


def validate(
    profile: Profile, limits: Mapping[str, SetpointLimit], *, min_duration_s: float = WINDOW_S, period_s: float
) -> list[str]:
    """Check `profile` before anything moves, against the rig's set-points `limits` (by column) and its tick.

    `min_duration_s` is the calibration window of the twins that are to run; 0 where none does.

    Returns notes for the operator. Raises one ProfileError with a sentence for every problem, a line each.
    """
    source = profile.path or profile.name
    problems: list[str] = []
    notes = list(profile.notes)
    if profile.duration_s < min_duration_s:
        problems.append(
            f"{source} lasts {profile.duration_s:g} s, less than one calibration window of {min_duration_s:g} s; "
            "extend its last row, repeat it, or run it without a twin (hil run --no-twin)"
        )
    problems += _rows_between_ticks(profile, source, period_s)
    if (profile.values[-1] != profile.values[-2]).any():
        notes.append(f"{profile.place(len(profile.time_s) - 1)} is the end of {source}: its new values are not reached")
    units_of = {(split_column(column) or (column, "1"))[0]: column for column in limits}
    meant: set[str] = set()
    for index, column in enumerate(profile.columns):
        if column in limits:
            _check_column(profile, source, index, limits[column], period_s, problems, notes)
            continue
        name, unit = split_column(column) or (column, "1")
        if name in units_of:
            meant.add(units_of[name])
            problems.append(
                f"{source} gives {name} in {unit} but the rig takes {limits[units_of[name]].unit}; "
                f"convert the column to {units_of[name]}"
            )
            continue
        own = next((known for known, limit in limits.items() if column == limit.setpoint != known), None)
        if own is not None:
            meant.add(own)
            problems.append(f"{source} names the set-point '{column}' itself; call the column {own}, its readback")
            continue
        # Another actuator is never meant, however near its name.
        alike = [known for known in limits if difflib.get_close_matches(_actuator(column), [_actuator(known)])]
        near = difflib.get_close_matches(column, alike, n=1, cutoff=0.5)
        meant.update(near)
        remedy = f"did you mean {near[0]}?" if near else f"the rig takes {', '.join(limits) or 'none'}"
        problems.append(f"{source} moves '{column}', which is no set-point of this rig; {remedy}")
    for column in limits:
        if column in profile.columns or column in meant:
            continue
        if (split_column(column) or ("",))[0] == "heater_power":
            problems.append(f"{source} has no column {column}; add it, a load profile must set the heat load")
        else:
            notes.append(f"{column} is not in {source}: it stays at its start value")
    if problems:
        raise ProfileError("\n".join(problems))
    return notes


def _actuator(column: str) -> str:
    """Return the first word of a column: what it moves."""
    return column.partition("_")[0]


def _rows_between_ticks(profile: Profile, source: Path | str, period_s: float) -> list[str]:
    first_tick = np.ceil((profile.time_s - EARLY_S) / period_s)
    lost = np.flatnonzero(np.diff(first_tick) == 0)
    if not len(lost):
        return []
    more = f" (and {len(lost) - 1} more)" if len(lost) > 1 else ""
    return [
        f"{source} {profile.place(int(lost[0]))}{more} is replaced before the next tick of {period_s:g} s; "
        "hold each row for at least one tick"
    ]


def _check_column(
    profile: Profile,
    source: Path | str,
    index: int,
    limit: SetpointLimit,
    period_s: float,
    problems: list[str],
    notes: list[str],
) -> None:
    column, values = profile.columns[index], profile.values[:, index]
    if limit.unit == "%" and limit.high > 1.0 and values.min() >= 0.0 and 0.0 < values.max() <= 1.0:
        problems.append(
            f"{source} {profile.place(int(np.argmax(values)))} sets {column} to at most {values.max():g} %: is it a "
            "fraction of 1? Write 80 for 80 %, or lower its limit in the rig file to 1 % if so little is meant"
        )
        return
    for outside, word, bound in (
        (values < limit.low, "below the lower limit", limit.low),
        (values > limit.high, "above the upper limit", limit.high),
    ):
        if outside.any():
            row = int(np.argmax(outside))
            more = f" (and {outside.sum() - 1} more rows)" if outside.sum() > 1 else ""
            problems.append(
                f"{source} {profile.place(row)}{more} sets {column} to {values[row]:g} {limit.unit}, "
                f"{word} {bound:g} {limit.unit}; change the value or the rig file's limit"
            )
    if limit.max_rate_per_s is None:
        return
    change = np.flatnonzero(np.diff(values[:-1])) + 1
    needed_s = np.abs(values[change] - values[change - 1]) / limit.max_rate_per_s
    held_s = np.diff(profile.time_s[np.append(change, len(values) - 1)])
    too_steep = np.flatnonzero(needed_s > held_s + EARLY_S)
    for step in too_steep:
        row = int(change[step])
        problems.append(
            f"{source} {profile.place(row)} moves {column} from {values[row - 1]:g} to {values[row]:g} {limit.unit}, "
            f"which takes {needed_s[step]:.4g} s at {limit.max_rate_per_s:g} {limit.unit}/s but is held for only "
            f"{held_s[step]:g} s; hold it longer or take a smaller step"
        )
    slow = needed_s > period_s
    if slow.any() and not len(too_steep):
        longest = int(np.argmax(needed_s))
        ramps = "1 step is a ramp" if slow.sum() == 1 else f"{slow.sum()} steps are ramps"
        notes.append(
            f"{column}: {ramps} at {limit.max_rate_per_s:g} {limit.unit}/s, the longest "
            f"{needed_s[longest]:.4g} s at {profile.place(int(change[longest]))}"
        )
