"""Check of a tower's file or folder: its content in lines, and its problems with file, line and remedy."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hil.files import parse_json
from hil.record import ReadingOptions, RecordError
from hil.tower.calibration import read_points
from hil.tower.file_kinds import cells_of
from hil.tower.station import (
    Mistakes,
    Station,
    TableError,
    checked_datasheet,
    event_entries,
    iso,
    open_samples,
    read_cell,
    read_labels,
    read_notes,
    read_rows,
    read_station,
    surveyed,
)
from twin.historian import Tag

NEEDED = ("t_in_C", "t_out_C", "m_w_kg_s", "fan_speed_pct", "dry_C", "wet_C")
SHOWN = 20
"""Tags of a store without a dictionary that are listed."""


@dataclass(frozen=True)
class CheckedFile:
    """Kind of a file as a phrase, its content in lines, and its problems as sentences."""

    what: str
    lines: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()


def check_file(path: Path, kind: str, choice: ReadingOptions | None = None) -> CheckedFile:
    """Return the content and the problems of a tower's file or folder.

    Parameters
    ----------
    path
        The file or folder.
    kind
        Its kind, as `hil.tower.tower_kind` names it.
    choice
        Decimal sign, order of dates and time column of a store in CSV, where they are ambiguous.

    Raises
    ------
    HistorianError
        A store cannot be opened.
    """
    try:
        return _store(path, choice) if kind == "store" else _CHECKS[kind](path)
    except TableError as error:
        return CheckedFile(_WHAT[kind], (), error.problems)
    except RecordError as error:
        return CheckedFile(_WHAT[kind], (), tuple(str(error).splitlines()))


def _store(path: Path, choice: ReadingOptions | None) -> CheckedFile:
    beside = {name: path / name for name in ("tags.csv", "datasheet.json", "events.csv") if (path / name).is_file()}
    others = [file for name, file in beside.items() if name.endswith(".csv")]
    with open_samples(str(path), others, choice=choice) as store:
        names, span = store.tags(), store.span()
        what = f"a historian store of {len(names)} tags"
        if span is None:
            return CheckedFile(what, (), (f"{path}: has no sample; check the export",))
        what += f", {_days(*span)}"
        if "tags.csv" not in beside:
            listed = ", ".join(names[:SHOWN]) + (f" and {len(names) - SHOWN} more" if len(names) > SHOWN else "")
            remedy = f"`hil tower align {path} --tags TAGS.csv` takes it with a dictionary of their units and roles"
            return CheckedFile(what, (listed, f"there is no tags.csv beside the samples: {remedy}"))
        station = _described(path, beside)
        series, problems = surveyed(store, station)
    lines = []
    for one in series:
        good = one.value[one.good]
        spread = f"{good.min():.5g} to {good.max():.5g} {one.tag.unit}" if len(good) else "no good sample"
        bad = f", {len(one.value) - len(good)} not good" if len(good) < len(one.value) else ""
        lines.append(f"{one.tag.name} ({_place(one.tag)}): {len(one.value)} samples, {spread}{bad}")
    if not station.cells:
        problems.append(
            f"{beside['tags.csv']}: no tag has the role water_outlet_temperature; map that of each cell's outlet"
        )
    return CheckedFile(what, tuple(lines), tuple(problems))


def _described(path: Path, beside: Mapping[str, Path]) -> Station:
    """Return the station of the files in a store; raises TableError with the mistakes of all of them."""
    mistakes = Mistakes(path)
    for name, reader in (("datasheet.json", checked_datasheet), ("events.csv", event_entries)):
        if name in beside:
            with mistakes.noted():
                reader(beside[name])
    with mistakes.noted():
        found = read_station(beside["tags.csv"])
        if not mistakes:
            found = read_station(beside["tags.csv"], beside.get("datasheet.json"), beside.get("events.csv"))
    mistakes.refuse()
    return found


def _place(tag: Tag) -> str:
    return f"{tag.role}, cell {tag.cell}" if tag.cell is not None else tag.role


def _days(start_s: float, end_s: float) -> str:
    return f"{iso(start_s)[:16]}Z to {iso(end_s)[:16]}Z"


def _record(path: Path) -> CheckedFile:
    problems: list[str] = []
    lines = []
    numbers = cells_of(path)
    for number in numbers:
        try:
            cell = read_cell(path, number)
        except RecordError as error:
            problems += str(error).splitlines()
            continue
        shares = [f"{name} {100.0 * float(np.isfinite(cell.columns[name]).mean()):.0f} %" for name in NEEDED]
        lines.append(f"cell {number}: {len(cell.time_s)} minutes, {_days(cell.time_s[0], cell.time_s[-1])}")
        lines.append(f"  known: {', '.join(shares)}")
    try:
        lines.append(_plural(len(read_notes(path).events), "event"))
    except RecordError as error:
        problems += str(error).splitlines()
    lines += _alignment(path / "alignment.json", problems)
    return CheckedFile(f"an aligned record of {_plural(len(numbers), 'cell')}", tuple(lines), tuple(problems))


def _alignment(path: Path, problems: list[str]) -> list[str]:
    """Return lines on the defects and remarks of the alignment."""
    try:
        found = parse_json(path.read_text())
        kinds = [one["type"] for one in found["defects"]]
        remarks = [str(text) for text in found["remarks"]]
    except (OSError, ValueError, KeyError, TypeError) as error:
        problems.append(f"{path}: cannot be read ({type(error).__name__}: {error}); align the store again")
        return []
    counts = [f"{kinds.count(kind)} {kind}" for kind in sorted(set(kinds))]
    return [f"defects that were mended or left out: {', '.join(counts) or 'none'}", *remarks]


def _tags(path: Path) -> CheckedFile:
    station = read_station(path)
    lines = [f"{tag.name}: {_place(tag)}, {tag.unit}" for tag in station.tags.values()]
    problems = list(station.remarks)
    if not station.cells:
        problems.append(f"{path}: no tag has the role water_outlet_temperature; map that of each cell's outlet")
    cells = ", ".join(map(str, station.cells)) or "none"
    return CheckedFile(
        f"a tag dictionary of {_plural(len(station.tags), 'tag')}; cells with an outlet: {cells}",
        tuple(lines),
        tuple(problems),
    )


def _labels(path: Path) -> CheckedFile:
    cells = _cells_in(path, ("time", "cell", "parameter", "kind"))
    labels = read_labels(path, cells)
    lines = [
        f"cell {label.cell}, {iso(label.time_s)[:10]}: {label.parameter}, "
        + ("a point" if label.sd is not None else "an interval")
        for label in labels
    ]
    return CheckedFile(_counted("labels", len(labels), cells), tuple(lines))


def _events(path: Path) -> CheckedFile:
    entries = event_entries(path)
    lines = [f"{one['time'][:16]}Z, cell {one['cell'] or 'all'}: {one['kind']}" for one in entries]
    moved = [one for one in entries if one["parameters"]]
    return CheckedFile(f"{_plural(len(entries), 'event')}, {len(moved)} of which may move a deviation", tuple(lines))


def _points(path: Path) -> CheckedFile:
    cells = _cells_in(path, ("cell",))
    lines, count = [], 0
    mistakes = Mistakes(path)
    for cell in cells or (1,):
        with mistakes.noted():
            found = read_points(path, cell)
        if mistakes:
            continue
        inputs = found.points.inputs
        count += len(found.names)
        lines.append(
            f"cell {cell}: {_plural(len(found.names), 'test point')}, water {inputs.m_w.min():.4g} to "
            f"{inputs.m_w.max():.4g} kg/s, fan {100.0 * inputs.speed.min():.4g} to {100.0 * inputs.speed.max():.4g} %"
        )
    mistakes.refuse()
    return CheckedFile(_counted("test points", count, cells), tuple(lines))


def _datasheet(path: Path) -> CheckedFile:
    sheet = checked_datasheet(path)
    lines = [f"{name}: {json.dumps(value, ensure_ascii=False)}" for name, value in sheet.items()]
    problems = []
    if "water_flow_kg_s" not in sheet.get("design", {}):
        problems.append(f"{path}: design.water_flow_kg_s is missing, which commissioning needs; give the design flow")
    return CheckedFile(
        f"the datasheet of station {sheet.get('station', 'without a name')}", tuple(lines), tuple(problems)
    )


def _other(path: Path, sentence: str) -> CheckedFile:
    raise RecordError(f"{path}: {sentence}")


def _cells_in(path: Path, required: tuple[str, ...]) -> tuple[int, ...]:
    found = set()
    for _, row in read_rows(path, required):
        # A cell that is no number is a mistake that the reader of the table states.
        with contextlib.suppress(ValueError, OverflowError):
            found.add(int(float(row["cell"])))
    return tuple(sorted(found))


def _counted(what: str, count: int, cells: Sequence[int]) -> str:
    return f"{count} {what} of cell{'s' if len(cells) != 1 else ''} {', '.join(map(str, cells)) or 'none'}"


def _plural(count: int, what: str) -> str:
    return f"{count} {what}{'s' if count != 1 else ''}"


_CHECKS: dict[str, Callable[[Path], CheckedFile]] = {
    "record": _record,
    "tags": _tags,
    "labels": _labels,
    "events": _events,
    "points": _points,
    "datasheet": _datasheet,
    "part": lambda path: _other(path, f"is a part of an aligned record; check its folder, {path.parent}"),
    "calibration": lambda path: _other(path, f"holds the result of a calibration; `hil tower report {path}` states it"),
}
_WHAT = {
    "store": "a historian store",
    "record": "an aligned record",
    "tags": "a tag dictionary",
    "labels": "labels of a tower",
    "events": "events of a station",
    "points": "test points of a tower",
    "datasheet": "a datasheet of a station",
    "part": "a part of an aligned record",
    "calibration": "a calibration",
}
