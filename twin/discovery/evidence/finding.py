"""Finding of a search: fitted explanations with their posterior probabilities."""

from __future__ import annotations

import math
from dataclasses import dataclass

from twin.discovery.diagnosis import Fold, Rung
from twin.discovery.refit.fitting import Fit
from twin.discovery.scoring.score_tests import ScoreTest
from twin.discovery.scoring.search import Entry
from twin.network import Array


@dataclass(frozen=True)
class Ranked:
    """Fitted set of effects: `cost` is -2 times its log posterior odds, `weight` its posterior probability, `log_bayes`
    its log Bayes factor over no effect.
    """

    fit: Fit
    cost: float
    weight: float
    log_bayes: float = 0.0

    @property
    def entries(self) -> tuple[Entry, ...]:
        return self.fit.entries


@dataclass(frozen=True)
class Finding:
    """Result of a search; `fit` is None if nothing reached the odds of a claim.

    Attributes:
        retuned: the tunables alone, fitted anew. ranked: explanations, the answer first. scanned: single effects by
            falling evidence. start, count: misfit without any effect, and the number of block means.
        odds: log posterior odds of the likeliest effects against none. unlisted: those of an unknown quantity of no
            listed form.
        claim: log odds from which an effect is claimed. together: two effects that explain the record and begin at one
            moment, so that one cause of no listed form is likelier than two.
    """

    entries: tuple[Entry, ...]
    fit: Fit | None
    retuned: Fit
    ranked: tuple[Ranked, ...]
    scanned: tuple[Entry, ...]
    start: float
    count: int
    ladder: tuple[Rung, ...]
    score_test: ScoreTest
    state: Array
    claim: float
    folds: tuple[Fold, ...] = ()
    odds: float = -math.inf
    unlisted: float = -math.inf
    together: tuple[Entry, Entry] | None = None
