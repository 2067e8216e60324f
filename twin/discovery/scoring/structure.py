"""Known structure: model error of a twin in the terms of the catalogue, estimated from the healthy record.

A twin is lumped and its rig is not: transport through a tank of three zones resembles two litres of hose, a heater's
element a lagging heater. This model error is present in health and no fault. Unmodelled, it would appear in the next
record under those names, or bias the estimates of true faults. Before any search, every law of the catalogue that does
not follow time therefore has an amplitude throughout. Its prior is normal about zero, with one multiple of the laws'
typical sizes as standard deviation, which the evidence of the healthy record selects. The joint posterior mean is
subtracted from the next record, and the posterior covariance is part of that record's noise.

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
"""Prior standard deviations of amplitudes that are tried, in typical sizes."""
NAMED, PLAIN = 3, 3.0
"""Laws that a report names at most, and the score from which one is named."""
SPEAKS = 5.0
"""Log odds from which a record supports offsets at operating points."""
OF_TIME = ("elapsed_time", "time_of_day")
"""Drivers that are no state, flow or command of a rig."""


@dataclass(frozen=True)
class Structure:
    """Amplitudes of laws that are present throughout.

    Attributes:
        candidates: l of them. sizes: (l,) in their units. covariance: (l, l).
        width: prior standard deviation of offsets at operating points, in typical sizes; 0 if the record supports none.
            evidence: log marginal likelihood of the record.
        moves: candidate id -> (q,) change of the tunables, z, for a unit of it; none for most.
    """

    candidates: tuple[Candidate, ...]
    sizes: Array
    covariance: Array
    width: float = 0.0
    evidence: float = -np.inf
    moves: Mapping[str, Array] = field(default_factory=dict)

    def moved(self, which: Sequence[int], q: int) -> Array:
        """Return the changes (q, n) of the tunables for a unit of each of n candidates."""
        none = np.zeros(q)
        return np.array([self.moves.get(self.candidates[i].id, none) for i in which]).reshape(-1, q).T

    def with_laws(self, candidates: Sequence[Candidate], sizes: Array, covariance: Array, moves: Array) -> Structure:
        """Return the structure with further laws (n,), with the amplitudes of a healthy record.

        Args:
            sizes: (n,). covariance: (n, n). moves: (q, n) of the tunables for a unit of each.
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
        """Return the structure with offsets at operating points of another record that the healthy one did not
        visit.
        """
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
        """Return a sentence with the most significant laws; "" if none is significant.

        Laws with similar signatures share an amplitude, so that none estimates its law by itself. An amplitude that its
        law cannot have, such as a negative delay, is part of the basis without physical meaning and is not named.
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
    """Return the joint amplitudes of laws in the healthy record that the score test holds.

    Offsets at operating points are included if the record supports them.
    """
    plain = _fitted(score_test, laws)
    both = _fitted(score_test, [*laws, *offsets]) if offsets else plain
    return both if both.evidence > plain.evidence + SPEAKS else replace(plain, width=0.0)


def _fitted(score_test: ScoreTest, laws: list[CandidateLaw]) -> Structure:
    """Return the amplitudes of laws at the width, in typical sizes, that has the largest evidence."""
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
    """Return True if a law may be part of a twin's structure: it does not follow time, and is no tunable.

    A thermometer sticks or it does not: a share of it is no model error, and those of several levels together are an
    error of gain and offset of any size.
    """
    tunable = set(candidate.changes) <= set(score_test.probe.scaling.ids)
    return candidate.driver not in OF_TIME and not candidate.has_level and not tunable
