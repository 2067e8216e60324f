"""Beam search over sets of effects: each of the best sets is fitted with one more effect."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twin.discovery.effects.ambiguity_groups import EffectLabel
from twin.discovery.evidence.priors import plausibility
from twin.discovery.growing.descent import Start, descend
from twin.discovery.growing.growth_problem import GrowthFit, GrowthProblem
from twin.discovery.growing.scoring import Scored, scores
from twin.discovery.growing.superset.candidate_superset import name_of, unsized
from twin.discovery.growing.superset.hidden_masses import kin
from twin.discovery.scoring.search import Entry
from twin.elements.candidates import Candidate

BEAM = 3
"""Sets that are extended in each round: so many by likelihood, and as many by squares."""
COARSE = 2
"""Step in the grid of time constants that are fitted with every set, whatever lies between."""
NEARER = (3.0**0.5, 3.0**0.25, 3.0**0.125)
"""Factors by which the time constants of the best set are varied afterwards, as long as the fit improves."""

Starts = list[Start]


@dataclass(frozen=True)
class FittedSet:
    """Fitted set of effects. `score`: -2 log likelihood plus the cost of its effects by their prior."""

    problem: GrowthProblem
    fit: GrowthFit
    score: float

    @property
    def ids(self) -> frozenset[str]:
        return frozenset(name_of(e.candidate) for e in self.fit.entries)

    @property
    def form(self) -> tuple[Any, ...]:
        """Return a key of the set without the time constants of its masses."""
        return tuple(sorted(kin(e.candidate) or (name_of(e.candidate),) for e in self.fit.entries))

    @property
    def squares(self) -> float:
        return float(np.nansum((self.fit.residual / self.problem.samples.sigma) ** 2))


class Beam:
    """Fitted sets of effects: all by their ids, `known`, and by their number of effects, `levels`."""

    def __init__(self, empty: GrowthProblem, width: int) -> None:
        self.empty, self.width = empty, width
        self._price = math.log(max(int(np.isfinite(empty.samples.measured).sum()), 2))
        slow = [c.slow_s for c in empty.superset.candidates if c.slow_s]
        self._slow = (0.99 * min(slow), 1.01 * max(slow)) if slow else (0.0, 0.0)
        self.known: dict[frozenset[str], FittedSet] = {}
        self.levels: list[list[FittedSet]] = [self._fitted([[Start(empty, empty.start())]])]

    def extended(self, old: FittedSet, entry: Entry, *sizes: float) -> FittedSet:
        """Return a set with one more effect."""
        return self._fitted([self._starts(old, entry, *sizes)])[0]

    def _starts(self, old: FittedSet, entry: Entry, *sizes: float) -> Starts:
        """Return the start points of a set with one more effect: twin file's values, the smaller set's, other sizes."""
        problem = self.empty.with_entries((*old.fit.entries, entry))
        others = [self._onward(old, replace(entry, size=size)) for size in sizes]
        own = old.fit if not old.fit.entries else None
        return [Start(problem, problem.start(), own), Start(problem, problem.start(old.fit), old.fit), *others]

    def _onward(self, old: FittedSet, entry: Entry) -> Start:
        """Return the start point of a set with one more effect at the smaller set's values."""
        problem = self.empty.with_entries((*old.fit.entries, entry))
        return Start(problem, problem.start(old.fit), old.fit)

    def reduced(self, old: FittedSet, entry: Entry) -> FittedSet:
        """Return a set without one of its effects, and without those that depend on elements of this effect alone."""
        alone = set(entry.candidate.adds).difference(*(e.candidate.adds for e in old.fit.entries if e is not entry))
        gone = {name_of(entry.candidate)} | {
            name_of(e.candidate)
            for e in old.fit.entries
            if any(name.rsplit(".", 1)[0] in alone for name in e.candidate.changes)
        }
        rest = tuple(e for e in old.fit.entries if name_of(e.candidate) not in gone)
        problem = self.empty.with_entries(rest)
        return self._fitted([[Start(problem, problem.start()), Start(problem, problem.start(old.fit), old.fit)]])[0]

    def deepen(self) -> bool:
        """Fit sets of one more effect; return False if a further round is not worth while."""
        last = likeliest(self.levels[-1])
        chosen = {s.ids: s for order in (by_score, by_squares) for s in sorted(last, key=order)[: self.width]}
        scored = [(old, self._scored(old)) for old in chosen.values()]
        starts = [self._starts(old, s.entry, s.asked) for old, every in scored for s in _finalists(every)]
        starts += [[self._onward(old, s.entry)] for old, every in scored for s in _spread(every)]
        found = {new.ids: new for new in self._fitted(starts)}
        for new in self._neighbours(chosen.values(), found):
            found[new.ids] = new
        if not found:
            return False
        ends = {min(likeliest(found.values()), key=order).ids for order in (by_score, by_squares)}
        for new in [new for end in ends for new in self._timed(found[end])]:
            found[new.ids] = new
        self.levels.append(list(found.values()))
        before, now = (min(s.score for s in likeliest(level)) for level in self.levels[-2:])
        # Two may be needed where neither does anything alone; three that do no better than two are the end.
        return len(self.levels) <= 2 or now < before

    def _timed(self, best: FittedSet) -> list[FittedSet]:
        """Return a set with other time constants of its masses, refined towards the least squares."""
        found: list[FittedSet] = []
        for share in NEARER:
            better = True
            while better:
                starts = []
                for entry in best.fit.entries:
                    slower, slow_s = entry.candidate.slower, entry.candidate.slow_s
                    if slower is None or not entry.candidate.adds:
                        continue
                    rest = [e for e in best.fit.entries if e is not entry]
                    for f in (share, 1.0 / share):
                        if not self._slow[0] <= f * slow_s <= self._slow[1]:
                            continue
                        problem = self.empty.with_entries((*rest, unsized(slower(f * slow_s), entry.size / f)))
                        starts.append([Start(problem, problem.start(best.fit), best.fit)])
                new = self._fitted(starts)
                found += new
                best, old = min((best, *new), key=by_squares), best
                better = best is not old
        return found

    def _fitted(self, sets: Sequence[Starts]) -> list[FittedSet]:
        """Fit sets, each from several start points: problems that differ only in their scales."""
        keys = [frozenset(name_of(e.candidate) for e in starts[0].problem.entries) for starts in sets]
        new: dict[frozenset[str], Starts] = {}
        for key, starts in zip(keys, sets, strict=True):
            if key not in self.known:
                new.setdefault(key, starts)
        ends = iter(descend([start for starts in new.values() for start in starts]))
        for key, starts in new.items():
            fits = [s.problem.fitted(end.v, end.readings) for s, end in zip(starts, ends, strict=False)]
            fit = min(fits, key=lambda f: f.cost)
            price = sum(self._price - 2.0 * math.log(plausibility(e)) for e in fit.entries)
            self.known[key] = FittedSet(fit.problem, fit, fit.cost + price)
        return [self.known[key] for key in keys]

    def _neighbours(self, chosen: Iterable[FittedSet], fitted: Mapping[frozenset[str], FittedSet]) -> list[FittedSet]:
        """Return neighbours of each set in the grid of time constants, for each mass and each wall."""
        family: dict[Any, list[Candidate]] = defaultdict(list)
        for candidate in self.empty.superset.candidates:
            if len(candidate.changes) > 1 and candidate.driver == "history":
                family[_family(candidate)].append(candidate)
        starts = []
        for old in chosen:
            for members in family.values():
                members.sort(key=lambda c: sorted(c.changes.values()))
                tried = {i: f for i, c in enumerate(members) if (f := fitted.get(old.ids | {name_of(c)}))}
                if not tried:
                    continue
                at = min(tried, key=lambda i: tried[i].squares)
                size = next(e.size for e in tried[at].fit.entries if name_of(e.candidate) == name_of(members[at]))
                for i in {at - 1, at + 1} & set(range(len(members))) - set(tried):
                    starts.append([self._onward(old, unsized(members[i], max(size, members[i].typical * 1e-3)))])
        return self._fitted(starts)

    def _scored(self, old: FittedSet) -> list[Scored]:
        found = scores(self.empty.superset, old.problem, old.fit)
        # One mass with two time constants is one mass with another.
        there = {_family(e.candidate) for e in old.fit.entries if e.candidate.slow_s}
        return [s for s in found if _family(s.entry.candidate) not in there]


def _finalists(found: Sequence[Scored]) -> list[Scored]:
    """Return the best candidates of each label: the linear score of an effect that re-tuning nearly imitates is
    unreliable.
    """
    kept: dict[str, Scored] = {}
    for order in (lambda s: -s.squares, lambda s: -s.likely):
        seen: Counter[tuple[EffectLabel, str, frozenset[str]]] = Counter()
        for scored in sorted(found, key=order):
            form = scored.entry.label, scored.entry.candidate.unit, frozenset(scored.entry.candidate.changes)
            seen[form] += 1
            if seen[form] == 1:
                kept.setdefault(name_of(scored.entry.candidate), scored)
    return list(kept.values())


def _spread(found: Sequence[Scored]) -> list[Scored]:
    """Return masses over the whole grid of time constants, since a local search from the best one stops at a local
    optimum.
    """
    family: dict[Any, list[Scored]] = defaultdict(list)
    for scored in found:
        if scored.entry.candidate.slow_s:
            family[_family(scored.entry.candidate)].append(scored)
    return [s for some in family.values() for s in sorted(some, key=lambda s: s.entry.candidate.slow_s)[::COARSE]]


def likeliest(sets: Iterable[FittedSet]) -> list[FittedSet]:
    """Return, of sets that differ only in time constants, the one of least squares.

    The likelihood would prefer one with a slow misfit, which it treats as noise.
    """
    best: dict[Any, FittedSet] = {}
    for one in sets:
        best[one.form] = min(best.get(one.form, one), one, key=by_squares)
    return list(best.values())


def _family(candidate: Candidate) -> Any:
    return candidate.kind, candidate.where, candidate.unit, tuple(sorted(candidate.changes))


def by_score(one: FittedSet) -> float:
    return one.score


def by_squares(one: FittedSet) -> float:
    return one.squares
