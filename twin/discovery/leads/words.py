"""Leads in words: segments, ranges of inputs, drives outside the healthy record, places and single rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from twin.discovery.diagnosis import Course, Lead
from twin.discovery.effects.phrases import amount, clock, lasting
from twin.discovery.effects.statement import disturbance_statement
from twin.discovery.healthy.basis import Columns
from twin.discovery.healthy.operating_range import BRIEF, STEADY
from twin.discovery.leads.concentration import ResidualSquares, input_ranges, segments
from twin.discovery.leads.rows import MOST_ROWS, Suspicious, near_steps, suspicious_inputs, suspicious_readings
from twin.network import Array, InputSpec, Network
from twin.segments import CLOCK_PREFIX

NEARLY_ALL = 0.995
"""Share from which it is given as nearly all."""
FOLLOWS = 0.7
"""Correlation from which a course follows an input, as in `places.localise.describe`."""


def segment_leads(squares: ResidualSquares, first_s: Array, last_s: Array, at_rest: bool = False) -> tuple[Lead, ...]:
    """Return the segments in which squares concentrate, or a lead that they are all over the record.

    Parameters
    ----------
    first_s, last_s
        (b,) times at which the blocks begin and end in the record, s; of steady states both are their numbers.
    """
    found = []
    for one in segments(squares):
        at = np.flatnonzero(one.rows)
        low, high = float(first_s[at[0]]), float(last_s[at[-1]])
        when = f"from {clock(low)} to {clock(high)}"
        if at_rest:
            when = f"in states {low:.0f} to {high:.0f}" if high > low else f"in state {low:.0f}"
        says = f"{_percent(one.share)} of the squares left beyond noise lies {when} ({_of(one.of_record, at_rest)})"
        found.append(Lead("segment", says, "", low, high, "" if at_rest else "s", one.share, one.of_record))
    if not found and squares.present:
        low, high, whole = float(first_s[0]), float(last_s[-1]), "in all states" if at_rest else "all over the record"
        says = f"the misfit lies {whole}; no segment of it stands out"
        found.append(Lead("segment", says, "", low, high, "" if at_rest else "s", 1.0, 1.0))
    return tuple(found)


def range_leads(network: Network, squares: ResidualSquares, inputs: Array, memory: int | None) -> tuple[Lead, ...]:
    """Return the ranges of inputs (b, c) on which squares depend; `memory` as `input_ranges` takes it."""
    found = []
    for j, one in input_ranges(squares, inputs, memory):
        column, spec = list(network.inputs.items())[j]
        # Blocks in which an input passes through a range are a moment of it; a state is not.
        low, high = (float(x) for x in np.percentile(inputs[one.rows, j], (0.0, 100.0) if memory is None else BRIEF))
        says = (
            f"{_percent(one.share)} of the squares left beyond noise lies where {_named(column)} is "
            f"{_range(low, high, spec.unit)} ({_of(one.of_record, memory is None)})"
        )
        found.append(Lead("input range", says, column, low, high, spec.unit, one.share, one.of_record))
    return tuple(found)


def outside_leads(network: Network, squares: ResidualSquares, inputs: Array, healthy: Columns) -> tuple[Lead, ...]:
    """Return the inputs (b, c) far outside their range in the healthy record, by more than a nearly constant input
    varies.
    """
    found = []
    for j, (column, spec) in enumerate(network.inputs.items()):
        then = healthy.inputs[np.isfinite(healthy.inputs[:, j]), j]
        if column.startswith(CLOCK_PREFIX) or not then.size:
            continue
        room = _room(spec)
        least, most = float(then.min()), float(then.max())
        rows = (inputs[:, j] < least - room) | (inputs[:, j] > most + room)
        if not rows.any():
            continue
        low, high = float(inputs[rows, j].min()), float(inputs[rows, j].max())
        share, part = squares.share(rows), float(rows.mean())
        says = (
            f"{_named(column)} was {_range(least, most, spec.unit)} in the healthy record and is outside that for "
            f"{_percent(part)} of this one ({_range(low, high, spec.unit)}); {_percent(share)} of the squares left "
            "beyond noise lies there"
        )
        found.append(Lead("outside healthy range", says, column, low, high, spec.unit, share, part))
    return tuple(found)


def place_leads(free: Sequence[Course], description: dict[str, Any], start: float) -> tuple[Lead, ...]:
    """Return the likeliest place of an unknown quantity, with its sign and its course."""
    if not free or not description:
        return ()
    best = free[0]
    low, high = (float(x) for x in description["range"])
    where = best.where or best.site
    since = start + float(description["onset_s"]) if description["onset_s"] else None
    text = disturbance_statement(where, float(description["mean"]), best.unit, (low, high), since, average=True)
    return (Lead("place", f"{text}; {_course(description)}", where, low, high, best.unit),)


def row_leads(
    found: Sequence[tuple[Suspicious, Sequence[str], Sequence[str]]], stamp: Callable[[int], tuple[float, str]]
) -> tuple[Lead, ...]:
    """Return at most `MOST_ROWS` single rows.

    Parameters
    ----------
    found
        Rows, the farthest first, each with the names of the columns and their units.
    stamp
        Time of a row by its number, s, and in words.
    """
    leads = []
    for one, names, units in found[:MOST_ROWS]:
        time, when = stamp(one.row)
        off = " and ".join(
            f"{name} is {amount(abs(x), unit)} {'above' if x > 0.0 else 'below'}"
            for name, x, unit in zip(names, one.off, units, strict=True)
        )
        times = f", {one.times:.0f} times the noise" if one.times else ""
        at_rest = when.startswith("state")
        beside = "what the twin gives, unlike all other states" if at_rest else "its neighbours"
        leads.append(Lead("row", f"{when}: {off} {beside}{times}", " ".join(names), time, time, "" if at_rest else "s"))
    if len(found) > MOST_ROWS:
        leads[-1] = _more(leads[-1], len(found) - MOST_ROWS)
    return tuple(leads)


def record_rows(network: Network, record: Columns, simulated: Array) -> tuple[Lead, ...]:
    """Return the single suspicious rows of a record, inputs first; `simulated` (N, m) degC at its stamps."""
    time, specs = record.time_s, list(network.inputs.values())
    sensors, columns = network.sensor_names, network.input_columns
    least = np.array([_room(spec) for spec in specs])
    found: list[tuple[Suspicious, Sequence[str], Sequence[str]]] = [
        (s, [columns[j] for j in s.columns], [specs[j].unit for j in s.columns])
        for s in suspicious_inputs(time, record.inputs, least)
    ]
    moved = near_steps(record.inputs, least)
    readings = [s for s in suspicious_readings(time, record.measured, simulated, network.sigma) if not moved[s.row]]
    found += [(s, [sensors[j] for j in s.columns], ["K"] * len(s.columns)) for s in readings]
    return row_leads(found, lambda row: (float(time[row]), f"single row at {time[row]:.10g} s ({clock(time[row])})"))


def _more(lead: Lead, count: int) -> Lead:
    text = f"{lead.says}; {count} more such {'row' if count == 1 else 'rows'}"
    return Lead(lead.kind, text, lead.where, lead.low, lead.high, lead.unit)


def _course(description: dict[str, Any]) -> str:
    """Return the course of an unknown quantity in words."""
    driver, follows = str(description["driver"]), description.get("follows") or {}
    if driver == "constant":
        return "its size hardly changes"
    if driver == "periodic":
        return f"it comes back every {lasting(float(description['period_s']))}"
    if driver == "threshold":
        return "it is on or off, with little between"
    if driver in follows and abs(follows[driver]) > FOLLOWS:
        if driver == "elapsed_time":
            return f"it {'rises' if follows[driver] > 0.0 else 'falls'} as time goes on"
        way = "rises and falls with" if follows[driver] > 0.0 else "falls where there is more of"
        return f"it {way} {driver.replace('_', ' ')}"
    return "its course follows no input"


def _room(spec: InputSpec) -> float:
    """Return the variation of an input that counts as nearly constant."""
    width = spec.upper - spec.lower
    return STEADY * float(width if np.isfinite(width) else abs(spec.nominal))


def _named(column: str) -> str:
    return column.rsplit("_", 1)[0]


def _range(low: float, high: float, unit: str) -> str:
    named = f" {unit}" if unit not in ("", "1") else ""
    one, other = (f"{x:.0f}" if abs(x) >= 1000.0 else f"{x:.3g}" for x in (low, high))
    return f"{one}{named}" if one == other else f"{one} to {other}{named}"


def _percent(share: float) -> str:
    if share >= NEARLY_ALL:
        return "nearly all"
    return f"{100.0 * share:.0f} %" if share >= 0.01 else "under 1 %"


def _of(share: float, at_rest: bool) -> str:
    return f"{100.0 * share:.0f} % of the {'states' if at_rest else 'record'}"
