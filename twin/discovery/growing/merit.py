"""Tests of an effect in a fitted set: by the likelihood, and on held-out data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.discovery.effects.ambiguity_groups import EffectLabel
from twin.discovery.effects.phrases import said
from twin.discovery.growing.beam import Beam, FittedSet, by_score, by_squares, likeliest
from twin.discovery.growing.calibration import Chance, by_chance
from twin.discovery.growing.descent import Start, descend
from twin.discovery.growing.growth_problem import SampledRecord
from twin.discovery.growing.likelihood import cosines, judged
from twin.discovery.growing.superset.candidate_superset import name_of
from twin.discovery.scoring.equivalence import width
from twin.discovery.scoring.search import Entry
from twin.network import Array
from twin.quantiles import NORMAL90

LEFT = 1.3
"""Misfit, relative to noise, that a twin with the right effects may leave."""
NEEDED = 25.0
"""Least fall of -2 log likelihood by an effect, whatever its null distribution on this record."""
LEAST_LEFT = 4
"""Sets of one size, those of least squares, that may explain most of a record."""
CHECKED = 400
"""Sets, from the best, whose members are tested."""
REFUSED = 6
"""Rejected effects that are reported."""
FOLDS, PIECES = 4, 12
"""Folds of the cross-validation, and pieces of the record that are assigned to them in turn."""
BETTER_FOLDS = 3
"""Folds that an effect has to predict no worse than the set without it."""
MOSTLY = 0.5
"""Share of the squares beyond noise that may be left if most is explained."""
REST = 0.1
"""Share of the re-tuned twin's misfit that may be left beyond noise. A real rig never has exactly the assumed forms,
and without a healthy record its model error is unknown. Public records leave 0.03 to 0.07."""
SAME = 0.02
"""Relative difference of a fold's errors that counts as none."""


@dataclass(frozen=True)
class RejectedEffect:
    """Effect that was fitted and not added, and why."""

    kind: str
    where: str
    driver: str
    why: str
    gain: float


class Merit:
    """Tests of the fitted sets of a beam."""

    def __init__(self, beam: Beam) -> None:
        self._beam, self._none = beam, beam.known[frozenset()]
        self._more: tuple[SampledRecord, ...] = ()
        self._told: dict[frozenset[str], float] = {}
        self._chance: dict[frozenset[str], Chance] = {}
        rows = len(beam.empty.samples.time)
        self._piece = np.arange(rows) * PIECES // rows

    def earned(self) -> FittedSet:
        """Return the best set of which every member passes its tests."""
        asked: dict[frozenset[str], bool] = {}
        while True:
            # To ask is to fit what is left without a member, which may be better than anything so far.
            every = sorted(likeliest(self._beam.known.values()), key=by_score)[:CHECKED]
            one = next((s for s in every if asked.get(s.ids, True)), None)
            if one is None:
                break
            if one.ids in asked:
                return one
            asked[one.ids] = self._weakest(one) is None
        best = every[0]
        while best.fit.entries:
            weakest = self._weakest(best)
            if weakest is None:
                break
            best = self._beam.reduced(best, weakest)
        return best

    def explains(self, found: FittedSet) -> bool:
        """Return True for a set that leaves no more than noise, or than the model error of its assumed forms."""
        misfit, before = (float(np.nanmean((s.fit.rms / s.problem.samples.sigma) ** 2)) for s in (found, self._none))
        return misfit <= max(LEFT, REST * before)

    def is_rival(self, best: FittedSet, other: FittedSet) -> bool:
        """Return True for a set that may replace `best`.

        With structural error it must also leave squares beyond noise that are less than twice those of `best`.
        """
        return self.explains(best) or _beyond_noise(best) > MOSTLY * _beyond_noise(other)

    def essential(self, best: FittedSet) -> FittedSet:
        """Return a set without every effect that explains less than half of the squares that are left without it.

        With structural error a lesser effect may explain any part of that error.
        """
        while best.fit.entries:
            shares = [(_beyond_noise(best) / _beyond_noise(self._beam.reduced(best, e)), e) for e in best.fit.entries]
            share, entry = max(shares, key=lambda s: s[0])
            if share <= MOSTLY:
                break
            best = self._beam.reduced(best, entry)
        return best

    def main_effects(self, best: FittedSet) -> FittedSet:
        """Return the set that explains most of a record which no set explains fully.

        With structural error the likelihood treats slow misfit as noise, so the squares of held-out folds decide. The
        set has the size of the essential part of `best`, or more if sets of that size explain too little.
        """
        essential = self.essential(best)
        for level in self._beam.levels[max(len(essential.ids), 1) :]:
            leading = sorted(likeliest(level), key=by_squares)[:LEAST_LEFT]
            shares = [
                (share, s)
                for s in leading
                if not any(_at_bound(s, e) for e in s.fit.entries)
                for better, share in [self.on_hidden_rows(self._none, s, further=True)]
                if better >= BETTER_FOLDS and share <= MOSTLY
            ]
            if shares:
                return min(shares, key=lambda one: one[0])[1]
        return essential if essential.ids else best

    def reranked(self, best: FittedSet, more: tuple[SampledRecord, ...]) -> FittedSet:
        """Return the set that predicts further records best, without another fit.

        It is chosen among sets of about equal likelihood on this record. An effect just below the threshold on this
        record joins them if the further records support it.
        """
        if not more:
            return best
        limit = width(self._beam.levels[0][0].score - best.score)
        alike = [
            s
            for s in list(self._beam.known.values())
            if len(s.ids) == len(best.ids) and abs(s.score - best.score) < limit and self._weakest(s) is None
        ]
        self._more, told = more, self.elsewhere
        best = min((*alike, best), key=lambda s: s.score + told(s))
        while (weakest := self._weakest(best)) is not None:
            # What the further records speak against has lost its place.
            best = self._beam.reduced(best, weakest)
        while True:
            larger = [
                s
                for s in list(self._beam.known.values())
                if best.ids < s.ids and len(s.ids) == len(best.ids) + 1 and s.score < best.score
            ]
            larger = [s for s in larger if told(s) < told(best)]
            larger.sort(key=lambda s: s.score + told(s))
            joined = next((s for s in larger if self._weakest(s) is None), None)
            if joined is None:
                return best
            best = joined

    def refused(self, best: FittedSet) -> tuple[RejectedEffect, ...]:
        """Return the effects that would explain most of the remaining misfit, and why they were rejected."""
        found: dict[EffectLabel, RejectedEffect] = {}
        for one in sorted(likeliest(self._beam.known.values()), key=by_score):
            if not best.ids < one.ids or len(one.ids) != len(best.ids) + 1 or len(found) == REFUSED:
                continue
            entry = _new(best, one)
            why = self._why_not(best, one, entry)
            gain = best.fit.cost - one.fit.cost
            if gain > 1.0 and entry.label not in found:
                why = why or self._why_not_both(best, one)
                if entry.label in {e.label for e in best.fit.entries}:
                    span_s = one.problem.samples.span_s
                    why = f"{said(entry.candidate, entry.size, record_s=span_s)}, too: {why}"
                found[entry.label] = RejectedEffect(*entry.label, why, gain)
        return tuple(found.values())

    def _why_not_both(self, best: FittedSet, one: FittedSet) -> str:
        """Return why a set is rejected although the effect that it has beyond `best` passes its tests."""
        weakest = self._weakest(one)
        if weakest is not None:
            what = f"{weakest.label[0].replace('_', ' ')} at {weakest.label[1]}"
            return f"earns its place, but beside it {what} does not: {self._why_not_with(one, weakest)}"
        if self.elsewhere(one) >= self.elsewhere(best) and self._more:
            return "passes its tests, but the further records are predicted no better with it"
        return "earns its place, but is too unlikely before any data"

    def _why_not_with(self, one: FittedSet, entry: Entry) -> str:
        return self._why_not(self._beam.reduced(one, entry), one, entry)

    def elsewhere(self, one: FittedSet) -> float:
        """Return -2 log likelihood of the further records, with all but their initial states as fitted to the first."""
        if not self._more:
            return 0.0
        if one.ids not in self._told:
            self._told[one.ids] = sum(_prediction_cost(one, samples) for samples in self._more)
        return self._told[one.ids]

    def _weakest(self, found: FittedSet) -> Entry | None:
        """Return a member that fails its tests; of several the one with the least loss."""
        for entry in found.fit.entries:
            # Most sets fall to a smaller one that has been fitted already.
            rest = self._beam.known.get(found.ids - {name_of(entry.candidate)})
            if not self._more and rest is not None and rest.fit.cost - found.fit.cost < NEEDED:
                return entry
        smaller = ((self._beam.reduced(found, e), e) for e in found.fit.entries)
        for without, entry in sorted(smaller, key=lambda p: p[0].score):
            if self._why_not(without, found, entry):
                return entry
        return None

    def _why_not(self, without: FittedSet, found: FittedSet, entry: Entry) -> str:
        """Return why an effect fails its tests in a set, over all records; "" if it passes."""
        gain = without.fit.cost - found.fit.cost + self.elsewhere(without) - self.elsewhere(found)
        if gain < NEEDED:
            return f"gains {max(gain, 0.0):.0f} where {NEEDED:.0f} are asked for"
        if _at_bound(found, entry):
            return "ends on the bound of what is possible"
        chance = self.chance(without).limit
        if gain < chance:
            return f"gains {gain:.0f} where {chance:.0f} come by chance"
        better, share = self.on_hidden_rows(without, found)
        if better < BETTER_FOLDS or share >= 1.0:
            return f"predicts {better} of {FOLDS} held-out parts no worse, with {share:.2f} of their squares"
        return ""

    def chance(self, without: FittedSet) -> Chance:
        """Return the null distribution of the best further effect's gain on a set."""
        if without.ids not in self._chance:
            self._chance[without.ids] = by_chance(without.problem, without.fit)
        return self._chance[without.ids]

    def on_hidden_rows(self, without: FittedSet, found: FittedSet, *, further: bool = False) -> tuple[int, float]:
        """Return the folds that a set predicts no worse than a smaller one, and the ratio of their squares, on held-out
        rows.

        With `further` the squares include the further records.
        """
        squares = self.hidden(without, found).reshape(-1, FOLDS, 2).sum(axis=0)
        better = int((squares[:, 1] <= squares[:, 0] * (1.0 + SAME)).sum())
        total = squares.sum(axis=0)
        if further:
            total += [sum(_squares(one, samples) for samples in self._more) for one in (without, found)]
        return better, float(total[1] / max(total[0], 1e-12))

    def hidden(self, without: FittedSet, found: FittedSet) -> Array:
        """Return the squares (pieces, 2) that a smaller set and a set leave in each held-out piece of the record."""
        out = np.zeros((PIECES, 2))
        samples = found.problem.samples
        ways = [(fold, k, one) for fold in range(FOLDS) for k, one in enumerate((without, found))]
        hidden = [samples.without(self._piece % FOLDS == fold) for fold in range(FOLDS)]
        parts = [one.problem.with_entries(one.fit.entries, hidden[fold]) for fold, _, one in ways]
        ends = descend([Start(part, part.start(one.fit), one.fit) for part, (*_, one) in zip(parts, ways, strict=True)])
        for (fold, k, _), end in zip(ways, ends, strict=True):
            off = (samples.measured - end.readings) / samples.sigma
            for piece in range(fold, PIECES, FOLDS):
                out[piece, k] = float(np.nansum(off[self._piece == piece] ** 2))
        return out

    def pieces(self) -> list[tuple[int, int]]:
        """Return the first and last row of each piece."""
        rows = [np.flatnonzero(self._piece == k) for k in range(PIECES)]
        return [(int(r[0]), int(r[-1])) for r in rows]


def _new(small: FittedSet, large: FittedSet) -> Entry:
    """Return the effect that the larger of two sets has in addition."""
    return next(e for e in large.fit.entries if name_of(e.candidate) not in small.ids)


def _prediction_cost(one: FittedSet, samples: SampledRecord) -> float:
    """Return -2 log likelihood of another record, with all but its initial state as fitted to the first."""
    problem = one.problem.with_entries(one.fit.entries, samples)
    left = cosines(problem.residual(problem.carried(one.fit)), problem.present)
    return judged(left, samples.sigma)[0]


def _squares(one: FittedSet, samples: SampledRecord) -> float:
    """Return the squares over noise that a set leaves of another record, fitted as for `_prediction_cost`."""
    problem = one.problem.with_entries(one.fit.entries, samples)
    return float(np.nansum((problem.residual(problem.carried(one.fit)) / samples.sigma) ** 2))


def mostly_explained(after: float, before: float) -> bool:
    """Return True if misfit `after` is at most half of `before`, both beyond noise, or is little beyond noise.

    Both are mean squares relative to noise.
    """
    return after - 1.0 <= max(MOSTLY * (before - 1.0), LEFT - 1.0)


def _beyond_noise(one: FittedSet) -> float:
    return max(one.squares - float(np.isfinite(one.problem.samples.measured).sum()), 1e-12)


def _at_bound(found: FittedSet, entry: Entry) -> bool:
    """Return True for a size whose 90 % interval reaches a bound beyond which it may lie as well.

    The least of what the twin has counts, too: without a healthy record its value is not known.
    """
    size, candidate = entry.size, entry.candidate
    if size <= candidate.lower or candidate.at_bound(size):
        return True
    reach = NORMAL90 * float(found.fit.deviations[found.fit.entries.index(entry)])
    return candidate.at_bound(size + reach) or (candidate.lower < 0.0 and candidate.at_bound(size - reach))
