"""What a healthy record says of laws that the twin lacked in health already.

A lumped twin lacks laws of its rig from the start: the lag of a stratified tank, a pipe's delay, a loss by radiation.
The tunables take up what they can of each while the twin is commissioned. Under another load the rest shows as an
effect that is there from the record's beginning. Such a law has an amplitude in the healthy record too, often a vague
one. Here is its distribution, with the move of the tunables that goes with it.

With whitened residual r, sensitivities J of tunables and initial state, and signatures V of laws at size 1, amplitudes
have precision V' P V and score V' P r; P is the projection that takes out what J explains. The tunables move by
-(J'J)^-1 J'V for a unit of each law. Source: partitioned normal equations (Frisch & Waugh, Econometrica 1 (1933) 387).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twin.commissioning import weak_prior
from twin.discovery.effects.laws import Book
from twin.discovery.effects.phrases import said
from twin.discovery.effects.probe import FreeRun, Probe
from twin.discovery.records.grid import Grid
from twin.discovery.records.noise import Noise
from twin.discovery.scoring.score_tests import ScoreTest
from twin.elements.candidates import Candidate
from twin.network import Array

STATE_SD_K = 0.3
"""Standard deviation of the state that a record begins with, K, about that which fits its first minutes."""


@dataclass(frozen=True)
class Amplitudes:
    """What a healthy record says of laws at once, before any prior of their sizes.

    Attributes:
        candidates: l of them, those that do something in the healthy record.
        precision: (l, l) tunables and initial state projected out. score: (l,).
        moves: (q, l) of the tunables of the twin at hand, z, with a unit of each law.
    """

    candidates: tuple[Candidate, ...]
    precision: Array
    score: Array
    moves: Array


@dataclass(frozen=True)
class HealthyResidual:
    """A healthy record as its twin leaves it: `run` from `state` on `grid`, with the `noise` of what is left."""

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
        """Return what this record says of laws; of those that do nothing in it, nothing.

        Args:
            tunables: ids (q,) of the twin at hand, which may have others than the one of this record.
        """
        score_test, ids = self._score_test, self.probe.scaling.ids
        # A law that a revision has adopted has the name that it had as an addition, and is a change of an element that
        # the twin of this record lacks.
        own = {c.id: c for c in self.book.candidates}
        here = tuple(c for c in candidates if c.id in own and own[c.id].change == c.change)
        laws = self.book.laws(self.grid, self.run, here)
        if not laws:
            return Amplitudes((), np.zeros((0, 0)), np.zeros(0), np.zeros((len(tunables), 0)))
        signatures = score_test.signatures(np.stack([score_test.vector(law) for law in laws]))
        moves, precision, score = score_test.beside_tunables(signatures)
        named = dict(zip(ids, moves[: self.probe.q], strict=True))
        of_twin = np.stack([named.get(t, np.zeros(len(laws))) for t in tunables])
        return Amplitudes(tuple(law.candidate for law in laws), precision, score, of_twin)


@dataclass(frozen=True)
class MissingInHealth:
    """Laws that a twin lacked in health already: `sizes` (n,) by the healthy record and this one."""

    candidates: tuple[Candidate, ...]
    sizes: Array

    @property
    def sentence(self) -> str:
        """Name the laws to an operator."""
        told = "; ".join(said(c, float(x)) for c, x in zip(self.candidates, self.sizes, strict=True))
        return f"the healthy record speaks for this too, so it is taken as known and not as a change: {told}"
