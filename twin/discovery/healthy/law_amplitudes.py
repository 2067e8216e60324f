"""Amplitudes of laws that a twin lacked already in health, as a healthy record estimates them.

A lumped twin lacks laws of its rig from the start: the lag of a stratified tank, a pipe's delay, a loss by radiation.
Commissioning compensates each by the tunables as far as possible. Under another load the rest appears as an effect that
is present from the record's beginning. Such a law has an amplitude in the healthy record too, often with a large
uncertainty. This module computes its distribution, and the change of the tunables that goes with it.

With whitened residual r, sensitivities J of tunables and initial state, and signatures V of laws at size 1, amplitudes
have precision V' P V and score V' P r; P is the projection onto the complement of J. The tunables change by
-(J'J)^-1 J'V for a unit of each law. Source: partitioned normal equations (Frisch & Waugh, Econometrica 1 (1933) 387).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from twin.commissioning import weak_prior
from twin.discovery.effects.laws import Book, CandidateLaw
from twin.discovery.effects.phrases import said
from twin.discovery.effects.probe import FreeRun, Probe
from twin.discovery.records.grid import Grid
from twin.discovery.records.noise import Noise
from twin.discovery.scoring.score_tests import ScoreTest
from twin.elements.candidates import Candidate
from twin.network import Array

STATE_SD_K = 0.3
"""Standard deviation of a record's initial state, K, about the state that fits its first minutes."""


@dataclass(frozen=True)
class Amplitudes:
    """Amplitudes of laws in a healthy record, jointly and without a prior.

    Attributes:
        candidates: l of them, those with an influence on the healthy record.
        precision: (l, l) tunables and initial state projected out. score: (l,).
        moves: (q, l) change of the present twin's tunables, z, for a unit of each law.
    """

    candidates: tuple[Candidate, ...]
    precision: Array
    score: Array
    moves: Array

    def log_ratio(self, sizes: Array) -> float:
        """Return the log likelihood ratio of these sizes (l,) over none of the laws, in the healthy record."""
        return float(self.score @ sizes - 0.5 * sizes @ self.precision @ sizes)

    def of(self, which: Sequence[int]) -> Amplitudes:
        """Return the amplitudes of some of the laws, by their numbers, with the others at zero."""
        at = list(which)
        few = tuple(self.candidates[i] for i in at)
        return Amplitudes(few, self.precision[np.ix_(at, at)], self.score[at], self.moves[:, at])

    def with_unknown(self, candidates: Sequence[Candidate]) -> Amplitudes:
        """Return the amplitudes with those of further laws, of which the healthy record says nothing."""
        known = {c.id for c in self.candidates}
        others = tuple(c for c in candidates if c.id not in known)
        return Amplitudes(
            (*self.candidates, *others),
            block_diag(self.precision, np.zeros((len(others), len(others)))),
            np.append(self.score, np.zeros(len(others))),
            np.hstack([self.moves, np.zeros((len(self.moves), len(others)))]),
        )


@dataclass(frozen=True)
class HealthyResidual:
    """Healthy record with its twin's residual: `run` from `state` on `grid`, and the `noise` of the residual."""

    probe: Probe
    book: Book
    grid: Grid
    state: Array
    run: FreeRun
    noise: Noise

    @cached_property
    def _score_test(self) -> ScoreTest:
        probe = self.probe
        values = probe.network.values[probe.scaling.index]
        prior = weak_prior(probe.scaling, values, self.state[: probe.k], STATE_SD_K)
        return ScoreTest(probe, self.grid, self.state, self.run, self.noise, prior)

    def amplitudes(self, candidates: Sequence[Candidate], tunables: tuple[str, ...]) -> Amplitudes:
        """Return the amplitudes of laws in this record; laws without an influence on it are left out.

        Args:
            tunables: ids (q,) of the present twin, which may have others than the one of this record.
        """
        # A law that a revision has adopted has the name that it had as an addition, and is a change of an element that
        # the twin of this record lacks.
        own = {c.id: c for c in self.book.candidates}
        here = {c.id: c for c in candidates if c.id in own and own[c.id].change == c.change}
        # What a law adds may have been adopted with another one, as the actuator of a limit: the twin of this record
        # still lacks it.
        laws = self.book.laws(self.grid, self.run, tuple(own[name] for name in here))
        return self.amplitudes_of([replace(law, candidate=here[law.candidate.id]) for law in laws], tunables)

    def amplitudes_of(self, laws: Sequence[CandidateLaw], tunables: tuple[str, ...]) -> Amplitudes:
        """Return the amplitudes of laws on this record; `tunables` as of `amplitudes`."""
        score_test, ids = self._score_test, self.probe.scaling.ids
        if not laws:
            return Amplitudes((), np.zeros((0, 0)), np.zeros(0), np.zeros((len(tunables), 0)))
        signatures = score_test.signatures(np.stack([score_test.vector(law) for law in laws]))
        moves, precision, score = score_test.beside_tunables(signatures)
        named = dict(zip(ids, moves[: self.probe.q], strict=True))
        of_twin = np.stack([named.get(t, np.zeros(len(laws))) for t in tunables])
        return Amplitudes(tuple(law.candidate for law in laws), precision, score, of_twin)


@dataclass(frozen=True)
class MissingInHealth:
    """Laws that a twin lacked already in health: `sizes` (n,) by the healthy record and the present one."""

    candidates: tuple[Candidate, ...]
    sizes: Array

    @property
    def sentence(self) -> str:
        """Return a sentence that names the laws."""
        told = "; ".join(said(c, float(x)) for c, x in zip(self.candidates, self.sizes, strict=True))
        return f"as far as the healthy record tells, this may always have been so and is not taken for a change: {told}"
