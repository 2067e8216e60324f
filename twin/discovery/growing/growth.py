"""A twin that grows: which effects are missing from a record, when there is no healthy one to compare with.

Where several effects are missing, the best single one is often none of them. So sets of effects are built up in a beam:
each of the best sets so far is fitted with each of the effects that could take most of what it leaves, and the fitted
sets are compared. The set that is kept is the one that the record asks for, by the likelihood with every hypothesis
given the noise that suits it best (`likelihood`); then each member must earn its place, against the set without it,
in the likelihood and on parts of the record that the fit was not shown. Effects are there from the beginning; what
comes in later is for `engine.diagnose`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from twin.discovery.diagnosis import Fold
from twin.discovery.effects.ambiguity_groups import EffectLabel
from twin.discovery.effects.phrases import interval
from twin.discovery.growing.beam import BEAM, Beam, FittedSet, by_score
from twin.discovery.growing.growth_problem import GrowthFit, GrowthProblem, SampledRecord
from twin.discovery.growing.merit import LEFT, Merit, RejectedEffect
from twin.discovery.growing.superset.candidate_superset import CandidateSuperset, name_of
from twin.discovery.records.grid import bridged, on_grid
from twin.discovery.scoring.equivalence import width
from twin.discovery.scoring.search import Entry
from twin.gauss_newton import SE90
from twin.kernel import clean_time
from twin.network import Array, Network, TwinFileError

MOST_EFFECTS = 4
MOST_SAMPLES = 4000
CHANCE = 3.0
"""Standard deviations of a mean square that count as chance."""
FEWEST, FEWEST_SAMPLES = 12, 40
"""Steady states, and samples of a record, that a twin can grow from."""


@dataclass(frozen=True)
class Added:
    """One effect of the ladder, in the vocabulary of a diagnosis.

    Attributes:
        value, interval90: its size beside all the others, in `unit`. says: in words.
        gain: fall of -2 log likelihood that it brings on its rung. needed: rise of it when the full set goes without.
        elsewhere: the same of the further records, which were not fitted.
        folds, foretold: hidden parts of the record that the full set foretells no worse with it, and its squares there
            over those without it. others: labels (kind, where, driver) that the record cannot tell from it, and by how
            much worse, in -2 log likelihood, their sets are. by_chance: probability that noise alone needs any effect
            as much; `limit` is what it reaches in one of a hundred.
        entry: the effect as it was fitted.
    """

    kind: str
    where: str
    driver: str
    value: float
    interval90: tuple[float, float]
    unit: str
    says: str
    gain: float
    needed: float
    elsewhere: float
    folds: int
    foretold: float
    others: dict[EffectLabel, float]
    by_chance: float
    limit: float
    entry: Entry


@dataclass(frozen=True)
class GrowthRung:
    """A twin on the way: `network` with its effects, fitted; RMSE per sensor `rms` (m,), K; the first adds nothing."""

    network: Network
    added: Added | None
    rms: Array
    fit: GrowthFit


@dataclass(frozen=True)
class Growth:
    """The ladder. `verdict`: whether what the last rung leaves is the thermometers' noise.

    `problem` is that of the last rung. `folds`: parts of the record hidden from the fit in turn, and what all effects
    together gain there.
    """

    rungs: tuple[GrowthRung, ...]
    verdict: Literal["adequate", "unexplained"]
    summary: str
    refused: tuple[RejectedEffect, ...]
    problem: GrowthProblem
    folds: tuple[Fold, ...]

    @property
    def network(self) -> Network:
        """The twin of the last rung."""
        return self.rungs[-1].network


def grow(
    network: Network,
    time_s: ArrayLike,
    inputs: ArrayLike,
    measured: ArrayLike,
    *,
    more: tuple[tuple[ArrayLike, ArrayLike, ArrayLike], ...] = (),
    most: int = MOST_EFFECTS,
    beam: int = BEAM,
    say: Callable[[str], None] = lambda _: None,
) -> Growth:
    """Add effects to a twin until the record asks for no more.

    Args:
        network: with tunables. inputs: (N, c). measured: (N, m) degC, NaN left out.
        more: further records (time, inputs, measured), by which sets are weighed that this one cannot tell apart.
        most: effects that may be added.
        beam: sets that each round builds on. say: called with what is being done.

    Raises:
        TwinFileError: a record too short or without readings, a twin without tunables.
    """
    return grow_samples(network, samples_of(network, time_s, inputs, measured), more, most=most, beam=beam, say=say)


def grow_at_rest(
    network: Network,
    inputs: ArrayLike,
    measured: ArrayLike,
    *,
    most: int = MOST_EFFECTS,
    beam: int = BEAM,
    say: Callable[[str], None] = lambda _: None,
) -> Growth:
    """As `grow`, for steady states: each row of `inputs` (n, c) and `measured` (n, m) is one, and no time passes.

    Raises:
        TwinFileError: fewer than `FEWEST` states with a reading, a twin without tunables.
    """
    return grow_samples(network, states_of(network, inputs, measured), most=most, beam=beam, say=say)


def grow_samples(
    network: Network,
    samples: SampledRecord,
    more: tuple[tuple[ArrayLike, ArrayLike, ArrayLike], ...] = (),
    *,
    most: int = MOST_EFFECTS,
    beam: int = BEAM,
    say: Callable[[str], None] = lambda _: None,
) -> Growth:
    """As `grow`, for a record or states that have been made ready."""
    ids = network.tunables("commission" if "commission" in network.sets else None)
    if not ids:
        raise TwinFileError(f"twin {network.name!r} has no tunables; set the status of at least one parameter")
    say("fitting the twin as it is")
    superset = CandidateSuperset.of(
        network, ids, float(np.median(np.diff(samples.time))), samples.span_s, samples.at_rest
    )
    search = Beam(GrowthProblem(superset, samples, ids), beam)
    for effects in range(1, most + 1):
        say(f"looking for {effects} effects that are missing")
        if not search.deepen():
            break
    say("asking each of them whether it is needed")
    merit = Merit(search)
    best = merit.reranked(merit.earned(), tuple(samples_of(network, *one) for one in more))
    if not merit.explains(best):
        best = merit.main_effects(best)
    rungs = _ladder(search, merit, best)
    # Few readings scatter by themselves.
    count = np.isfinite(samples.measured).sum(axis=0)
    chance = 1.0 + CHANCE * np.sqrt(2.0 / np.maximum(count, 1))
    good = bool((((rungs[-1].rms / samples.sigma) ** 2 <= np.maximum(LEFT, chance)) | (count == 0)).all())
    summary = _summary(network, rungs, good)
    verdict: Literal["adequate", "unexplained"] = "adequate" if good else "unexplained"
    return Growth(rungs, verdict, summary, merit.refused(best), best.problem, _folds(search, merit, best))


def _folds(beam: Beam, merit: Merit, best: FittedSet) -> tuple[Fold, ...]:
    if not best.ids:
        return ()
    samples = beam.empty.samples
    gains = -np.diff(merit.hidden(beam.known[frozenset()], best), axis=1)[:, 0]
    return tuple(
        Fold(float(samples.time[a]), float(samples.time[b]), int(np.isfinite(samples.measured[a : b + 1]).sum()), g)
        for (a, b), g in zip(merit.pieces(), gains.tolist(), strict=True)
    )


def states_of(network: Network, inputs: ArrayLike, measured: ArrayLike) -> SampledRecord:
    """Steady states with a reading, one a row; their time counts them.

    Raises:
        TwinFileError: fewer than `FEWEST`.
    """
    y, u = np.asarray(measured, dtype=np.float64), np.asarray(inputs, dtype=np.float64)
    good = np.isfinite(y).any(axis=1) & np.isfinite(u).all(axis=1)
    if good.sum() < FEWEST:
        raise TwinFileError(f"{good.sum()} steady states have their readings; at least {FEWEST} are needed")
    return SampledRecord(np.arange(good.sum(), dtype=np.float64), u[good], y[good], network.sigma, at_rest=True)


def samples_of(network: Network, time_s: ArrayLike, inputs: ArrayLike, measured: ArrayLike) -> SampledRecord:
    """A record at its own stamps, or as means where it has more than `MOST_SAMPLES`.

    Raises:
        TwinFileError: too short, or not a single reading.
    """
    time = clean_time(time_s)
    if len(time) < FEWEST_SAMPLES:
        raise TwinFileError(
            f"the record has {len(time)} samples; a twin that was never commissioned grows from {FEWEST_SAMPLES} at "
            "least, or from steady states with --at-rest"
        )
    least = (time[-1] - time[0]) / MOST_SAMPLES if len(time) > MOST_SAMPLES else 0.0
    grid = on_grid(network, time, inputs, measured, least)
    if least:
        return SampledRecord(grid.time - grid.time[0], grid.inputs, grid.measured, grid.sigma, means=True)
    y = np.asarray(measured, dtype=np.float64)
    return SampledRecord(
        time - time[0], bridged(network, time, inputs), np.where(np.isfinite(y), y, np.nan), network.sigma
    )


def _ladder(beam: Beam, merit: Merit, best: FittedSet) -> tuple[GrowthRung, ...]:
    """The set's effects one by one, each the best of those that are left to add."""
    now = beam.known[frozenset()]
    rungs = [_rung(beam, now, None)]
    left = {name_of(e.candidate): e for e in best.fit.entries}
    while left:
        stands = {e.name for e in beam.empty.network.elements} | {
            name for e in now.fit.entries for name in e.candidate.adds
        }
        free = [
            e
            for e in left.values()
            if all((n := name.rsplit(".", 1)[0]) in stands or n in e.candidate.adds for name in e.candidate.changes)
        ]
        new = min((beam.extended(now, e) for e in free), key=by_score)
        entry = next(e for e in best.fit.entries if name_of(e.candidate) in new.ids - now.ids)
        without = beam.reduced(best, entry)
        better, share = merit.on_hidden_rows(without, best)
        elsewhere = merit.elsewhere(without) - merit.elsewhere(best)
        needed, chance = without.fit.cost - best.fit.cost, merit.chance(without)
        c = entry.candidate
        added = Added(
            *entry.label,
            entry.size,
            interval(entry.size, SE90 * entry.sd, (c.lower, c.upper)),
            c.unit,
            c.says,
            now.fit.cost - new.fit.cost,
            needed,
            elsewhere,
            better,
            share,
            _others(beam, merit, best, without),
            chance.of(needed + elsewhere),
            chance.limit,
            entry,
        )
        rungs.append(_rung(beam, new, added))
        del left[name_of(entry.candidate)]
        now = new
    return tuple(rungs)


def _others(beam: Beam, merit: Merit, best: FittedSet, without: FittedSet) -> dict[EffectLabel, float]:
    """What could stand in the place of the one effect that `best` has and `without` has not, and how much worse."""
    named = {e.label for e in best.fit.entries}
    found: dict[EffectLabel, float] = {}
    near = best.score + width(without.score - best.score)
    for key, other in beam.known.items():
        if not without.ids < key or len(key) != len(best.ids) or other.score > near:
            continue
        if not merit.is_rival(best, other):
            continue
        worse = other.score + merit.elsewhere(other) - best.score - merit.elsewhere(best)
        if worse < width(0.0):
            for label in (e.label for e in other.fit.entries if e.label not in named):
                found[label] = min(worse, found.get(label, worse))
    return found


def _rung(beam: Beam, at: FittedSet, added: Added | None) -> GrowthRung:
    network = beam.empty.superset.plain(at.fit.entries, at.fit.values)
    return GrowthRung(network, added, at.fit.rms, at.fit)


def _summary(network: Network, rungs: tuple[GrowthRung, ...], good: bool) -> str:
    steps = [f"{r.added.kind.replace('_', ' ')} at {r.added.where}" for r in rungs if r.added is not None]
    added = f"added in this order: {', '.join(steps)}" if steps else "nothing is missing that this record could show"
    worst = int(np.nanargmax(rungs[-1].rms / network.sigma))
    rest = (
        "what is left is the thermometers' noise"
        if good
        else f"{network.sensor_names[worst]} is still off by {rungs[-1].rms[worst]:.2f} K "
        f"(noise {network.sigma[worst]:.2f} K), which no effect of the catalogue explains"
    )
    return f"{added}; {rest}"
