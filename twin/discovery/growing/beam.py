"""Sets of effects that may be missing, built up in a beam: each of the best sets is fitted with one effect more."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twin.discovery.growing.descent import descend
from twin.discovery.growing.scoring import Scored, scores
from twin.discovery.growing.unaided import Fit, Problem
from twin.discovery.growing.wardrobe import name_of, unsized
from twin.discovery.scoring.search import Entry
from twin.discovery.selection.ranking import plausibility
from twin.elements.base import Candidate
from twin.network import Array

BEAM = 3
"""Sets that are built upon, by likelihood and as many by squares."""
FINER = (3.0**0.25, 3.0**0.125)
"""Factors by which the time constants of the best masses are varied: those of the catalogue lie a root of 3 apart."""

Label = tuple[str, str, str]
Starts = list[tuple[Problem, Array]]


@dataclass(frozen=True)
class FittedSet:
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


class Beam:
    """All sets of effects that have been fitted: `known`, and by their size `levels`."""

    def __init__(self, empty: Problem, width: int) -> None:
        self.empty, self.width = empty, width
        self._price = math.log(max(int(np.isfinite(empty.samples.measured).sum()), 2))
        self.known: dict[frozenset[str], FittedSet] = {}
        self.levels: list[list[FittedSet]] = [self._fitted([[(empty, empty.start())]])]

    def extended(self, old: FittedSet, entry: Entry, *sizes: float) -> FittedSet:
        """A set with one effect more."""
        return self._fitted([self._starts(old, entry, *sizes)])[0]

    def _starts(self, old: FittedSet, entry: Entry, *sizes: float) -> Starts:
        """Where a set with one effect more begins: at the twin file's values, at the smaller set's, at other sizes."""
        problem = self.empty.with_entries((*old.fit.entries, entry))
        starts = [(problem, problem.start()), (problem, problem.start(old.fit))]
        for size in sizes:
            other = self.empty.with_entries((*old.fit.entries, replace(entry, size=size)))
            starts.append((other, other.start(old.fit)))
        return starts

    def reduced(self, old: FittedSet, entry: Entry) -> FittedSet:
        """A set without one of its effects, and without what stands on it."""
        gone = {name_of(entry.candidate)} | {
            name_of(e.candidate)
            for e in old.fit.entries
            if any(name.rsplit(".", 1)[0] in entry.candidate.adds for name in e.candidate.changes)
        }
        rest = tuple(e for e in old.fit.entries if name_of(e.candidate) not in gone)
        problem = self.empty.with_entries(rest)
        return self._fitted([[(problem, problem.start()), (problem, problem.start(old.fit))]])[0]

    def deepen(self) -> bool:
        """Fit sets of one effect more; False where it does not pay to go on."""
        last = self.levels[-1]
        chosen = {s.ids: s for order in (by_score, by_squares) for s in sorted(last, key=order)[: self.width]}
        starts = [self._starts(old, s.entry, s.asked) for old in chosen.values() for s in self._finalists(old)]
        found = {new.ids: new for new in self._fitted(starts)}
        for old in chosen.values():
            for new in self._siblings(old):
                found[new.ids] = new
        if not found:
            return False
        for new in self._timed(min(found.values(), key=by_score)):
            found[new.ids] = new
        self.levels.append(list(found.values()))
        before, now = (min(s.score for s in level) for level in self.levels[-2:])
        # Two may be needed where neither does anything alone; three that do no better than two are the end.
        return len(self.levels) <= 2 or now < before

    def _timed(self, best: FittedSet) -> list[FittedSet]:
        """A set with other time constants of its masses, nearer and nearer to the best."""
        found = []
        for share in FINER:
            for entry in best.fit.entries:
                slower, slow_s = entry.candidate.slower, entry.candidate.slow_s
                if slower is None or not entry.candidate.adds:
                    continue
                rest = self.reduced(best, entry)
                others = [unsized(slower(f * slow_s), entry.size / f) for f in (share, 1.0 / share)]
                found += [self.extended(rest, other) for other in others]
            best = min((best, *found), key=by_score)
        return found

    def _fitted(self, sets: Sequence[Starts]) -> list[FittedSet]:
        """Sets, each from several starts: problems that differ in nothing but their scales."""
        keys = [frozenset(name_of(e.candidate) for e in starts[0][0].entries) for starts in sets]
        new: dict[frozenset[str], Starts] = {}
        for key, starts in zip(keys, sets, strict=True):
            if key not in self.known:
                new.setdefault(key, starts)
        ends = iter(descend([start for starts in new.values() for start in starts]))
        for key, starts in new.items():
            problem, fit = min(((p, p.fitted(next(ends))) for p, _ in starts), key=lambda f: f[1].cost)
            price = sum(self._price - 2.0 * math.log(plausibility(e)) for e in problem.entries)
            self.known[key] = FittedSet(problem, fit, fit.cost + price)
        return [self.known[key] for key in keys]

    def _siblings(self, old: FittedSet) -> list[FittedSet]:
        """Of each effect that has others of its kind (other time constants), the neighbours while they do better."""
        family: dict[Any, list[Candidate]] = defaultdict(list)
        for candidate in self.empty.wardrobe.candidates:
            if len(candidate.changes) > 1 and candidate.driver == "history":
                family[_family(candidate)].append(candidate)
        found, there = [], {_family(e.candidate) for e in old.fit.entries}
        for one, members in family.items():
            if one in there:
                continue
            members.sort(key=lambda c: sorted(c.changes.values()))
            at = [i for i, c in enumerate(members) if old.ids | {name_of(c)} in self.known]
            if len(members) < 2 or not at:
                continue
            best = min(at, key=lambda i: self.known[old.ids | {name_of(members[i])}].score)
            tried = set(at)
            while new := {i for i in (best - 1, best + 1) if 0 <= i < len(members)} - tried:
                size = self.known[old.ids | {name_of(members[best])}].fit.entries[-1].size
                for i in new:
                    found.append(self.extended(old, unsized(members[i], max(size, members[i].typical * 1e-3))))
                tried |= new
                best = min(tried, key=lambda i: self.known[old.ids | {name_of(members[i])}].score)
        return found

    def _finalists(self, old: FittedSet) -> list[Scored]:
        """The best candidates of each label: what re-tuning can nearly imitate shows its worth in the fit alone."""
        found = scores(self.empty.wardrobe, old.problem, old.fit)
        # One mass with two time constants is one mass with another.
        there = {_family(e.candidate) for e in old.fit.entries if e.candidate.slow_s}
        found = [s for s in found if _family(s.entry.candidate) not in there]
        kept: dict[str, Scored] = {}
        for order in (lambda s: -s.squares, lambda s: -s.likely):
            seen: Counter[tuple[Label, str]] = Counter()
            for scored in sorted(found, key=order):
                form = scored.entry.label, scored.entry.candidate.unit
                seen[form] += 1
                if seen[form] == 1:
                    kept.setdefault(name_of(scored.entry.candidate), scored)
        return list(kept.values())


def _family(candidate: Candidate) -> Any:
    return candidate.kind, candidate.where, candidate.unit, tuple(sorted(candidate.changes))


def by_score(one: FittedSet) -> float:
    return one.score


def by_squares(one: FittedSet) -> float:
    return one.squares
