"""Sites of an unknown quantity: heat at a node, a thermometer error, the flow, the fan, the room's reading.

Each is one quantity that is free in each block. Heat at a node needs no law. Flow, fan and room act through the laws of
the elements that they drive, so that their action on all nodes together is known.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from twin.discovery.diagnosis import Course, Effect
from twin.discovery.effects.laws import CandidateLaw, circuit_of
from twin.discovery.records.grid import Grid
from twin.discovery.scoring.score_tests import ScoreTest
from twin.elements.candidates import Candidate
from twin.elements.empirical_heat import MOST_HEAT_W
from twin.network import Array, Network

Signature = Literal["energy", "transport", "sensor"]
SIGNATURES: tuple[Signature, ...] = ("energy", "transport", "sensor")
SPOKEN = {
    "energy": "heat that enters or leaves",
    "transport": "water that flows otherwise",
    "sensor": "a reading in error",
}
TYPICAL_W, TYPICAL_K = 20.0, 0.2
"""Typical sizes of an unknown heat, W, and of an unknown reading error, K, as of the catalogue's constant ones."""
RARER = 0.95
"""Share of its evidence that counts of an error of the room's thermometer, which imitates nearly all unlisted errors of
a radiator, and of a flow that passes a place, which imitates those of its thermometer: both are rarer."""
_DRIVERS = {"heater_power_W": "heater_power", "pump_speed_pct": "pump_speed", "fan_speed_pct": "fan_speed"}


@dataclass(frozen=True)
class Site:
    """Site of an unknown quantity: `vector` (sites, b) of one unit, a typical size, its kind of fault and its place in
    the diagnosis's vocabulary, and the sizes that it can hold.

    `counts` is the share of its evidence that counts, so that a site of higher prior wins if it is nearly as good.
    `present` is what the twin's own element has of the quantity, such as its conductance; 0 where no element has any.
    """

    vector: Array
    typical: float
    unit: str
    signature: Signature
    kind: str
    where: str
    counts: float = 1.0
    holds: tuple[float, float] = (-math.inf, math.inf)
    present: float = 0.0


def sites_of(network: Network, score_test: ScoreTest, laws: Sequence[CandidateLaw]) -> dict[str, Site]:
    """Return the sites of an unknown quantity by name; flows, fan and room only if the twin has a law for them."""
    anything = (-math.inf, math.inf)
    errors = [c for law in laws if (c := law.candidate).kind == "sensor" and c.driver == "constant"]
    held = {c.where: (c.lower, c.upper) for c in errors}
    out: dict[str, Site] = {}
    for k, node in enumerate(network.nodes):
        p = np.zeros((score_test.sites, score_test.b))
        p[k] = 1.0
        out[node] = Site(p, TYPICAL_W, "W", "energy", "heat_source", node, holds=(-MOST_HEAT_W, MOST_HEAT_W))
    for j, name in enumerate(network.sensor_names):
        p = np.zeros((score_test.sites, score_test.b))
        p[score_test.k + j] = 1.0
        out[name] = Site(p, TYPICAL_K, "K", "sensor", "sensor", name, holds=held.get(name, anything))
    for law in laws:
        c = law.candidate
        if c.driver != "constant":
            continue
        circuit, passes = circuit_of(network, c), c.kind == "flow" and c.where in network.nodes
        kind: tuple[str, Signature] | None = None
        if circuit:
            kind = ("flow" if c.where == "loop" else c.where, "transport")
        elif passes:
            kind = (f"flow past {c.where}", "transport")
        elif c.kind == "heat_rejection" and c.change == "existing":
            kind = ("rejection", "energy")
        elif c.kind == "sensor" and c.where in network.input_columns:
            kind = (c.where, "sensor")
        if kind is not None and kind[0] not in out:
            counts = RARER if kind[1] == "sensor" or passes else 1.0
            # The linear estimate of a large change of a circuit's flow overshoots: readings go with its inverse.
            vector, holds = score_test.vector(law), anything if circuit else (c.lower, c.upper)
            present = 0.0 if kind[1] == "sensor" or c.change == "new" else _present(network, c)
            present = max(present, 1.0) if passes else present  # all of the flow
            out[kind[0]] = Site(vector, c.typical, c.unit, kind[1], c.kind, c.where, counts, holds, present)
    return out


def _present(network: Network, candidate: Candidate) -> float:
    """Return the present value of the one parameter that a candidate changes, in its unit; 0 if it changes several."""
    if len(candidate.changes) != 1:
        return 0.0
    ((name, weight),) = candidate.changes.items()
    return abs(network.parameters[name].value / weight)


def heaters_of(network: Network, score_test: ScoreTest, laws: Sequence[CandidateLaw]) -> dict[str, Site]:
    """Return the heaters' actuators as sites of an unknown gain by name: an unknown share of the commanded power."""
    gains = [law for law in laws if (c := law.candidate).kind == "actuator" and c.driver == "constant"]
    return {
        c.where: Site(score_test.vector(law), c.typical, c.unit, "energy", c.kind, c.where, holds=(c.lower, c.upper))
        for law in gains
        if f"{(c := law.candidate).where}_W" in network.input_columns
    }


def drivers_of(network: Network, grid: Grid, score_test: ScoreTest) -> dict[str, Array]:
    """Return the block means (b,) of the drivers that an unknown may follow, by name."""
    means = score_test.block_means(grid.inputs)
    out = {driver_name(column): means[:, j] for j, column in enumerate(network.input_columns)}
    out["elapsed_time"] = score_test.hours
    return out


def driver_name(column: str) -> str:
    """Return an input column, or a node, as a driver in the diagnosis's vocabulary."""
    return _DRIVERS.get(column, "temperature" if column.endswith("_C") else column)


def signatures(found: tuple[Course, ...]) -> dict[str, Any]:
    """Return the physical types of the unknown: the best course of each, and the log evidence that the others lack."""
    best: dict[str, Course] = {}
    for course in found:
        best[course.signature] = max(course, best.get(course.signature, course), key=lambda c: c.log_evidence)
    if not best:
        return {}
    first = max(best.values(), key=lambda c: c.log_evidence)
    rest = [c for c in best.values() if c is not first]
    behind = {c.signature: round(first.log_evidence - c.log_evidence, 1) for c in rest}
    return {"signature": first.signature, "behind": behind, "there": {c.signature: c.where for c in rest}}


def spoken(description: dict[str, Any]) -> str:
    """Return the physical type in words, with the others that it was compared with."""
    first = description.get("signature")
    if first is None:
        return ""
    behind = description.get("behind", {})
    there = description.get("there", {})
    rest = " and ".join(f"as {SPOKEN[s]}{_at(there.get(s, ''))} by {value:.0f}" for s, value in behind.items())
    clear = all(value > 5.0 for value in behind.values())
    verb = "It is like" if clear else "It is most like"
    return f" {verb} {SPOKEN[first]}; {rest} worse in log evidence." if rest else ""


def unknown(found: tuple[Course, ...], description: dict[str, Any], start: float) -> tuple[Effect, ...]:
    """Return the unknown at its likeliest site as an effect of kind `unknown`."""
    if not found or not description:
        return ()
    best = found[0]
    low, high = description["range"]
    first_s, last_s = description["onset_interval_s"]
    second = found[1].log_evidence if len(found) > 1 else best.log_evidence - 100.0
    return (
        Effect(
            kind="unknown",
            where=best.where or best.site,
            driver=str(description["driver"]),
            change="new",
            value=float(description["mean"]),
            unit=best.unit,
            interval90=(float(low), float(high)),
            onset_s=start + float(description["onset_s"]),
            onset_interval90_s=(start + float(first_s), start + float(last_s)),
            shape="unknown",
            confidence=float(1.0 / (1.0 + math.exp(min(max(second - best.log_evidence, -50.0), 50.0) / 10.0))),
            z=float(np.sqrt(max(best.log_evidence, 0.0) * 2.0)),
            evidence=f"an unknown at {best.site} explains the record better than at any other place",
        ),
    )


def _at(where: str) -> str:
    return f" at {where}" if where else ""
