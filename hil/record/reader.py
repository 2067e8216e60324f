"""Records of a rig, one row for each sample, as Parquet or CSV.

The first column is `time_s`, the others are signals with the unit as suffix (`heater_power_W`, `T_tank_C`). Real
records have gaps, missing values, repeated and out-of-order stamps, irregular rates and extra columns:
`read_record` handles all of them and reports them in `Record.messages`.

`<column>_quality` gives the reason for missing values of a column (`signals.points.Quality`); `export_record` writes
such columns only for signals that were ever not good.
"""

from __future__ import annotations

import dataclasses
import datetime
import re
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.signals import Quality, column_name, split_column
from hil.files import replacing
from hil.journal import ExportedRecord, export_record
from hil.profile import WRITTEN_UNITS
from hil.record.clock_jumps import clock_questions, without_jumps, without_rollovers
from hil.record.file import read_raw
from hil.record.order import describe_steps, order, without_set_back
from hil.record.plausibility import SENTINELS, without_implausible
from hil.record.rated_columns import QUALITY, find_ratings
from hil.record.raw import RawRecord, ReadingOptions, RecordError
from hil.record.times import TimeAxis, is_time_name, numbered, read_time, span
from hil.record.units import without_cell_units
from hil.record.values import (
    LOST,
    DecimalSignError,
    Numbers,
    Sign,
    UnitQuestion,
    decimal_signs,
    is_difference,
    may_be_lost,
    of_a_room,
    parse,
    readings,
    remarks,
    standing_still,
    trimmed,
    unit_jumps,
)
from twin import column_hint

__all__ = [
    "SENTINELS",
    "ExportedRecord",
    "ReadingOptions",
    "Record",
    "RecordError",
    "export_record",
    "read_record",
    "write_record",
]

HOTTEST_ROOM_C = 45.0
"""Median of a room temperature above which a question is reported."""
COLDEST_C = -100.0
"""Median of a column converted from kelvin below which a question is reported."""

LIQUID_K = (233.0, 423.0)
"""Kelvin of -40 to 150 degC: a record in degC that lies within this range throughout gets a question."""

COMMAS, THOUSANDS = "decimal commas read as points", "numbers with marks between thousands read without them"
NAMED = 3
"""Columns that a message of several names."""

_COMPOUND_SUFFIXES = {"_kg_s": "kg/s", "_m3_h": "m3/h", "_L_min": "L/min", "_l_min": "L/min"}
_STANDARD_UNITS = {"heater_power": "W", "pump_speed": "%", "fan_speed": "%"}


@dataclass(frozen=True, eq=False)
class Record:
    """Samples at `time_s (n,)`, strictly increasing: `columns` by name, each `(n,)` float64, NaN if missing.

    `quality` holds, for columns that come with one, the reason `(n,)` of missing values. `start` is the UTC time of
    0 s if the record states it. `messages` are the notes of the reader, a sentence each.
    """

    time_s: NDArray[np.float64]
    columns: dict[str, NDArray[np.float64]]
    messages: tuple[str, ...] = ()
    path: Path | None = None
    sha256: str = ""
    quality: dict[str, NDArray[np.uint8]] = field(default_factory=dict)
    start: datetime.datetime | None = None
    metadata: dict[str, str] = field(default_factory=dict)

    @property
    def period_s(self) -> float:
        """Return the typical step between samples, s; NaN for a single sample."""
        return float(np.median(np.diff(self.time_s))) if len(self.time_s) > 1 else float("nan")

    def require(self, *names: str) -> None:
        """Raise RecordError naming the columns of `names` that are missing or hold no value at all."""
        problems = []
        for name in names:
            if f"column '{name}' holds text: dropped" in self.messages:
                problems.append(f"{name} (there, but as text)")
            elif name not in self.columns:
                said = column_hint(name, [c for c in self.columns if c not in names])
                problems.append(f"{name} ({said})" if said else name)
            elif np.isnan(self.columns[name]).all():
                problems.append(f"{name} (there, but without a value)")
        if problems:
            raise RecordError(
                f"{self.path or 'the record'} lacks {', '.join(problems)}; it has {', '.join(self.columns)}"
            )


def read_record(path: Path, *, at_rest: bool = False, choice: ReadingOptions | None = None) -> Record:
    """Return the record in the Parquet or CSV file at `path`, cleaned.

    With `at_rest` each row is a steady state of its own: all are kept in the order of the file, and their times, if
    any, are replaced by their numbers. `choice` are the user's choices for the file.

    Rows are sorted by time. Of rows with the same stamp one is kept, with each column's last value that is not
    missing: a logger sends a correction after the original, or one row a device. Impossible readings become missing
    (`hil.record.plausibility`).

    Raises
    ------
    RecordError
        Nothing can be read, something can be read in two ways, or reading would drop more than
        `record_numbers.may_be_lost` of the rows or of a column.
    """
    choice = choice or ReadingOptions()
    raw = without_cell_units(read_raw(path))
    messages = list(raw.messages)
    try:
        signs = decimal_signs(
            dict(zip(raw.names, raw.cells, strict=True)), raw.place, delimiter=raw.delimiter, given=choice.decimal
        )
    except DecimalSignError as error:
        raise RecordError(f"{path}: {error}") from error
    axis = numbered(raw) if at_rest else read_time(raw, signs, choice)
    messages += axis.messages
    if not at_rest:
        axis, rolled = without_rollovers(raw, axis)
        axis, went_on = without_set_back(raw, axis, signs)
        near, said = without_jumps(raw, axis)
        axis = _restarted(axis, near)
        messages += [*rolled, *went_on, *said, *clock_questions(axis, near, choice.time_scale)]
    rows, moved = order(raw, axis, signs)
    messages += moved
    stamps = axis.seconds[rows]
    last_of_stamp = np.append(np.flatnonzero(np.diff(stamps) > 0), len(stamps) - 1)
    time_s = stamps[last_of_stamp]
    repeats = len(stamps) - len(time_s)
    if len(time_s) == 1 and repeats > 1:
        raise RecordError(
            f"{path}: all {len(stamps)} rows have one time in column '{axis.column}'; name the column that counts with "
            "--time-column, or give --at-rest to hil diagnose where each row is a steady state"
        )
    if repeats:
        messages.append(f"{repeats} repeated time stamps: the last value of each column is kept")
    messages += [] if at_rest else describe_steps(time_s)
    columns: dict[str, NDArray[np.float64]] = {}
    quality: dict[str, NDArray[np.uint8]] = {}
    remedy = _remedy_of_repeats(raw, axis) if repeats else ""
    unmarked: list[str] = []
    rated = find_ratings(raw, axis.columns, signs)
    messages += rated.messages
    for name, cells in zip(raw.names, raw.cells, strict=True):
        written = name
        is_quality = name.endswith(QUALITY) and name.removesuffix(QUALITY) in raw.names
        if name in axis.columns or (name in rated.columns and not is_quality):
            continue
        values = None if name in rated.columns else _numbers(name, cells, signs.get(name, "."), raw, messages)
        if values is None:
            continue
        if is_quality:
            values = _last_known(written, values[rows], last_of_stamp, path, remedy) if repeats else values[rows]
            quality[name.removesuffix(QUALITY)] = np.clip(np.nan_to_num(values, nan=0.0), 0, 255).astype(np.uint8)
            continue
        numbers = rated.applied(name, values, raw, messages)
        name, values = _in_unit(name, _converted(numbers, raw, written), raw, messages, unmarked)
        values = without_implausible(name, values, raw.place, messages, raw.plausible.get(written), numbers)
        values = values[rows]
        if repeats:
            values = _last_known(written, values, last_of_stamp, path, remedy)
        messages += _asked(name, written, values)
        columns[name] = values
        if (reasons := rated.reasons(written)) is not None:
            reasons = reasons[rows][last_of_stamp]
            quality[name] = np.where(np.isnan(values), reasons, Quality.GOOD).astype(np.uint8)
    if not columns:
        raise RecordError(f"{path} has no column of numbers besides {axis.column}; give a record with signals")
    if unmarked:
        messages.append(f"no unit suffix: {', '.join(unmarked)} (kept as they are)")
    messages += remarks(columns)
    if not at_rest:
        messages += [*standing_still(time_s, columns), *unit_jumps(time_s, columns)]
    messages += _describe_missing(time_s, columns, quality)
    messages = _of_alike(messages)
    return Record(time_s, columns, tuple(messages), path, raw.sha256, quality, axis.start, raw.metadata or {})


def _of_alike(messages: list[str]) -> list[str]:
    """Return the messages with one for all columns whose numbers are written in the same way."""
    named: dict[str, list[str]] = {}
    for message in messages:
        name, mark, rest = message.rpartition(": ")
        alike = mark and rest.endswith((COMMAS, THOUSANDS))
        named.setdefault(rest if alike else message, []).append(name)
    found = []
    for rest, names in named.items():
        if not rest.endswith((COMMAS, THOUSANDS)):
            found.append(rest)
        elif len(names) <= NAMED:
            found.append(f"{', '.join(names)}: {rest}")
        else:
            found.append(f"{', '.join(names[:NAMED])} and {len(names) - NAMED} others: {rest} in each")
    return found


def _restarted(axis: TimeAxis, seconds: NDArray[np.float64]) -> TimeAxis:
    """Return the axis with `seconds (n,)`, which lack some of its rows; dated times begin at the first that is left."""
    if axis.start is None or not np.isfinite(seconds).any():
        return dataclasses.replace(axis, seconds=seconds)
    first = float(np.nanmin(seconds))
    start = axis.start + datetime.timedelta(seconds=first)
    return dataclasses.replace(axis, seconds=seconds - first, start=start)


def _numbers(name: str, cells: Any, sign: Sign, raw: RawRecord, messages: list[str]) -> NDArray[np.float64] | None:
    """Return the numbers of a column, None for a column of text; raise RecordError if too many cells are no numbers."""
    numbers = parse(cells, sign)
    if numbers is None or _is_text(name, numbers):
        kind = "text" if numbers else str(cells.type)
        messages.append(f"column '{name}' holds {kind}: dropped")
        return None
    if numbers.bad - numbers.marked > may_be_lost(numbers.present):
        raise RecordError(
            f"{raw.path}: column '{name}' has {numbers.bad} of {numbers.present} cells that are no numbers (the first, "
            f"{raw.place(numbers.row)}, is '{numbers.text[:20]}'); leave cells without a value empty, or take the "
            "column out"
        )
    if numbers.bad:
        cells_are = "1 cell is no number" if numbers.bad == 1 else f"{numbers.bad} cells are no numbers"
        messages.append(f"{name}: {cells_are} (the first, {raw.place(numbers.row)}, is '{numbers.text[:20]}'): missing")
    if numbers.commas:
        messages.append(f"{name}: {numbers.commas} {COMMAS}")
    if numbers.thousands:
        messages.append(f"{name}: {numbers.thousands} {THOUSANDS}")
    values = numbers.values
    if np.isinf(values).any():
        messages.append(f"{name}: {np.isinf(values).sum()} values are infinite: missing")
        values = np.where(np.isinf(values), np.nan, values)
    return values


def _converted(values: NDArray[np.float64], raw: RawRecord, name: str) -> NDArray[np.float64]:
    """Return the numbers of a column in its unit, where the file gives a multiple of it or another one."""
    if name not in raw.conversions:
        return values
    factor, offset = raw.conversions[name]
    return np.asarray(values * factor + offset, dtype=np.float64)


def _is_text(name: str, numbers: Numbers) -> bool:
    """Return True for a column of words: next to no numbers, or fewer than half of them and no unit in its name."""
    words = numbers.bad / max(numbers.present, 1)
    return words >= 1.0 - LOST or (words > 0.5 and split_column(name) is None)


def _remedy_of_repeats(raw: RawRecord, axis: TimeAxis) -> str:
    """Return what to do about rows with one time: numbers may have too few digits, other times lack their seconds."""
    text = trimmed(raw.cells[raw.names.index(axis.columns[0])]) if len(axis.columns) == 1 else None
    first = next((cell for cell in text.to_pylist() if cell), "") if text is not None else ""
    if re.fullmatch(r"[+-]?\d+[.,]?\d*[eE][+-]?\d+", first):
        return f"'{first}' has too few digits for the times of the rows: write all digits, without an exponent"
    if re.fullmatch(r"[+-]?\d+[.,]\d+", first):
        return f"'{first}' has too few digits for the times of the rows: write more decimals, or seconds"
    finer = (name for name in raw.names if name not in axis.columns and is_time_name(name))
    if (other := next((name for name in finer if _rises(raw, name)), None)) is not None:
        return f"column '{other}' counts in finer steps: --time-column '{other}' takes it"
    labels = (
        name for name, cells in zip(raw.names, raw.cells, strict=True) if name not in axis.columns and _few(cells)
    )
    if (label := next(labels, None)) is not None:
        return f"if column '{label}' names devices or sensors, call it 'device' for a column for each, or split it"
    return (
        "write times with fractions of a second or with their date, and if these are two records in one file, split it"
    )


def _rises(raw: RawRecord, name: str) -> bool:
    numbers = parse(raw.cells[raw.names.index(name)])
    return numbers is not None and not numbers.bad and bool((np.diff(numbers.values) > 0.0).all())


def _few(cells: Any) -> bool:
    """Return True for a column of a few texts, which may name the sources of the rows."""
    text = trimmed(cells)
    if text is None:
        return False
    labels = [cell for cell in text.unique().to_pylist() if cell]
    different = 0 if any(readings(cell) != (None, None) for cell in labels) else len(labels)
    return 2 <= different <= len(cells) // 2


def _last_known(
    name: str, values: NDArray[np.float64], last_of_stamp: NDArray[np.int64], path: Path, remedy: str
) -> NDArray[np.float64]:
    """Return the last known value (k,) of each stamp; raise RecordError if too many others would be lost."""
    known = np.where(np.isnan(values), -1, np.arange(len(values)))
    latest = np.maximum.accumulate(known)[last_of_stamp]
    first_of_stamp = np.append(0, last_of_stamp[:-1] + 1)
    kept = np.where(latest >= first_of_stamp, values[np.maximum(latest, 0)], np.nan)
    stamp = np.repeat(np.arange(len(kept)), last_of_stamp - first_of_stamp + 1)
    with np.errstate(invalid="ignore"):
        lost = int((np.isfinite(values) & (values != kept[stamp])).sum())
    present = int(np.isfinite(values).sum())
    if lost > may_be_lost(present):
        raise RecordError(
            f"{path}: {lost} of {present} values of column '{name}' stand at a time that another row has too; {remedy}"
        )
    return kept


def _in_unit(
    name: str, values: NDArray[np.float64], raw: RawRecord, messages: list[str], unmarked: list[str]
) -> tuple[str, NDArray[np.float64]]:
    """Convert `name` and `values` to the standard unit, if the name gives another unit or another spelling."""
    written = _rewritten(name)
    if written and written not in raw.names:
        if _standard_unit(written) is None:
            messages.append(f"{name}: its unit would follow from the name {written}; kept as it is")
            return name, values
        messages.append(f"column '{name}' is read as {written}")
        name = written
    parts = split_column(name)
    if parts is None:
        if name not in (raw.units or {}):
            unmarked.append(name)
        return name, values
    signal, unit = parts
    wanted = _standard_unit(name) or unit
    if wanted != unit and not (unit == "K" and is_difference(signal)):
        target = column_name(signal, wanted)
        convert = {("kW", "W"): (1000.0, 0.0), ("K", "degC"): (1.0, -273.15)}.get((unit, wanted))
        if convert is None or target in raw.names:
            messages.append(f"{name} is in {unit} where a record has {target}: kept as it is")
        else:
            messages.append(f"{name} is in {unit}: converted to {target}")
            name, values = target, values * convert[0] + convert[1]
    return name, values


def _asked(name: str, written: str, values: NDArray[np.float64]) -> list[str]:
    """Return questions about a column whose numbers do not fit the unit of its `name`; `written` is its name in the
    file.
    """
    if not np.isfinite(values).any() or split_column(name) is None:
        return []
    said: list[str] = []
    middle = float(np.nanmedian(values))
    if _standard_unit(name) == "degC":
        if LIQUID_K[0] <= np.nanmin(values) and np.nanmax(values) <= LIQUID_K[1]:
            said.append(UnitQuestion(f"{name} has a median of {middle:.4g}: is it in kelvin?"))
        elif (split_column(written) or ("", ""))[1] == "K" and middle < COLDEST_C:
            said.append(UnitQuestion(f"{name} has a median of {middle:.4g}: was it in degC before?"))
        elif middle > HOTTEST_ROOM_C and of_a_room(name):
            said.append(UnitQuestion(f"{name} has a median of {middle:.4g}: is it in degrees Fahrenheit?"))
    if name.startswith("T_") and name.endswith("_C") and len(values) > 100 and np.ptp(values) == 0:
        told = f"is constant at {values[0]:g} degC: assumed, or" if of_a_room(name) else f"is {values[0]:g} throughout:"
        said.append(f"{name} {told} is the channel dead?")
    return said


def _standard_unit(column: str) -> str | None:
    """Return the standard unit of the signal of `column`, or None."""
    signal, _ = split_column(column) or (column, "")
    return _STANDARD_UNITS.get(signal) or ("degC" if signal.startswith("T_") else None)


def _rewritten(name: str) -> str | None:
    for ending, unit in _COMPOUND_SUFFIXES.items():
        if name.endswith(ending) and len(name) > len(ending):
            return column_name(name.removesuffix(ending), unit)
    stem, _, tail = name.rpartition("_")
    if split_column(name) is None and stem and tail.lower() in WRITTEN_UNITS:
        return column_name(stem, WRITTEN_UNITS[tail.lower()])
    return None


def _describe_missing(
    time_s: NDArray[np.float64], columns: Mapping[str, NDArray[np.float64]], quality: Mapping[str, NDArray[np.uint8]]
) -> list[str]:
    alike: dict[bytes, list[str]] = defaultdict(list)
    for name, values in columns.items():
        alike[np.packbits(np.isnan(values)).tobytes()].append(name)
    messages = []
    for names in alike.values():
        missing = np.isnan(columns[names[0]])
        count = int(missing.sum())
        if not count:
            continue
        who = ", ".join(names) if len(names) < 6 else f"{', '.join(names[:3])} and {len(names) - 3} others"
        if count == len(time_s):
            messages.append(f"{who}: no value at all")
            continue
        edges = np.flatnonzero(np.diff(np.concatenate([[0], missing.astype(np.int8), [0]])))
        starts, ends = edges[::2], edges[1::2]
        longest = int(np.argmax(ends - starts))
        reasons = _reasons([quality[name][missing] for name in names if name in quality])
        each = " each" if len(names) > 1 else ""
        messages.append(
            f"{who}: {count} of {len(time_s)} values missing{each}{reasons}, the longest gap "
            f"{ends[longest] - starts[longest]} samples at {span(time_s[starts[longest]])}"
        )
    return messages


def _reasons(codes: list[NDArray[np.uint8]]) -> str:
    if not codes:
        return ""
    known = {member.value: member.name.lower().replace("_", " ") for member in Quality if member is not Quality.GOOD}
    found = [known[code] for code in np.unique(np.concatenate(codes)).tolist() if code in known]
    return f" ({', '.join(found)})" if found else ""


def require_record_suffix(path: Path) -> None:
    """Raise RecordError unless a record can be written under this name."""
    if path.suffix not in (".parquet", ".csv"):
        raise RecordError(f"{path} has suffix '{path.suffix}'; a record is written as .parquet or .csv")


def write_record(record: Record, path: Path) -> None:
    """Write `record` to `path`, Parquet or CSV by its suffix, atomically; every number reads back exactly."""
    import pyarrow as pa
    import pyarrow.csv as pacsv
    import pyarrow.parquet as pq

    arrays = {"time_s": pa.array(record.time_s)}
    # A missing value is null, not NaN, so that a CSV has an empty cell and Parquet's statistics stay usable.
    for name, values in record.columns.items():
        arrays[name] = pa.array(values, mask=np.isnan(values))
    for name, codes in record.quality.items():
        arrays[name + QUALITY] = pa.array(codes)
    table = pa.table(arrays)
    require_record_suffix(path)
    with replacing(path) as unfinished, unfinished.open("wb") as file:
        if path.suffix == ".csv":
            options = pacsv.WriteOptions(quoting_style="none")
            pacsv.write_csv(table, file, options)
        else:
            pq.write_table(table.replace_schema_metadata(record.metadata), file, compression="zstd")
