"""Values that stand still for longer than the tag ever does.

With exception reporting a still value is normal for hours, for a valve as for a steady flow: nothing is stored but a
sample after the fixed time. These samples show the instrument's noise, in which a healthy instrument nearly never
repeats a number several times, and a stuck one always does. So a run of equal samples is called stuck if its repeats
are improbable by the tag's share of repeats, and if it is set off from the tag's other runs: sorted by length, there
is a step by a factor of two below it. Values at which the tag often rests (a limit, zero) are never called stuck.

A tag that has one value whenever it is at work has no habit to be compared with: a fan at full speed, a constant
pump. It is stuck only if what it measures must have moved, as other tags of its cell or station show (`WITNESSES`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.historian.defects.humidity import SATURATED
from twin.historian.tags import Array, Defect, Series, longest_interval_s
from twin.historian.units import unit_of

LEAST_S = 2.0 * 3600.0
STEP = 2.0
"""Factor by which a stuck run is longer than the longest healthy one."""
MOST = 8
"""Stuck runs of a tag in a season; more are its habit."""
MEASURED = frozenset({"temperature", "mass flow", "power", "pressure", "speed", "angle", "frequency"})
CHANCE = 0.05
"""Largest expected number of such runs by chance in the season of a station, so that one of twenty has one; each of its
measured tags has an equal share."""
AROUND_S = 2.0 * 3600.0
LIVELY = 20.0
"""Expected samples, by the rates on either side, from which standing still is improbable: exp(-20) for a Poisson
process, and samples of one tag come more evenly than those."""
REPEATS = 3
"""Repeats of a value from which a fan's tag stands while its fan moves: its noise repeats one, seldom two."""
AT_REST = 0.02
"""Share of the 98 % quantile: at rest below it."""
REST_RUNS = 2
"""Other long runs, of a quarter of the length, at the same value, from which the tag is said to rest there."""
SPUN, WORKS, COOLS = 0.1, 0.9, 0.5
"""Share of its usual top at which a fan turns; share of a span in which it turns in a cell at work, and share of the
usual difference of inlet and outlet there: standing water comes to one temperature."""
CONSTANT = 0.99
"""Share of the samples at work that have the one value of a constant tag; the others are ramps of starts and stops."""


@dataclass(frozen=True)
class Witness:
    """Movement of another tag that a quantity must follow: role, and the least one, in the record's unit or as a share
    of the witness's 98 % quantile."""

    role: str
    least: float
    share: bool = False


_COMMAND = Witness("fan_speed_command", 0.08, share=True)
_WATER = ("water_inlet_temperature", "water_outlet_temperature", "basin_temperature", "supply_temperature")
WITNESSES: dict[str, tuple[Witness, ...]] = {
    "fan_speed": (_COMMAND, Witness("fan_power", 0.25, share=True)),
    "fan_power": (_COMMAND, Witness("fan_speed", 0.08, share=True)),
    "water_flow": (Witness("pump_power", 0.35, share=True), Witness("header_pressure", 0.35, share=True)),
    "pump_power": (Witness("header_pressure", 0.35, share=True),),
    "header_pressure": (Witness("pump_power", 0.35, share=True),),
    "return_header_temperature": (Witness("water_inlet_temperature", 1.0),),
    "dry_bulb_temperature": (Witness("wet_bulb_temperature", 1.0),),
    "wet_bulb_temperature": (Witness("dry_bulb_temperature", 1.0),),
    "relative_humidity": (Witness("dry_bulb_temperature", 1.0),),
    "relative_humidity_redundant": (Witness("dry_bulb_temperature", 1.0),),
} | {role: tuple(Witness(other, 1.0) for other in _WATER if other != role) for role in _WATER}
"""Tags whose movement shows that a quantity moved, by role.

A fan's speed moves beyond a controller's hunting (8 %) and its power by more than density, pitch and belt make at one
speed (a quarter, as in `checks`); 8 % of speed are a quarter of power. Cells share the pumps unevenly, by up to 35 %
(`checks`). Water and air move by more than the bias of a thermometer, 1 K.
"""


def is_measured(series: Series) -> bool:
    """Return whether a tag is a measured quantity with enough samples to judge."""
    measured = (
        unit_of(series.tag.unit).dimension in MEASURED
        or "humidity" in series.tag.role
        or series.tag.role == "fan_speed"
    )
    return measured and "command" not in series.tag.role and len(series.time_s) >= 50


def constant_value(series: Series) -> float | None:
    """Return the one value that a measured tag has whenever it is at work; None where it has several."""
    if not is_measured(series):
        return None
    at_work = np.abs(series.value) > AT_REST * float(np.quantile(np.abs(series.value), 0.98))
    values = series.value[at_work]
    if not len(values):
        return None
    usual = float(np.median(values))
    return usual if float((values == usual).mean()) >= CONSTANT else None


def stuck_values(series: Series, others: Sequence[Series] = ()) -> list[Defect]:
    """Return the spans in which a measured quantity stood still for longer than it ever does otherwise.

    Parameters
    ----------
    series
        Good samples of a tag, in its own unit; a hole ends a run.
    others
        Tags of the station, for what must have moved with it.
    """
    if not is_measured(series):
        return []
    constant = constant_value(series)
    if constant is not None:
        return _contradicted(series, constant, others)
    found = _zero_at_work(series, others)
    first, last, end = _joined(series, *_runs(series))
    value, start = series.value[first], series.time_s[first]
    held = series.time_s[last] - start
    top = float(np.quantile(np.abs(series.value), 0.98))
    at_work = np.abs(value) > AT_REST * top
    chosen = _set_off(held, at_work)
    chance = CHANCE / max(sum(is_measured(one) for one in others), 1)
    # A latched humidity stands at its end, where it also rests in fog; the other sensor decides.
    saturates = "humidity" not in series.tag.role
    for k in chosen:
        lively = _expected(series.time_s, float(start[k]), float(end[k])) > LIVELY
        if not lively and _by_chance(series, first, last, at_work, k) > chance:
            continue
        may_latch = not saturates and unit_of(series.tag.unit).scale * value[k] >= SATURATED
        if (not may_latch and _rests(value, held, k, top)) or (saturates and _at_end(value, k)):
            continue
        if series.tag.role == "fan_speed" and _commanded(series, others, float(start[k]), float(end[k])):
            continue
        hours = (end[k] - start[k]) / 3600.0
        says = f"{series.tag.name} stood at {value[k]:g} {series.tag.unit} for {hours:.1f} h"
        found.append(Defect("stuck", (series.tag.name,), float(start[k]), float(end[k]), says, "left out"))
    if series.tag.role in ("fan_power", "fan_speed"):
        for k in np.flatnonzero(at_work & (held >= LEAST_S) & (last - first >= REPEATS)).tolist():
            span = float(start[k]), float(end[k])
            if not any(one.start_s == span[0] for one in found) and (moved := _against_the_fan(series, others, *span)):
                says = (
                    f"{series.tag.name} stood at {value[k]:g} {series.tag.unit} for {held[k] / 3600.0:.1f} h, {moved}"
                )
                found.append(Defect("stuck", (series.tag.name,), *span, says, "left out"))
    return found


def _contradicted(series: Series, value: float, others: Sequence[Series]) -> list[Defect]:
    """Return a constant tag as stuck over its whole span if a witness moved while it had its value."""
    start, end = float(series.time_s[0]), float(series.time_s[-1])
    for witness, other in _witnesses(series, others):
        at = np.clip(np.searchsorted(series.time_s, other.time_s, side="right") - 1, 0, len(series.time_s) - 2)
        during = (series.value[at] == value) & (series.value[at + 1] == value)
        during &= (other.time_s >= start) & (other.time_s <= end)
        low, high = _range(other.value[during])
        if _moved(witness, other, low, high):
            says = (
                f"{series.tag.name} stood at {value:g} {series.tag.unit} throughout, while {other.tag.name} moved from "
                f"{low:.4g} to {high:.4g} {other.tag.unit}"
            )
            return [Defect("stuck", (series.tag.name,), start, end, says, "left out")]
    return []


def _zero_at_work(series: Series, others: Sequence[Series]) -> list[Defect]:
    """Return the spans in which a flow is at rest while its cell's fan turns and the water cools as it usually does.

    A cell at rest has no flow, and its fan stands. Where the fan often turns without a flow, that is the cell's habit.
    A meter that sticks while its cell rests reads zero on after the start, and one that sticks at zero may do so until
    the cell rests: then the part of the span in which its fan turns counts.
    """
    spin = _of_cell(series, others, "fan_speed") or _of_cell(series, others, "fan_power")
    inlet, outlet = (_of_cell(series, others, f"water_{end}_temperature") for end in ("inlet", "outlet"))
    if series.tag.role != "water_flow" or spin is None or inlet is None or outlet is None:
        return []
    rest = np.abs(series.value) <= AT_REST * float(np.quantile(np.abs(series.value), 0.98))
    edge = np.diff(np.concatenate([[0], rest.astype(np.int8), [0]]))
    first, last = np.flatnonzero(edge == 1), np.flatnonzero(edge == -1) - 1
    long = series.time_s[last] - series.time_s[first] >= LEAST_S
    spans = [(float(series.time_s[a]), float(series.time_s[b])) for a, b in zip(first[long], last[long], strict=True)]

    def level(of: Series, at: Array) -> Array:
        return of.value[np.clip(np.searchsorted(of.time_s, at, side="right") - 1, 0, None)]

    turning = np.abs(spin.value) > SPUN * float(np.quantile(np.abs(spin.value), 0.98))
    fan = replace(spin, value=turning.astype(np.float64))

    def turns(at: Array) -> Array:
        """Return 1 where the fan turns; what it did in a silence of its interface is not known, and counts for none."""
        return np.nan_to_num(fan.at(at, 1.2 * longest_interval_s(fan)))

    work = series.time_s[~rest]
    usual = float(np.median(level(inlet, work) - level(outlet, work))) if len(work) else 0.0
    grids = [np.linspace(*span, 101) for span in spans]
    # Of a span that begins or ends with a rest, the part at work.
    parts = [_at_one_end(grid, turns(grid) > 0.5) for grid in grids]
    long_parts = [part is not None and part[1] - part[0] >= LEAST_S for part in parts]
    spans = [
        part if use and part is not None else span for span, part, use in zip(spans, parts, long_parts, strict=True)
    ]
    grids = [np.linspace(*span, 101) for span in spans]
    turned = [float(turns(grid).mean()) for grid in grids]
    cooled = [float(np.median(level(inlet, grid) - level(outlet, grid))) for grid in grids]
    wrong = [t >= WORKS and c >= COOLS * usual > 0.0 for t, c in zip(turned, cooled, strict=True)]
    if sum(t >= 0.5 for t, bad in zip(turned, wrong, strict=True) if not bad) >= REST_RUNS or sum(wrong) > MOST:
        return []
    tag = series.tag
    return [
        Defect(
            "stuck",
            (tag.name,),
            *span,
            f"{tag.name} stood at 0 {tag.unit} for {(span[1] - span[0]) / 3600.0:.1f} h, while its cell's fan turned "
            "and the water cooled as usual",
            "left out",
        )
        for span, bad in zip(spans, wrong, strict=True)
        if bad
    ]


def _at_one_end(grid_s: Array, turns: NDArray[np.bool_]) -> tuple[float, float] | None:
    """Return the part of a span at whose times (n,) a fan turns if that is one end of it, None otherwise."""
    change = np.flatnonzero(np.diff(turns.astype(np.int8)))
    if len(change) != 1:
        return None
    at = int(change[0])
    return (float(grid_s[0]), float(grid_s[at])) if turns[0] else (float(grid_s[at + 1]), float(grid_s[-1]))


def _of_cell(series: Series, others: Sequence[Series], role: str) -> Series | None:
    """Return the tag of a role of the same cell; None without one of some samples."""
    there = (one for one in others if one.tag.role == role and one.tag.cell == series.tag.cell)
    return next((one for one in there if len(one.time_s) >= 2), None)


def _against_the_fan(series: Series, others: Sequence[Series], start: float, end: float) -> str:
    """Return what moved while a fan's tag stood, if its command and its other tag did; else nothing.

    A command alone moves where a fan is run by hand. Power and speed of one fan have a law.
    """
    inside = [(witness, other, other.between(start, end)) for witness, other in _witnesses(series, others)]
    if {witness.role for witness, _, _ in inside} <= {_COMMAND.role}:
        return ""
    if not all(_moved(witness, other, *_range(part.value)) for witness, other, part in inside):
        return ""
    _, other, part = inside[-1]
    low, high = _range(part.value)
    return f"while {other.tag.name} moved from {low:.4g} to {high:.4g} {other.tag.unit}"


def _commanded(series: Series, others: Sequence[Series], start: float, end: float) -> bool:
    """Return whether the fan's command stood while its speed did: a drive that follows shows one number."""
    for witness, other in _witnesses(series, others):
        if witness is _COMMAND:
            grid = np.linspace(start, end, 101)
            held = other.value[np.maximum(np.searchsorted(other.time_s, grid, side="right") - 1, 0)]
            return not _moved(witness, other, *_range(held))
    return False


def _witnesses(series: Series, others: Sequence[Series]) -> list[tuple[Witness, Series]]:
    """Return the witnesses of a tag: those of its cell, and of the station."""
    return [
        (witness, other)
        for witness in WITNESSES.get(series.tag.role, ())
        for other in others
        if other.tag.role == witness.role
        and (series.tag.cell is None or other.tag.cell in (None, series.tag.cell))
        and len(other.time_s) >= 2
    ]


def _range(values: Array) -> tuple[float, float]:
    """Return the 5 % and 95 % quantiles, equal ones of no values."""
    return (float(np.quantile(values, 0.05)), float(np.quantile(values, 0.95))) if len(values) else (0.0, 0.0)


def _moved(witness: Witness, other: Series, low: float, high: float) -> bool:
    """Return whether a witness moved by the least that counts."""
    if witness.share:
        return high - low > witness.least * float(np.quantile(np.abs(other.value), 0.98))
    return unit_of(other.tag.unit).scale * (high - low) > witness.least


def _set_off(held: Array, at_work: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the runs that a step in the sorted lengths sets off from the others."""
    order = np.flatnonzero(at_work)
    order = order[np.argsort(held[order])[::-1]][: MOST + 1]
    lengths = np.append(held[order], 0.0)
    steps = [k for k in range(min(MOST, len(order))) if lengths[k] >= max(STEP * lengths[k + 1], LEAST_S)]
    return order[: steps[-1] + 1] if steps else order[:0]


def _runs(series: Series) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Return the first and the last row of each run of equal samples, and the time of the sample that ends it.

    A hole ends a run too, at its beginning.
    """
    time_s, value = series.time_s, series.value
    new = np.append(True, (np.diff(value) != 0.0) | series.broken())
    first = np.flatnonzero(new)
    last = np.append(first[1:] - 1, len(value) - 1)
    following = np.minimum(last + 1, len(value) - 1)
    cut = np.append(series.broken(), True)[last]
    return first, last, np.where(cut, time_s[last], time_s[following])


def _joined(
    series: Series, first: NDArray[np.int64], last: NDArray[np.int64], end: Array
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Return the runs with those joined that stand at one value for hours on either side of a hole."""
    held, value = series.time_s[last] - series.time_s[first], series.value[first]
    long = held >= LEAST_S
    same = (value[1:] == value[:-1]) & long[1:] & long[:-1]
    begin = np.flatnonzero(np.append(True, ~same))
    stop = np.append(begin[1:], len(first)) - 1
    return first[begin], last[stop], end[stop]


def _expected(time_s: Array, start: float, end: float) -> float:
    """Return the samples that the rates before and after a run let expect within it, by the smaller of the two."""
    edges = np.array([start - AROUND_S, start, end, end + AROUND_S])
    rows = np.searchsorted(time_s, edges, side="left")
    return float(min(rows[1] - rows[0], rows[3] - rows[2]) / AROUND_S * (end - start))


def _by_chance(
    series: Series, first: NDArray[np.int64], last: NDArray[np.int64], at_work: NDArray[np.bool_], k: int
) -> float:
    """Return the expected number of runs like run `k` in a healthy record.

    Samples that an exception brought differ by nature. So the share of repeats is that of samples which came late,
    after most of the longest interval; where there are few such, a fifth: noise of twice the resolution.
    """
    interval = np.diff(series.time_s)
    run = np.repeat(np.arange(len(first)), last - first + 1)
    late = (interval > 0.5 * longest_interval_s(series)) & at_work[run[1:]] & ~series.broken() & (run[1:] != k)
    same = run[1:] == run[:-1]
    repeats = last - first
    other = at_work & (np.arange(len(first)) != k)
    overall = (repeats[other].sum() + 1.0) / (repeats[other].sum() + other.sum() + 2.0)
    share = max(float(overall), float(((same & late).sum() + 0.6) / (late.sum() + 3.0)))
    return float(share ** repeats[k] * max(late.sum(), 5))


def _at_end(value: Array, k: int) -> bool:
    """Return whether the run is at the upper end of the tag's range, where it is seen in other runs too."""
    near = value >= 0.999 * value.max()
    return bool(near[k] and near.sum() > REST_RUNS + 1)


def _rests(value: Array, held: Array, k: int, top: float) -> bool:
    """Return whether the tag often stands at this value: in other long runs."""
    near = np.abs(value - value[k]) <= 0.002 * top
    near[k] = False
    return bool((held[near] >= max(0.5 * LEAST_S, 0.25 * held[k])).sum() >= REST_RUNS)
