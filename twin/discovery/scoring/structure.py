"""Model error of a twin in the terms of the catalogue, estimated from the healthy record.

A twin is lumped and its rig is not: water on its way through a tank of three zones reads like two litres of hose, a
heater's element like a late heater. All of that is there in health, so it is no finding; left out, it would be found in
the next record under those names, or bend what is there. So before anything is looked for, every law of the catalogue
that does not follow time is given an amplitude all along: a priori normal about none, with one and the same multiple of
the laws' typical sizes as standard deviation, which the healthy record chooses by its evidence. What that record leaves
them at, jointly, is taken from the next one, and how far it leaves them open is part of that record's noise.

Source: Kennedy & O'Hagan, J. R. Stat. Soc. B 63 (2001) 425 (a discrepancy beside a calibrated simulator), with a basis
of physical laws; the width by type II maximum likelihood (Rasmussen & Williams, Gaussian Processes, 2006, sec. 5.4.1).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import block_diag, cho_factor, cho_solve

from twin.discovery.effects.laws import CandidateLaw
from twin.discovery.effects.phrases import said
from twin.discovery.scoring.score_tests import ScoreTest
from twin.elements.candidates import Candidate
from twin.network import Array

WIDTHS = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6)
"""Typical sizes that are tried as the standard deviation of amplitudes."""
NAMED, PLAIN = 3, 3.0
"""Laws that are named to an operator at most, and the score from which one is."""
SPEAKS = 5.0
"""Logarithm of the odds from which a record speaks for offsets at operating points."""
_OF_TIME = ("elapsed_time", "time_of_day")


@dataclass(frozen=True)
class Structure:
    """Amplitudes of laws all along.

    Attributes:
        candidates: l of them. sizes: (l,) in their units. covariance: (l, l).
        width: standard deviation of offsets at operating points before the record was seen, in typical sizes; 0 where
            it speaks for none. evidence: logarithm of the record's probability.
        moves: candidate id -> (q,) move of the tunables, z, that goes with a unit of it; none for most.
    """

    candidates: tuple[Candidate, ...]
    sizes: Array
    covariance: Array
    width: float = 0.0
    evidence: float = -np.inf
    moves: Mapping[str, Array] = field(default_factory=dict)

    def moved(self, which: Sequence[int], q: int) -> Array:
        """Return the moves (q, n) of the tunables with a unit of each of n candidates."""
        none = np.zeros(q)
        return np.array([self.moves.get(self.candidates[i].id, none) for i in which]).reshape(-1, q).T

    def with_laws(self, candidates: Sequence[Candidate], sizes: Array, covariance: Array, moves: Array) -> Structure:
        """Return the same with laws (n,) of which a healthy record says so much for itself.

        Args:
            sizes: (n,). covariance: (n, n). moves: (q, n) of the tunables with a unit of each.
        """
        ids = [c.id for c in candidates]
        rest = [i for i, c in enumerate(self.candidates) if c.id not in ids]
        return replace(
            self,
            candidates=(*(self.candidates[i] for i in rest), *candidates),
            sizes=np.concatenate([self.sizes[rest], sizes]),
            covariance=block_diag(self.covariance[np.ix_(rest, rest)], covariance),
            moves={**self.moves, **dict(zip(ids, moves.T, strict=True))},
        )

    def beyond(self, offsets: Sequence[CandidateLaw]) -> Structure:
        """The same with offsets at points of another record that the healthy one could say nothing of."""
        if not self.width:
            return self
        known = {c.id for c in self.candidates}
        new = tuple(law.candidate for law in offsets if law.candidate.id not in known)
        alone = np.array([self.width * c.typical for c in new]) ** 2
        covariance = block_diag(self.covariance, np.diag(alone)) if new else self.covariance
        sizes = np.append(self.sizes, np.zeros(len(new)))
        return replace(self, candidates=(*self.candidates, *new), sizes=sizes, covariance=covariance)

    @property
    def sentence(self) -> str:
        """Name the plainest of it to an operator; "" where nothing is plain.

        Laws that act alike share what the record shows, so that no amplitude is an estimate of its law by itself.
        An amplitude that its law cannot have, such as a negative delay, is part of the basis and no physics: unnamed.
        """
        z = np.abs(self.sizes) / np.sqrt(np.diag(self.covariance))
        plain: dict[tuple[str, str, str], str] = {}
        for i in np.argsort(-z)[: int((z > PLAIN).sum())]:
            c, size = self.candidates[i], float(self.sizes[i])
            if c.lower <= size <= c.upper:
                plain.setdefault((c.kind, c.where, c.driver), said(c, size))
        told = "; ".join(list(plain.values())[:NAMED])
        return (
            f"the error that this twin already has in the healthy record resembles what these would cause: {told}; "
            "it is expected again, and none of them is claimed"
            if told
            else ""
        )


def structure_of(score_test: ScoreTest, laws: list[CandidateLaw], offsets: Sequence[CandidateLaw]) -> Structure:
    """What each law amounts to in the healthy record that the score test holds, all of them together.

    With offsets at operating points where the record speaks for them: a twin that is its rig has none.
    """
    plain = _fitted(score_test, laws)
    both = _fitted(score_test, [*laws, *offsets]) if offsets else plain
    return both if both.evidence > plain.evidence + SPEAKS else replace(plain, width=0.0)


def _fitted(score_test: ScoreTest, laws: list[CandidateLaw]) -> Structure:
    used = [law for law in laws if belongs(law.candidate, score_test)]
    gram, score = score_test.joint(np.stack([score_test.vector(law) for law in used]))
    # The noise was learned from the same record and holds the structure: it is not taken for more than it is.
    closer = max(score_test.expected / max(score_test.chi, 1e-9), 1.0)
    gram, score = closer * gram, closer * score
    typical = np.array([law.candidate.typical for law in used])
    scaled, pull = gram * np.outer(typical, typical), score * typical
    best: tuple[float, Array, Array, float] | None = None
    for width in WIDTHS:
        precision = np.eye(len(used)) + width**2 * scaled
        factor = cho_factor(precision, lower=True)
        sizes = width**2 * cho_solve(factor, pull)
        evidence = 0.5 * float(pull @ sizes) - float(np.log(np.diag(factor[0])).sum())
        if best is None or evidence > best[0]:
            covariance = width**2 * cho_solve(factor, np.eye(len(used)))
            best = evidence, sizes, covariance, width
    assert best is not None
    evidence, sizes, covariance, width = best
    candidates = tuple(law.candidate for law in used)
    return Structure(candidates, sizes * typical, covariance * np.outer(typical, typical), width, evidence)


def belongs(candidate: Candidate, score_test: ScoreTest) -> bool:
    """Whether a law may be part of a twin's structure: it does not follow time, and nothing tunes it anyway."""
    return candidate.driver not in _OF_TIME and not set(candidate.changes) <= set(score_test.probe.scaling.ids)
