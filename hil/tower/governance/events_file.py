"""Events of a calibration: those that the station entered, and those that the record and the calibration show.

`events.json` holds them in the form of a record's `station.json`. `source` is that of the entry, `record` for a fan
trip or a start-up that only the record shows, and `calibration` for a step or a change that no entry explains.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hil.tower.calibration import FOUND, CellResult, step_sentence
from hil.tower.station import EVENT_SHAPE, StationNotes, iso, read_object, seconds, timed_events
from twin.historian import START_UP_MIN, start_ups
from twin.tower import Array

EVENTS = "events.json"
RECORD, CALIBRATION = "record", FOUND
"""Sources of events that nobody entered."""
TRIP, START = "fan_trip", "start_up"
SAME_TRIP_S = 900.0
"""Time by which the fault that the record shows may precede its entry: clocks and scans are minutes apart."""
STEP_MOVES = {"thermometer": ["bias"], "fan": ["air"], "water": []}
REMEDY = "calibrate again"


def write_events(results: Sequence[CellResult], notes: StationNotes, out: Path) -> None:
    """Write the events of calibrated cells into `out`, in the order of time.

    Parameters
    ----------
    results
        Calibrated cells.
    notes
        Events that the station entered.
    out
        Folder of the calibration.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    spans = {one.cell: (float(one.minutes.time_s[0]), float(one.minutes.time_s[-1]) + 60.0) for one in results}
    first, last = min(a for a, _ in spans.values()), max(b for _, b in spans.values())
    entered = [e for e in notes.events if e["cell"] in (0, *spans) and _overlaps(e, first, last)]
    found = [dict(e) for e in entered]
    starts = {one.cell: _starts(one) for one in results}
    for one in results:
        found += _trips(one, entered)
        found += _started(one.cell, starts)
        found += _calibrated(one)
    found.sort(key=lambda e: (e["from"], e["cell"], e["kind"]))
    (out / EVENTS).write_text(json.dumps({"events": found}, indent=1) + "\n")


def read_events(out: Path) -> list[dict[str, Any]]:
    """Return the events of a calibration's folder; none of a folder that an older version made.

    Raises
    ------
    RecordError
        The file is damaged.
    """
    path = out / EVENTS
    if not path.is_file():
        return []
    return list(timed_events(path, read_object(path, {"events": [EVENT_SHAPE]}, REMEDY)["events"], REMEDY))


def event_lines(out: Path) -> list[str]:
    """Return the events as lines of Markdown: their number by class, and those that may have moved a deviation.

    Raises
    ------
    RecordError
        The file is damaged.
    """
    events = read_events(out)
    if not events:
        why = "no event is known" if (out / EVENTS).is_file() else f"{EVENTS} is missing; {REMEDY} to write it"
        return ["## Events", "", f"None: {why}."]
    count = Counter((e["cell"], _named(e), e["source"]) for e in events)
    lines = ["## Events", "", "| cell | event | source | number |", "|---|---|---|---|"]
    lines += [f"| {cell or 'all'} | {kind} | {source} | {n} |" for (cell, kind, source), n in sorted(count.items())]
    moving = [e for e in events if e["parameters"]]
    if moving:
        lines += ["", "These may have moved a deviation:", ""]
    for e in moving:
        cell, text = f"cell {e['cell']}" if e["cell"] else "all cells", e.get("text") or ""
        day = e["time"][:10] if e["by_day"] else f"{e['time'][:16]}Z"
        what = f"{e['kind'].replace('_', ' ')} ({e['source']})"
        lines.append(f"- {day} {cell}: {what}, {', '.join(e['parameters'])}{f': {text}' if text else ''}")
    return lines


def _named(event: dict[str, Any]) -> str:
    name = str(event["kind"]).replace("_", " ")
    return f"{name}, {event['text']}" if event["kind"] == START and event.get("text") else name


def _overlaps(event: dict[str, Any], first: float, last: float) -> bool:
    return seconds(event["from"]) < last and seconds(event["to"]) >= first


def _entry(cell: int, kind: str, source: str, start_s: float, end_s: float, **more: Any) -> dict[str, Any]:
    return {
        "time": iso(start_s),
        "by_day": False,
        "cell": cell,
        "kind": kind,
        "source": source,
        "text": more.get("text", ""),
        "from": iso(start_s),
        "to": iso(end_s),
        "parameters": more.get("parameters", []),
    }


def _trips(result: CellResult, entered: Sequence[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield the fan faults of the record that no entry tells."""
    fault = result.record.columns.get("fan_fault")
    if fault is None:
        return
    known = np.flatnonzero(np.isfinite(fault))
    raised = (fault[known] > 0.5).astype(int)
    edges = np.diff(raised, prepend=0, append=0)
    time_s = result.record.time_s
    told = [
        (seconds(e["from"]) - SAME_TRIP_S, seconds(e["to"]))
        for e in entered
        if e["kind"] == TRIP and e["cell"] in (0, result.cell)
    ]
    for start, end in zip(np.flatnonzero(edges > 0), np.flatnonzero(edges < 0), strict=True):
        low, high = float(time_s[known[start]]), float(time_s[known[end - 1]]) + 60.0
        if not any(first <= low <= last for first, last in told):
            text = f"the fan's fault stood for {(high - low) / 60.0:.0f} min"
            yield _entry(result.cell, TRIP, RECORD, low, high, text=text)


def _starts(result: CellResult) -> Array:
    """Return the times at which a cell's water began to flow, s (k,)."""
    columns, n = result.record.columns, len(result.record.time_s)
    missing = np.full(n, np.nan)
    water_known = np.isfinite(columns.get("m_w_kg_s", missing)) | np.isfinite(columns.get("in_service", missing))
    return np.asarray(result.record.time_s[start_ups(result.minutes.regime, water_known)])


def _started(cell: int, starts: dict[int, Array]) -> Iterator[dict[str, Any]]:
    for at in starts[cell].tolist():
        beside = [c for c, times in starts.items() if c != cell and (np.abs(times - at) <= 60.0 * START_UP_MIN).any()]
        text = f"together with cell{'s' if len(beside) > 1 else ''} {', '.join(map(str, beside))}" if beside else ""
        yield _entry(cell, START, RECORD, at, at + 60.0 * START_UP_MIN, text=text)


def _calibrated(result: CellResult) -> Iterator[dict[str, Any]]:
    """Yield the lasting steps and the changes that the calibration found."""
    for step in result.steps:
        if step.lasting:
            more = {"text": step_sentence(step), "parameters": STEP_MOVES[step.kind]}
            yield _entry(result.cell, f"{step.kind}_step", CALIBRATION, step.since_s, step.alarm_s, **more)
    for change in result.changes:
        text = f"the {change.parameter} changed, and no entry explains it"
        more = {"text": text, "parameters": [change.parameter]}
        yield _entry(result.cell, "undeclared_change", CALIBRATION, change.start_s, change.end_s, **more)
