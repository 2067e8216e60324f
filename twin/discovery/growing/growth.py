"""Growth of a twin: forward selection of effects on a record without a healthy one to compare with.

If several effects are missing, the best single one is often none of them. A beam search therefore extends each of the
best sets by each effect that could explain most of its residual, and compares the fitted sets. The likelihood selects
the set, where every hypothesis has the noise spectrum that suits it best (`likelihood`). Then each member is tested
against the set without it, by the likelihood and on held-out parts of the record. Effects are present from the
beginning; later onsets are left to `engine.diagnose`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
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
from twin.kernel import clean_time
from twin.network import Array, Network, TwinFileError
from twin.quantiles import NORMAL90

MOST_EFFECTS = 4
"""Effects that are added at most."""
MOST_SAMPLES = 4000
"""Samples of a record at most; a longer one is averaged. It bounds the time of a growth."""
CHANCE = 3.0
"""Standard deviations of a mean square up to which a difference is insignificant."""
FEWEST, FEWEST_SAMPLES = 12, 40
"""Least steady states, and samples of a record, for growing a twin."""


@dataclass(frozen=True)
class Added:
    """One effect of the ladder, in the vocabulary of a diagnosis.

    Attributes:
        value, interval90: its size beside all the others, in `unit`. says: in words.
        gain: fall of -2 log likelihood by its rung. needed: rise of it if the full set lacks it.
        elsewhere: the same for the further records, which were not fitted.
        folds, predicted: held-out folds that the full set predicts no worse with it, and its squares there over those
            without it. others: labels (kind, where, driver) of its ambiguity group, with the rise of -2 log likelihood
            of their sets. by_chance: p-value of `needed` under noise alone; `limit` is its 99 % quantile.
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
    predicted: float
    others: dict[EffectLabel, float]
    by_chance: float
    limit: float
    entry: Entry


@dataclass(frozen=True)
class GrowthRung:
    """One rung: `network` with its effects, fitted; RMSE per sensor `rms` (m,), K; the first rung adds nothing."""

    network: Network
    added: Added | None
    rms: Array
    fit: GrowthFit


@dataclass(frozen=True)
class Growth:
    """Ladder of a growth. `verdict`: whether the last rung leaves no more than the thermometers' noise.

    `problem` is that of the last rung. `folds`: parts of the record held out in turn, and the gain of all effects
    there.
    """

    rungs: tuple[GrowthRung, ...]
    verdict: Literal["adequate", "unexplained"]
    summary: str
    refused: tuple[RejectedEffect, ...]
    problem: GrowthProblem
    folds: tuple[Fold, ...]

    @property
    def network(self) -> Network:
        """Return the twin of the last rung."""
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
    """Add effects to a twin until the record needs no more.

    Args:
        network: with tunables. inputs: (N, c). measured: (N, m) degC, NaN left out.
        more: further records (time, inputs, measured), which rank sets that form an ambiguity group on this one.
        most: effects that may be added.
        beam: sets that each round extends. say: called with a description of each step.

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
    """Add effects as `grow` does, from steady states: each row of `inputs` (n, c) and `measured` (n, m) is one.

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
    """Add effects as `grow` does, from prepared samples or states."""
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
    """Return the steady states with a reading, one a row; their time is their number.

    Raises:
        TwinFileError: fewer than `FEWEST`.
    """
    y, u = np.asarray(measured, dtype=np.float64), np.asarray(inputs, dtype=np.float64)
    good = np.isfinite(y).any(axis=1) & np.isfinite(u).all(axis=1)
    if good.sum() < FEWEST:
        raise TwinFileError(f"{good.sum()} steady states have their readings; at least {FEWEST} are needed")
    return SampledRecord(np.arange(good.sum(), dtype=np.float64), u[good], y[good], network.sigma, at_rest=True)


def samples_of(network: Network, time_s: ArrayLike, inputs: ArrayLike, measured: ArrayLike) -> SampledRecord:
    """Return a record at its own stamps, or as means if it has more than `MOST_SAMPLES`.

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
        return SampledRecord(
            grid.time - grid.time[0], grid.inputs, grid.measured, grid.sigma, means=True, centre=grid.centre
        )
    y = np.asarray(measured, dtype=np.float64)
    return SampledRecord(
        time - time[0], bridged(network, time, inputs), np.where(np.isfinite(y), y, np.nan), network.sigma
    )


def _ladder(beam: Beam, merit: Merit, best: FittedSet) -> tuple[GrowthRung, ...]:
    """Return the rungs of a set: its effects in the order in which each is the best of those left."""
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
        at = next(i for i, e in enumerate(best.fit.entries) if name_of(e.candidate) in new.ids - now.ids)
        entry = replace(best.fit.entries[at], sd=float(best.fit.deviations[at]))
        without = beam.reduced(best, best.fit.entries[at])
        better, share = merit.on_hidden_rows(without, best)
        elsewhere = merit.elsewhere(without) - merit.elsewhere(best)
        needed, chance = without.fit.cost - best.fit.cost, merit.chance(without)
        c = entry.candidate
        added = Added(
            *entry.label,
            entry.size,
            interval(entry.size, NORMAL90 * entry.sd, (c.lower, c.upper)),
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
    """Return the labels that could replace the one effect that `without` lacks, and how much worse their sets are."""
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
