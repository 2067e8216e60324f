"""Alarm list as rows of a table and as JSON, for terminal, report and panel."""

from __future__ import annotations

import math
from typing import Any

from drivers.signals import Quality
from hil.alarms.alarm_list import AlarmList, AlarmStatus, utc
from hil.alarms.definitions import AlarmDefinition
from hil.alarms.states import ACTIVE, SHELVED, WAITING, AlarmState

_WORDS = {
    "high": "above",
    "low": "below",
    "rate_of_rise": "rises faster than",
    "no_flow": "with heat, below",
    "disagreement": "off its set-point by more than",
    "deviation": "off its set-point by more than",
    "residual": "off the twin by more than",
    "rig_counter": "has not advanced for",
}


def condition_of(item: AlarmDefinition, text: str = "") -> str:
    """Return the condition of an alarm in words: a sentence of the run where there is one."""
    said = text or item.doc
    if item.kind == "link":
        said = f"the link to {item.bus} is lost"
    elif item.kind == "sensor":
        said = f"{item.points[0]} has no good value"
    elif item.kind == "rig_trip":
        said = f"the rig has tripped by itself ({item.points[0]})"
    elif item.kind in _WORDS:
        name = item.sensor if item.kind == "residual" else item.points[-1 if item.kind == "deviation" else 0]
        limit = item.window_s if item.kind == "rig_counter" else item.limit
        said = f"{name} {_WORDS[item.kind]} {limit:g} {_unit(item)}".rstrip() + (f" ({item.doc})" if item.doc else "")
    return said


def _unit(item: AlarmDefinition) -> str:
    if item.kind == "rig_counter":
        return "s"
    return "" if item.unit == "1" else "°C" if item.unit == "degC" else item.unit.replace("degC", "°C")


def value_of(item: AlarmDefinition, value: float) -> str:
    """Return the value that raised an alarm with its unit; that of a sensor is the quality of its reading."""
    if not math.isfinite(value):
        return ""
    if item.kind == "sensor":
        known = {int(quality): quality.name.lower().replace("_", " ") for quality in Quality}
        return known.get(int(value), "")
    if item.kind == "rig_trip":
        return f"{int(value):#06b}"
    return f"{value:.4g} {_unit(item) if item.kind != 'rig_counter' else ''}".rstrip()


def alarm_lines(statuses: list[AlarmStatus]) -> list[str]:
    """Return two lines for each alarm: state, priority, id, value, since (UTC); below, its condition and the last act.

    An id is never cut, whatever the width of the terminal.
    """
    heads = [
        (
            item.state.value.split(" ")[0].rstrip(",").upper() if item.state is not AlarmState.NORMAL else "normal",
            item.definition.priority,
            item.definition.id,
            value_of(item.definition, item.value),
            f"since {utc(item.wall_s)}" if item.count else "",
        )
        for item in statuses
    ]
    widths = [max(map(len, column)) for column in zip(*heads, strict=True)]
    lines = []
    for item, head in zip(statuses, heads, strict=True):
        lines.append("  ".join(cell.ljust(width) for cell, width in zip(head, widths, strict=True)).rstrip())
        said = [condition_of(item.definition, item.text)]
        if item.state in SHELVED:
            said.append(f"shelved until {utc(item.until_s)}{', and its condition is there' * (item.state in ACTIVE)}")
        if item.by and item.state not in WAITING:
            said.append(f"{item.by}: {item.reason}" if item.reason else f"by {item.by}")
        lines.append(" " * (widths[0] + 2) + "; ".join(said))
    return lines


def alarm_document(kept: AlarmList, *, everything: bool = False) -> dict[str, Any]:
    """Return an alarm list as JSON has it, with the transitions; `everything` adds the alarms that are normal."""
    statuses = list(kept.statuses.values()) if everything else kept.standing()
    return {
        "alarms": [_status(item) for item in statuses],
        "history": [
            {
                "time": record.time,
                "id": record.id,
                "event": record.event.value,
                "from": record.source.value,
                "to": record.target.value,
                "by": record.by,
                "reason": record.reason,
                "value": _number(record.value),
                "text": record.text,
            }
            for record in kept.records
        ],
    }


def _status(item: AlarmStatus) -> dict[str, Any]:
    definition = item.definition
    return {
        "id": definition.id,
        "priority": definition.priority,
        "state": item.state.value,
        "since": utc(item.wall_s) or None,
        "time_s": _number(item.time_s),
        "value": _number(item.value),
        "shown": value_of(definition, item.value),
        "limit": definition.limit,
        "unit": definition.unit,
        "what": condition_of(definition, item.text),
        "count": item.count,
        "by": item.by,
        "reason": item.reason,
        "shelved_until": utc(item.until_s) or None,
    }


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
