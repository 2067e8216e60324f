"""A twin that grows: which effects are missing from a record, when there is no healthy one to compare with.

Where several effects are missing, the best single one is often none of them. So sets of effects are built up in a beam:
each of the best sets so far is fitted with each of the effects that could take most of what it leaves, and the fitted
sets are compared. The set that is kept is the one that the record asks for, by the likelihood with every hypothesis
given the noise that suits it best (`likelihood`); then each member must earn its place, against the set without it,
in the likelihood and on parts of the record that the fit was not shown. Effects are there from the beginning; what
comes in later is for `engine.diagnose`.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from twin.discovery.calibration import by_chance
from twin.discovery.equivalence import width
from twin.discovery.grid import bridged, on_grid
from twin.discovery.likelihood import cosines, judged
from twin.discovery.ranking import LEFT, plausibility
from twin.discovery.scoring import Scored, scores
from twin.discovery.search import Entry
from twin.discovery.unaided import Fit, Problem, Samples
from twin.discovery.wardrobe import Wardrobe, name_of, unsized
from twin.elements.base import Candidate
from twin.kernel import clean_time
from twin.network import Array, Network, TwinFileError

MOST_EFFECTS = 4
NEEDED = 25.0
"""Least fall of -2 log likelihood that an effect must bring, whatever chance could bring on this record."""
BEAM = 3
"""Sets that are built upon, by likelihood and as many by squares."""
CHECKED = 400
"""Sets, from the best, of which each member is asked whether it is needed."""
REFUSED = 6
"""Near misses that are told."""
MOST_SAMPLES = 4000
FOLDS, PIECES = 4, 12
"""Folds of the cross-validation, and pieces of the record that are dealt out to them in turn."""
BETTER_FOLDS = 3
SAME = 0.02
"""Share by which a fold's error may be worse and still count as the same."""
CHANCE = 3.0
"""Standard deviations of a mean square that count as chance."""
FEWEST = 12
"""Steady states that a twin can grow from."""
SE90 = 1.6449

Label = tuple[str, str, str]


@dataclass(frozen=True)
class Added:
    """One effect of the ladder, in the vocabulary of a diagnosis.

    Attributes:
        value, interval90: its size beside all the others, in `unit`. says: in words.
        gain: fall of -2 log likelihood that it brings on its rung. needed: rise of it when the full set goes without.
        elsewhere: the same of the further records, which were not fitted.
        folds, foretold: hidden parts of the record that the full set foretells no worse with it, and its squares there
            over those without it. others: labels (kind, where, driver) that the record cannot tell from it.
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
    others: tuple[Label, ...]


@dataclass(frozen=True)
class Rung:
    """A twin on the way: `network` with its effects, fitted; RMSE per sensor `rms` (m,), K; the first adds nothing."""

    network: Network
    added: Added | None
    rms: Array
    fit: Fit


@dataclass(frozen=True)
class Refused:
    """An effect that was fitted and not added, and why."""

    kind: str
    where: str
    driver: str
    why: str


@dataclass(frozen=True)
class Growth:
    """The ladder. `verdict`: whether what the last rung leaves is the thermometers' noise."""

    rungs: tuple[Rung, ...]
    verdict: Literal["adequate", "unexplained"]
    summary: str
    refused: tuple[Refused, ...]

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
    return _grown(network, samples_of(network, time_s, inputs, measured), more, most, beam, say)


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
    y, u = np.asarray(measured, dtype=np.float64), np.asarray(inputs, dtype=np.float64)
    good = np.isfinite(y).any(axis=1) & np.isfinite(u).all(axis=1)
    if good.sum() < FEWEST:
        raise TwinFileError(f"{good.sum()} steady states have their readings; at least {FEWEST} are needed")
    rows = Samples(np.arange(good.sum(), dtype=np.float64), u[good], y[good], network.sigma, at_rest=True)
    return _grown(network, rows, (), most, beam, say)


def _grown(
    network: Network,
    samples: Samples,
    more: tuple[tuple[ArrayLike, ArrayLike, ArrayLike], ...],
    most: int,
    beam: int,
    say: Callable[[str], None],
) -> Growth:
    ids = network.tunables("commission" if "commission" in network.sets else None)
    if not ids:
        raise TwinFileError(f"twin {network.name!r} has no tunables; set the status of at least one parameter")
    say("fitting the twin as it is")
    wardrobe = Wardrobe.of(network, ids, float(np.median(np.diff(samples.time))), samples.at_rest)
    search = _Search(Problem(wardrobe, samples, ids), beam)
    for effects in range(1, most + 1):
        say(f"looking for {effects} effects that are missing")
        if not search.deepen():
            break
    say("asking each of them whether it is needed")
    best = search.weighed(search.earned(), tuple(samples_of(network, *one) for one in more))
    rungs = search.ladder(best)
    # Few readings scatter by themselves.
    chance = 1.0 + CHANCE * np.sqrt(2.0 / np.isfinite(samples.measured).sum(axis=0))
    good = bool(((rungs[-1].rms / samples.sigma) ** 2 <= np.maximum(LEFT, chance)).all())
    summary = _summary(network, rungs, good)
    return Growth(rungs, "adequate" if good else "unexplained", summary, search.refused(best))


def samples_of(network: Network, time_s: ArrayLike, inputs: ArrayLike, measured: ArrayLike) -> Samples:
    """A record at its own stamps, or as means where it has more than `MOST_SAMPLES`.

    Raises:
        TwinFileError: too short, or not a single reading.
    """
    time = clean_time(time_s)
    least = (time[-1] - time[0]) / MOST_SAMPLES if len(time) > MOST_SAMPLES else 0.0
    grid = on_grid(network, time, inputs, measured, least)
    if least:
        return Samples(grid.time - grid.time[0], grid.inputs, grid.measured, grid.sigma)
    y = np.asarray(measured, dtype=np.float64)
    return Samples(time - time[0], bridged(network, time, inputs), np.where(np.isfinite(y), y, np.nan), network.sigma)


@dataclass(frozen=True)
class _Set:
    """Some effects, fitted. `score`: -2 log likelihood with what effects cost before any data."""

    problem: Problem
    fit: Fit
    score: float

    @property
    def ids(self) -> frozenset[str]:
        return frozenset(name_of(e.candidate) for e in self.fit.entries)

    @property
    def squares(self) -> float:
        return float(np.nansum((self.fit.residual / self.problem.samples.sigma) ** 2))


class _Search:
    """All sets of effects that have been fitted, by their size: `levels`."""

    def __init__(self, empty: Problem, beam: int) -> None:
        self.empty, self.beam = empty, beam
        self._price = math.log(max(int(np.isfinite(empty.samples.measured).sum()), 2))
        self._known: dict[frozenset[str], _Set] = {}
        self._more: tuple[Samples, ...] = ()
        self._told: dict[frozenset[str], float] = {}
        self._chance: dict[frozenset[str], float] = {}
        self.levels: list[list[_Set]] = [[self._fitted(((empty, empty.start()),))]]
        piece = np.arange(len(empty.samples.time)) * PIECES // len(empty.samples.time)
        self._folds = [piece % FOLDS == f for f in range(FOLDS)]

    def _fitted(self, starts: tuple[tuple[Problem, Array], ...]) -> _Set:
        """One set from several starts; problems that differ in nothing but their scales."""
        entries = starts[0][0].entries
        key = frozenset(name_of(e.candidate) for e in entries)
        if key not in self._known:
            problem, fit = min(((p, p.fit(v)) for p, v in starts), key=lambda f: f[1].cost)
            price = sum(self._price - 2.0 * math.log(plausibility(e)) for e in entries)
            self._known[key] = _Set(problem, fit, fit.cost + price)
        return self._known[key]

    def _with(self, old: _Set, entry: Entry, *sizes: float) -> _Set:
        """A set with one effect more, begun at the twin file's values, at the smaller set's, and at other sizes."""
        problem = self.empty.with_entries((*old.fit.entries, entry))
        starts = [(problem, problem.start()), (problem, problem.start(old.fit))]
        for size in sizes:
            other = self.empty.with_entries((*old.fit.entries, replace(entry, size=size)))
            starts.append((other, other.start(old.fit)))
        return self._fitted(tuple(starts))

    def _less(self, old: _Set, entry: Entry) -> _Set:
        """A set without one of its effects, and without what stands on it."""
        gone = {name_of(entry.candidate)} | {
            name_of(e.candidate)
            for e in old.fit.entries
            if any(name.rsplit(".", 1)[0] in entry.candidate.adds for name in e.candidate.changes)
        }
        rest = tuple(e for e in old.fit.entries if name_of(e.candidate) not in gone)
        problem = self.empty.with_entries(rest)
        return self._fitted(((problem, problem.start()), (problem, problem.start(old.fit))))

    def deepen(self) -> bool:
        """Fit sets of one effect more; False where it does not pay to go on."""
        last = self.levels[-1]
        chosen = {s.ids: s for order in (_score, _squares) for s in sorted(last, key=order)[: self.beam]}
        found: dict[frozenset[str], _Set] = {}
        for old in chosen.values():
            for scored in self._finalists(old):
                new = self._with(old, scored.entry, scored.asked)
                found[new.ids] = new
            for new in self._siblings(old):
                found[new.ids] = new
        if not found:
            return False
        self.levels.append(list(found.values()))
        before, now = (min(s.score for s in level) for level in self.levels[-2:])
        # Two may be needed where neither does anything alone; three that do no better than two are the end.
        return len(self.levels) <= 2 or now < before

    def _siblings(self, old: _Set) -> list[_Set]:
        """Of each effect that has others of its kind (other time constants), the neighbours while they do better."""
        family: dict[Any, list[Candidate]] = defaultdict(list)
        for candidate in self.empty.wardrobe.candidates:
            if len(candidate.changes) > 1 and candidate.driver == "history":
                family[_family(candidate)].append(candidate)
        found = []
        for members in family.values():
            members.sort(key=lambda c: sorted(c.changes.values()))
            at = [i for i, c in enumerate(members) if old.ids | {name_of(c)} in self._known]
            if len(members) < 2 or not at:
                continue
            best = min(at, key=lambda i: self._known[old.ids | {name_of(members[i])}].score)
            tried = set(at)
            while new := {i for i in (best - 1, best + 1) if 0 <= i < len(members)} - tried:
                size = self._known[old.ids | {name_of(members[best])}].fit.entries[-1].size
                for i in new:
                    found.append(self._with(old, unsized(members[i], max(size, members[i].typical * 1e-3))))
                tried |= new
                best = min(tried, key=lambda i: self._known[old.ids | {name_of(members[i])}].score)
        return found

    def _finalists(self, old: _Set) -> list[Scored]:
        """The best candidates of each label: what re-tuning can nearly imitate shows its worth in the fit alone."""
        found = scores(self.empty.wardrobe, old.problem, old.fit)
        kept: dict[str, Scored] = {}
        for order in (lambda s: -s.squares, lambda s: -s.likely):
            seen: Counter[tuple[Label, str]] = Counter()
            for scored in sorted(found, key=order):
                form = scored.entry.label, scored.entry.candidate.unit
                seen[form] += 1
                if seen[form] == 1:
                    kept.setdefault(name_of(scored.entry.candidate), scored)
        return list(kept.values())

    def earned(self) -> _Set:
        """The best set of which every member earns its place."""
        every = sorted((s for level in self.levels for s in level), key=_score)
        for one in every[:CHECKED]:
            if self._weakest(one) is None:
                return one
        best = every[0]
        while best.fit.entries:
            weakest = self._weakest(best)
            if weakest is None:
                break
            best = self._less(best, weakest)
        return best

    def weighed(self, best: _Set, more: tuple[Samples, ...]) -> _Set:
        """The set that foretells further records best, without another fit.

        Of sets that do as well as each other it is the one; and an effect that the record nearly carries joins them
        where they carry it with it.
        """
        if not more:
            return best
        limit = width(self.levels[0][0].score - best.score)
        alike = [
            s for s in self._known.values()
            if len(s.ids) == len(best.ids) and abs(s.score - best.score) < limit and self._weakest(s) is None
        ]  # fmt: skip
        self._more, told = more, self._elsewhere
        best = min((*alike, best), key=lambda s: s.score + told(s))
        while True:
            larger = [
                s
                for s in self._known.values()
                if best.ids < s.ids and len(s.ids) == len(best.ids) + 1 and s.score < best.score
            ]
            larger = [s for s in larger if told(s) < told(best)]
            larger.sort(key=lambda s: s.score + told(s))
            joined = next((s for s in larger if self._weakest(s) is None), None)
            if joined is None:
                return best
            best = joined

    def _elsewhere(self, one: _Set) -> float:
        """-2 log likelihood of the further records, everything but their initial states as fitted to the first."""
        if not self._more:
            return 0.0
        if one.ids not in self._told:
            self._told[one.ids] = sum(_foretelling(one, samples) for samples in self._more)
        return self._told[one.ids]

    def refused(self, best: _Set) -> tuple[Refused, ...]:
        """The effects that would take most of what is left, and why they were not added."""
        found: dict[Label, Refused] = {}
        for one in sorted(self._known.values(), key=_score):
            if not best.ids < one.ids or len(one.ids) != len(best.ids) + 1 or len(found) == REFUSED:
                continue
            entry = _new(best, one)
            why = self._why_not(best, one, entry)
            if best.fit.cost - one.fit.cost > 1.0 and entry.label not in found:
                found[entry.label] = Refused(*entry.label, why or "its set holds others that are not needed")
        return tuple(found.values())

    def _weakest(self, found: _Set) -> Entry | None:
        """A member without which the set does as well; of several the one that is missed least."""
        for entry in found.fit.entries:
            # Most sets fall to a smaller one that has been fitted already.
            rest = self._known.get(found.ids - {name_of(entry.candidate)})
            if not self._more and rest is not None and rest.fit.cost - found.fit.cost < NEEDED:
                return entry
        for without, entry in sorted(((self._less(found, e), e) for e in found.fit.entries), key=lambda p: p[0].score):
            if self._why_not(without, found, entry):
                return entry
        return None

    def _why_not(self, without: _Set, found: _Set, entry: Entry) -> str:
        """Why an effect has not earned its place in a set, "" where it has, in all records together."""
        gain = without.fit.cost - found.fit.cost + self._elsewhere(without) - self._elsewhere(found)
        if gain < NEEDED:
            return f"gains {gain:.0f} where {NEEDED:.0f} are asked for"
        if _at_bound(entry):
            return "ends on the bound of what is possible"
        chance = self._by_chance(without)
        if gain < chance:
            return f"gains {gain:.0f} where {chance:.0f} come by chance"
        better, share = self._foretold(without, found)
        if better < BETTER_FOLDS or share >= 1.0:
            return f"foretells {better} of {FOLDS} hidden parts no worse, with {share:.2f} of their squares"
        return ""

    def _by_chance(self, without: _Set) -> float:
        if without.ids not in self._chance:
            self._chance[without.ids] = by_chance(without.problem, without.fit)
        return self._chance[without.ids]

    def _foretold(self, without: _Set, found: _Set) -> tuple[int, float]:
        """Folds that a set foretells no worse than a smaller one, and its squares over the other's, on hidden rows."""
        better, squares = 0, np.zeros(2)
        for rows in self._folds:
            pair = []
            for one in (without, found):
                samples = one.problem.samples
                part = one.problem.with_entries(one.fit.entries, samples.without(rows))
                v = part.descend(part.start(one.fit))
                off = (samples.measured - part.readings(v[None, :])[0])[rows] / samples.sigma
                pair.append(float(np.nansum(off**2)))
            squares += pair
            better += pair[1] <= pair[0] * (1.0 + SAME)
        return better, float(squares[1] / max(squares[0], 1e-12))

    def ladder(self, best: _Set) -> tuple[Rung, ...]:
        """The set's effects one by one, each the best of those that are left to add."""
        now = self._known[frozenset()]
        rungs = [self._rung(now, None)]
        left = {name_of(e.candidate): e for e in best.fit.entries}
        while left:
            stands = {e.name for e in self.empty.network.elements} | {
                name for e in now.fit.entries for name in e.candidate.adds
            }
            free = [
                e for e in left.values()
                if all((n := name.rsplit(".", 1)[0]) in stands or n in e.candidate.adds for name in e.candidate.changes)
            ]  # fmt: skip
            new = min((self._with(now, e) for e in free), key=_score)
            entry = next(e for e in best.fit.entries if name_of(e.candidate) in new.ids - now.ids)
            without = self._less(best, entry)
            better, share = self._foretold(without, best)
            elsewhere = self._elsewhere(without) - self._elsewhere(best)
            spread = SE90 * entry.sd
            added = Added(
                *entry.label, entry.size, (entry.size - spread, entry.size + spread), entry.candidate.unit,
                entry.candidate.says, now.fit.cost - new.fit.cost, without.fit.cost - best.fit.cost, elsewhere, better,
                share, self._others(best, without),
            )  # fmt: skip
            rungs.append(self._rung(new, added))
            del left[name_of(entry.candidate)]
            now = new
        return tuple(rungs)

    def _others(self, best: _Set, without: _Set) -> tuple[Label, ...]:
        """What could stand in the place of the one effect that `best` has and `without` has not."""
        named = {e.label for e in best.fit.entries}
        found: dict[Label, None] = {}
        near = best.score + width(without.score - best.score)
        told = best.score + self._elsewhere(best) + width(0.0)
        for key, other in self._known.items():
            if not without.ids < key or len(key) != len(best.ids) or other.score > near:
                continue
            if other.score + self._elsewhere(other) < told:
                found.update((e.label, None) for e in other.fit.entries if e.label not in named)
        return tuple(found)

    def _rung(self, at: _Set, added: Added | None) -> Rung:
        network = self.empty.wardrobe.plain(at.fit.entries, at.fit.values)
        return Rung(network, added, at.fit.rms, at.fit)


def _new(small: _Set, large: _Set) -> Entry:
    """The effect that one set has and the other has not."""
    return next(e for e in large.fit.entries if name_of(e.candidate) not in small.ids)


def _foretelling(one: _Set, samples: Samples) -> float:
    """-2 log likelihood of another record, everything but its initial state as fitted to the first."""
    problem = one.problem.with_entries(one.fit.entries, samples)
    left = cosines(problem.residual(problem.carried(one.fit)), problem.present)
    return judged(left, samples.sigma)[0]


def _family(candidate: Candidate) -> Any:
    return candidate.kind, candidate.where, candidate.unit, tuple(sorted(candidate.changes))


def _score(one: _Set) -> float:
    return one.score


def _squares(one: _Set) -> float:
    return one.squares


def _at_bound(entry: Entry) -> bool:
    c = entry.candidate
    return entry.size <= c.lower or entry.size >= c.upper


def _summary(network: Network, rungs: tuple[Rung, ...], good: bool) -> str:
    steps = [f"{r.added.kind.replace('_', ' ')} at {r.added.where}" for r in rungs if r.added is not None]
    added = f"added in this order: {', '.join(steps)}" if steps else "nothing is missing that this record could show"
    worst = int(np.argmax(rungs[-1].rms / network.sigma))
    rest = (
        "what is left is the thermometers' noise"
        if good
        else f"{network.sensor_names[worst]} is still off by {rungs[-1].rms[worst]:.2f} K "
        f"(noise {network.sigma[worst]:.2f} K), which no effect of the catalogue explains"
    )
    return f"{added}; {rest}"
