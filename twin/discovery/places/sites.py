"""Places where an unknown may act: heat at a node, an error of a thermometer, the flow, the fan, the room's reading.

Each is one quantity free to change from block to block. Heat at a node needs no law; the flow, the fan and the room act
through the laws of the elements that they drive, so that what they do to all nodes at once is known.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from twin.discovery.diagnosis import Course, Effect
from twin.discovery.effects.laws import CandidateLaw
from twin.discovery.records.grid import Grid
from twin.discovery.scoring.score_tests import ScoreTest
from twin.network import Array, Network

Signature = Literal["energy", "transport", "sensor"]
SIGNATURES: tuple[Signature, ...] = ("energy", "transport", "sensor")
SPOKEN = {
    "energy": "heat that enters or leaves",
    "transport": "water that flows otherwise",
    "sensor": "a reading in error",
}
TYPICAL_W, TYPICAL_K = 20.0, 0.2
ROOM = 0.95
"""An error of the room's thermometer, free from block to block, does nearly all that a radiator can do in a way that no
catalogue knows, and is rarer."""
_DRIVERS = {"heater_power_W": "heater_power", "pump_speed_pct": "pump_speed", "fan_speed_pct": "fan_speed"}


@dataclass(frozen=True)
class Site:
    """A place of an unknown: `vector` (sites, b) of one unit, a typical size, where it is in a diagnosis's words.

    `counts` is the share of its evidence that counts, as what is likelier beforehand is told if it is nearly as good.
    """

    vector: Array
    typical: float
    unit: str
    signature: Signature
    where: str
    counts: float = 1.0


def sites_of(network: Network, score_test: ScoreTest, laws: list[CandidateLaw]) -> dict[str, Site]:
    """Every place of an unknown by name; flow, fan and room only where the twin has a law for them."""
    out: dict[str, Site] = {}
    for k, node in enumerate(network.nodes):
        p = np.zeros((score_test.sites, score_test.b))
        p[k] = 1.0
        out[node] = Site(p, TYPICAL_W, "W", "energy", node)
    for j, name in enumerate(network.sensor_names):
        p = np.zeros((score_test.sites, score_test.b))
        p[score_test.k + j] = 1.0
        out[name] = Site(p, TYPICAL_K, "K", "sensor", name)
    for law in laws:
        c = law.candidate
        if c.driver != "constant":
            continue
        kind: tuple[str, Signature] | None = None
        if c.kind == "flow" and c.where == "loop":
            kind = ("flow", "transport")
        elif c.kind == "heat_rejection" and c.change == "existing":
            kind = ("rejection", "energy")
        elif c.kind == "sensor" and c.where in network.input_columns:
            kind = (c.where, "sensor")
        if kind is not None and kind[0] not in out:
            counts = ROOM if kind[1] == "sensor" else 1.0
            out[kind[0]] = Site(score_test.vector(law), c.typical, c.unit, kind[1], c.where, counts)
    return out


def drivers_of(network: Network, grid: Grid, score_test: ScoreTest) -> dict[str, Array]:
    """Block means (b,) of what an unknown may follow, by the name of the driver."""
    means = score_test.block_means(grid.inputs)
    out = {
        _DRIVERS.get(column, "temperature" if column.endswith("_C") else column): means[:, j]
        for j, column in enumerate(network.input_columns)
    }
    out["elapsed_time"] = score_test.hours
    return out


def signatures(found: tuple[Course, ...]) -> dict[str, Any]:
    """What kind of thing the unknown is like: the best of each signature, and how far the others are behind, in
    logarithms of evidence."""
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
    """The signature in words, and against which others."""
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
    """The unknown at its likeliest place as an effect of kind `unknown`."""
    if not found or not description:
        return ()
    best = found[0]
    low, high = description["range"]
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
            onset_interval90_s=(start + float(description["onset_s"]),) * 2,
            shape="unknown",
            confidence=float(1.0 / (1.0 + math.exp(min(max(second - best.log_evidence, -50.0), 50.0) / 10.0))),
            z=float(np.sqrt(max(best.log_evidence, 0.0) * 2.0)),
            evidence=f"an unknown at {best.site} explains the record better than at any other place",
        ),
    )


def _at(where: str) -> str:
    return f" at {where}" if where else ""
