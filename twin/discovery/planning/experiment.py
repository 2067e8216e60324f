"""Next experiment for an ambiguity group, or the further measurement if no input isolates its causes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.discovery.planning.design import Designed, Designer, Levels, Runner, Surroundings, informed
from twin.discovery.records.grid import Grid
from twin.discovery.scoring.equivalence import SHARE, open_questions, width
from twin.discovery.scoring.search import Entry
from twin.network import Array, Network

if TYPE_CHECKING:
    from twin.discovery.evidence.finding import Finding, Ranked
    from twin.discovery.healthy.basis import Basis

MARGIN_K = 3.0
"""Margin, K, of a planned reading below an alarm limit, or above the hottest reading so far if there is no limit."""
BEYOND = 0.25
"""Share of the tried input range by which a plan may exceed it. Far outside the loads of its commissioning a twin's
model error exceeds the difference of the causes."""
LEAST_RANGE = {"W": (0.5, 1.1), "pct": (0.7, 1.2)}
"""Range of a constant column, in multiples of its value, by its unit."""
LEAST_PERCENT = 30.0
"""Least planned speed of a pump or fan, %, unless it has been slower before."""
MOST_CAUSES = 8
"""Causes that an experiment is planned for, the likeliest ones: their pairs are compared one by one."""
SETTLED = 1.5
"""Multiple of the equivalence width that a planned record must add to exclude a wrong cause."""
WIDEN = 4.0
"""Factor on the variances of tunables and sizes that a later record gives, as for commissioning."""
OWN_ERROR = 200.0
"""Expected difference beyond the deciding one up to which a plan is lengthened: under new loads model error has that
size."""


@dataclass(frozen=True)
class Limits:
    """Limits of a rig: (low, high) of each driven input column, in the column's unit, and the highest permitted
    reading.

    The highest reading of any thermometer is in degC, or NaN if it is not declared; `rig` is the rig's name.
    """

    driven: Mapping[str, tuple[float, float]]
    hottest_C: float
    rig: str = ""


def levels_of(
    network: Network, grid: Grid, tried: Array, limits: Limits | None = None, later: tuple[Grid, ...] = ()
) -> Levels:
    """Return low, middle and high levels of all driven inputs, about the tried range and within the limits.

    Args:
        tried: (2, c) lowest and highest inputs of the record that the twin was commissioned on. later: records made
            since.
    """
    ranges = np.array([np.percentile(g.inputs, (2.0, 98.0), axis=0) for g in (grid, *later)])
    driven: dict[str, tuple[float, ...]] = {}
    for j, column in enumerate(network.input_columns):
        unit = column.rsplit("_", 1)[-1]
        known = column in limits.driven if limits is not None else column.startswith(("heater", "pump", "fan"))
        if not known or unit not in LEAST_RANGE:
            continue
        seen = (float(min(ranges[:, 0, j].min(), tried[0, j])), float(max(ranges[:, 1, j].max(), tried[1, j])))
        beyond = BEYOND * (seen[1] - seen[0])
        low, high = (seen[k] * LEAST_RANGE[unit][k] for k in (0, 1))
        low, high = min(seen[0] - beyond, low), max(seen[1] + beyond, high)
        if seen[1] - seen[0] > 0.2 * seen[1]:
            low, high = seen[0] - beyond, seen[1] + beyond
        if unit == "pct":
            low, high = max(low, min(LEAST_PERCENT, seen[0])), min(high, 100.0)
        if limits is not None:
            low, high = max(low, limits.driven[column][0]), min(high, limits.driven[column][1])
        else:
            low, high = max(low, network.inputs[column].lower), min(high, seen[1])
        if high > low:
            driven[column] = tuple(float(f"{x:.3g}") for x in (low, 0.5 * (low + high), high))
    hottest = max(float(np.nanmax(g.measured)) for g in (grid, *later)) + MARGIN_K
    if limits is not None and np.isfinite(limits.hottest_C):
        hottest = limits.hottest_C - MARGIN_K
    return Levels(driven, hottest)


def plan(
    finding: Finding,
    known: Basis,
    grid: Grid,
    limits: Limits | None = None,
    ambiguous: bool = True,
    later: tuple[Grid, ...] = (),
) -> dict[str, Any] | None:
    """Return the next experiment as in the contract of `diagnosis.json`; None if the answer is unambiguous.

    Args:
        later: records made since. The plan continues from the last one's end, with its information about tunables and
            sizes, and asks only for the difference that is still missing.
    """
    causes = open_questions(finding, ambiguous)[:MOST_CAUSES]
    if not causes:
        return None
    levels = levels_of(known.probe.network, grid, known.tried, limits, later)
    names = [said(r.entries[-1]) for r in causes]
    if not levels.driven:
        return _impossible(causes, "this rig drives nothing that the twin knows of")
    designer = _designer(finding, known, (grid, *later), levels, causes)
    groups = alike(designer.shuffled())
    if len(groups) == 1:
        return _impossible(causes, "no sequence of load, pump and fan separates them")
    pairs = [(g[0], h[0]) for i, g in enumerate(groups) for h in groups[i + 1 :]]
    gain = max(finding.start - causes[0].fit.total, 0.0)
    best = designer.greedy(pairs, SETTLED * width(gain) + OWN_ERROR, SETTLED * SHARE)
    if best.hottest_C > levels.hottest_C:
        return _impossible(
            causes,
            f"nothing is planned, since no load, pump and fan keep every reading below {levels.hottest_C:.0f} degC "
            "from where this record ends, to separate",
        )
    need = SETTLED * (width(gain) + SHARE * float(best.gains.max()))
    if not any(_least(best, a, b) > need for a, b in pairs):
        return _impossible(causes, "no sequence of load, pump and fan within the limits separates them enough")
    told = [pair for pair in _all_pairs(groups) if _least(best, *pair) > need]
    left = _together(told, len(names))
    spoken = [names[g[0]] if len(g) == 1 else f"({_listed([names[i] for i in g], 'or')})" for g in left]
    what = f"{_listed(spoken)} apart" if len(left) > 1 else _listed([f"{names[a]} from {names[b]}" for a, b in told])
    least = min(_least(best, *pair) for pair in told)
    hours = len(best.levels) * designer.segment_s / 3600.0
    driven = [_spoken(c) for c in levels.driven]
    why = (
        f"{hours:g} h of steps in {_listed(driven)} tell {what}: at least {least:.0f} in weighted squares is expected "
        f"where {need:.0f} decide; no reading above {best.hottest_C:.0f} degC"
    )
    alike_still = [g for g in left if len(g) > 1]
    return {
        "possible": True,
        "name": f"steps in {_listed(driven)}",
        "why": why,
        "causes": names,
        "expected_difference": least,
        "needed_difference": need,
        "hottest_C": best.hottest_C,
        "hours": hours,
        "steps": _steps(best, designer.segment_s),
        "stay_alike": [_listed([names[i] for i in g]) for g in alike_still],
        "measure": _measures([causes[i] for g in alike_still for i in g]),
    }


def _designer(
    finding: Finding, known: Basis, grids: tuple[Grid, ...], levels: Levels, causes: tuple[Ranked, ...]
) -> Designer:
    """Return the designer of an experiment that goes on from the last record, with the information of later ones."""
    probe, last = known.probe, grids[-1]
    span = finding.score_test.grid.span_s

    def runners(state: Array) -> list[Runner]:
        found = []
        for r in causes:
            sizes: Array = np.array([e.size * e.shape.mean(span - 1.0, span) for e in r.entries])
            found.append(Runner(probe, r.fit, sizes, known.prior, state))
        return found

    base = np.median(last.inputs, axis=0)
    for j, column in enumerate(probe.network.input_columns):
        if column.startswith("time_of_day"):
            base[j] = last.inputs[-1, j]
    around = Surroundings(probe.network.input_columns, base, last.step_s)
    costs = np.array([r.cost for r in causes])
    apart = costs[None, :] - costs[:, None] if len(grids) > 1 else None
    going_on = runners(probe.network.initial_state(last.measured[-30:]))
    for later in grids[1:]:
        for runner, begun in zip(going_on, runners(probe.network.initial_state(later.measured[:30])), strict=True):
            runner.learn(informed(begun, later, known.noise) / np.sqrt(WIDEN))
    return Designer(going_on, around, levels, known.noise, apart)


def _least(best: Designed, a: int, b: int) -> float:
    """Return the smaller expected difference of two hypotheses, whichever is true."""
    return float(min(best.differences[a, b], best.differences[b, a]))


def _all_pairs(groups: list[list[int]]) -> list[tuple[int, int]]:
    """Return every two hypotheses of different groups, the lower number first."""
    return [(min(a, b), max(a, b)) for i, g in enumerate(groups) for h in groups[i + 1 :] for a in g for b in h]


def alike(rich: Designed) -> list[list[int]]:
    """Return the ambiguity groups that remain even under random levels, the best hypothesis of each first."""
    count = len(rich.gains)
    groups: list[list[int]] = []
    for i in range(count):
        for group in groups:
            first = group[0]
            least = min(rich.differences[i, first], rich.differences[first, i])
            if least < SHARE * max(rich.gains[i], rich.gains[first]):
                group.append(i)
                break
        else:
            groups.append([i])
    return groups


def _together(told: list[tuple[int, int]], count: int) -> list[list[int]]:
    """Return the groups of hypotheses that remain connected without the isolated pairs `told`."""
    groups: list[list[int]] = []
    for i in range(count):
        near = [g for g in groups if any((k, i) not in told for k in g)]
        groups = [g for g in groups if g not in near] + [sorted([i, *(k for g in near for k in g)])]
    return sorted(groups)


def _steps(best: Designed, segment_s: float) -> list[dict[str, float]]:
    """Return the rows of a load profile: time and levels at each change, and the end."""
    rows: list[dict[str, float]] = []
    for number, levels in enumerate(best.levels):
        if not rows or any(rows[-1][c] != v for c, v in levels.items()):
            rows.append({"time_s": number * segment_s, **levels})
    return [*rows, {**rows[-1], "time_s": len(best.levels) * segment_s}]


def _impossible(causes: tuple[Ranked, ...], why: str) -> dict[str, Any]:
    names = [said(r.entries[-1]) for r in causes]
    measures = _measures(list(causes))
    return {
        "possible": False,
        "why": f"{why}: {_listed(names)}; {_listed(measures, 'or')} would",
        "causes": names,
        "measure": measures,
    }


FLOW_MEASURED = "the flow by bucket and stopwatch"
_MEASURE = {
    ("actuator", "heater_power"): "a second power meter at the heater",
    ("actuator", "pump_speed"): FLOW_MEASURED,
    ("actuator", "fan_speed"): "the fan's speed by a tachometer",
    ("sensor", "T_ambient"): "a second thermometer in the air that the radiator draws in",
    ("sensor", ""): "the thermometer swapped with another, or held into the same bath",
    ("flow", ""): FLOW_MEASURED,
    ("heat_rejection", ""): "the air's temperature before and behind the radiator",
    ("heat_source", ""): "a power meter at whatever may give off heat there",
    ("heat_loss", ""): "the place wrapped in insulation for an hour",
    ("coupling", ""): "the heat bridge cut or insulated for an hour",
    ("thermal_mass", ""): "the water drained and weighed",
    ("delay", ""): "the hoses' inner volume measured",
}


def _measures(causes: list[Ranked]) -> list[str]:
    """Return further measurements that would isolate the causes, one for each."""
    found = []
    for r in causes:
        c = r.entries[-1].candidate
        keys = [(c.kind, where) for where in ("heater_power", "pump_speed", "fan_speed", "T_ambient")]
        key = next((k for k in keys if k in _MEASURE and c.where.startswith(k[1])), (c.kind, ""))
        found.append(_MEASURE.get(key, f"{c.where} measured by other means"))
    return list(dict.fromkeys(found))


def said(entry: Entry) -> str:
    """Return an effect by kind, place and driver."""
    kind, where, driver = (x.replace("_", " ") for x in entry.label)
    return f"{kind} at {where} ({driver})"


def _spoken(column: str) -> str:
    return column.rsplit("_", 1)[0].replace("_", " ")


def _listed(names: list[str], last: str = "and") -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} {last} {names[-1]}" if names else ""
