"""Detectability and isolability: the smallest detectable effect of each kind in a record, and pairs that it does not
isolate.

No reading is needed: signatures follow from the inputs and the twin's response to them. The condition number of the
tunables is no measure of this; the correlations of pairs are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin.discovery.effects.laws import CandidateLaw
from twin.discovery.effects.probe import Probe
from twin.discovery.healthy.basis import Basis
from twin.discovery.records.grid import Grid
from twin.discovery.scoring.null import FALSE_ALARMS, null_scores
from twin.discovery.scoring.score_tests import ScoreTest
from twin.elements.candidates import Candidate
from twin.network import Array, Network

CONFUSED = 0.98
"""Correlation of two signatures from which a record cannot separate two large effects."""
CLEAR = 6.0
"""Score at which an effect is detectable on any record."""
LARGE = 5.0
"""Size of a large effect, in typical sizes, which should be detectable."""
MOST_HIDDEN = 0.4
"""Mean share, over the kinds, of undetectable entries up to which a record may be called adequate."""
STILL = 0.02
"""Relative variation up to which an input counts as constant."""


@dataclass(frozen=True)
class Seen:
    """Detectability of one candidate, present from the beginning: its least detectable size, and the share of its
    signature that is orthogonal to the tunables.
    """

    candidate: Candidate
    least: float
    kept: float


@dataclass(frozen=True)
class Forecast:
    """Candidates by detectability, and pairs (a, b, correlation) with similar signatures."""

    seen: tuple[Seen, ...]
    unseen: tuple[Candidate, ...]
    confused: tuple[tuple[Candidate, Candidate, float], ...]


def plan_of(network: Network, time: Array, inputs: Array) -> Grid:
    """Return a planned record in bins of ten seconds: time (n,) s evenly spaced, inputs (n, c), no readings."""
    step = float(time[1] - time[0])
    return Grid(time, inputs, np.full((len(time), len(network.sensors)), np.nan), network.sigma / np.sqrt(step), step)


def planned(probe: Probe, grid: Grid, state: Array | None = None) -> tuple[Grid, Array]:
    """Return the grid with simulated instead of measured readings, and its initial state."""
    start = probe.probed_state(grid) if state is None else state
    return replace(grid, measured=probe.run(grid, start).readings), start


def forecast(known: Basis, grid: Grid, state: Array | None = None) -> Forecast:
    """Return detectability and isolability for the inputs of a grid.

    Args:
        grid: its readings are not used. state: initial temperatures (k,); by default from the grid's readings.
    """
    own, start = planned(known.probe, grid, state)
    run = known.probe.run(own, start)
    found, candidates = known.book.laws(own, run), known.book.candidates
    score_test = known.score_test(own, start, run, found)
    vectors = np.stack([score_test.vector(law) for law in found])
    flat = vectors.reshape(len(found), -1)
    gram, _ = score_test.joint(vectors)
    norm = np.sqrt(np.maximum(np.diag(gram), 0.0))
    bare = np.sqrt(np.maximum(score_test.bare(flat), 1e-30))
    threshold = null_scores(score_test, found).quantile(FALSE_ALARMS)
    here = {law.candidate.id for law in found}
    seen, unseen = [], [c for c in candidates if c.id not in here]
    for law, n, b in zip(found, norm, bare, strict=True):
        c = law.candidate
        least = threshold / n if n > 0.0 else np.inf
        if least > max(abs(c.lower), abs(c.upper)):
            unseen.append(c)
        else:
            seen.append(Seen(c, float(least), float(n / b)))
    seen.sort(key=lambda s: s.least / s.candidate.typical)
    confused = []
    for i in range(len(found)):
        for j in range(i + 1, len(found)):
            if norm[i] > 0.0 and norm[j] > 0.0:
                rho = float(gram[i, j] / (norm[i] * norm[j]))
                a, b = found[i].candidate, found[j].candidate
                if abs(rho) > CONFUSED and (a.kind, a.where, a.driver) != (b.kind, b.where, b.driver):
                    confused.append((a, b, rho))
    confused.sort(key=lambda x: -abs(x[2]))
    return Forecast(tuple(seen), tuple(unseen), tuple(confused))


def too_little(score_test: ScoreTest, found: list[CandidateLaw], candidates: tuple[Candidate, ...]) -> tuple[str, ...]:
    """Return the kinds of effect that a record could not show; none if they are few."""
    share = hidden(score_test, found, candidates)
    if sum(share.values()) < MOST_HIDDEN * len(share):
        return ()
    return tuple(spoken(kind) for kind, missing in share.items() if missing > 0.5)


def too_still(score_test: ScoreTest, kinds: tuple[str, ...]) -> str:
    """Return a sentence with the reason why a record could not show these kinds."""
    network, inputs = score_test.probe.network, score_test.grid.inputs
    still = [
        f"{column} stays at {inputs[0, j]:.4g}"
        for j, column in enumerate(network.input_columns)
        if np.ptp(inputs[:, j]) < STILL * max(abs(float(inputs[0, j])), 1.0)
    ]
    why = f" ({', '.join(still)})" if still else ""
    return (
        f"the record has too little excitation to say anything{why}: it shows no effect, and could not have shown "
        f"{either(kinds)}; run a load profile with steps in {_driven(network)}"
    )


def _driven(network: Network) -> str:
    """Return the inputs of a rig that can be stepped, as a phrase."""
    columns = [c for c in network.input_columns if not c.endswith("_C") and not c.startswith("time_of_day")]
    short = {"heater_power_W": "load", "pump_speed_pct": "pump", "fan_speed_pct": "fan"}
    words = [short.get(c, c) for c in columns] or ["what drives it"]
    return " and ".join(filter(None, (", ".join(words[:-1]), words[-1])))


def either(kinds: tuple[str, ...]) -> str:
    """Return kinds as a phrase, joined by `or`."""
    return " or ".join(filter(None, (", ".join(kinds[:-1]), kinds[-1])))


def unseen_kinds(
    score_test: ScoreTest, found: list[CandidateLaw], candidates: tuple[Candidate, ...]
) -> tuple[str, ...]:
    """Return the kinds of effect that are undetectable in a record even if large."""
    share = hidden(score_test, found, candidates)
    return tuple(spoken(kind) for kind, missing in share.items() if missing > 0.99)


def spoken(kind: str) -> str:
    """Return a kind of effect in words."""
    return {"coupling": "coupling (heat exchange between two places)"}.get(kind, kind.replace("_", " "))


def hidden(score_test: ScoreTest, found: list[CandidateLaw], candidates: tuple[Candidate, ...]) -> dict[str, float]:
    """Return the share of each kind's entries (by place) that are undetectable from the start even if large."""
    found = [law for law in found if not law.candidate.begins]
    visible = {
        (law.candidate.kind, law.candidate.where)
        for law, norm in zip(found, _norms(score_test, found), strict=True)
        if norm * LARGE * law.candidate.typical > CLEAR
    }
    every: dict[str, set[str]] = {}
    for c in candidates:
        every.setdefault(c.kind, set()).add(c.where)
    return {kind: 1.0 - sum((kind, w) in visible for w in places) / len(places) for kind, places in every.items()}


def _norms(score_test: ScoreTest, found: list[CandidateLaw]) -> Array:
    gram, _ = score_test.joint(np.stack([score_test.vector(law) for law in found]))
    norms: Array = np.sqrt(np.maximum(np.diag(gram), 0.0))
    return norms
