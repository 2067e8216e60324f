"""Hypotheses weighed by records made later: each must explain them too, at about the size that it had.

Where even the best leaves more than noise, its misfit stands for the variance (quasi-likelihood; McCullagh & Nelder,
Generalized Linear Models, 2nd ed., sec. 9.2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

from twin.discovery.effects.laws import Law
from twin.discovery.planning.design import from_the_start
from twin.discovery.refit.fitting import Fit, fit
from twin.discovery.refit.model import Model
from twin.discovery.scoring.contest import Contest
from twin.discovery.scoring.search import Entry
from twin.network import Array

if TYPE_CHECKING:
    from twin.discovery.selection.ranking import Ranked

SAME_SIZE = 0.05
"""Share by which an effect's size may differ from record to record without that counting against it."""


class Part(Protocol):
    """A later record, ready to be searched."""

    @property
    def contest(self) -> Contest: ...
    @property
    def laws(self) -> list[Law]: ...
    @property
    def state(self) -> Array: ...
    def reset(self) -> None:
        """Let the contest look at the twin as it was."""


@dataclass(frozen=True)
class Weighed:
    """A hypothesis with later records: `fit` of the first record, its total that of all; `chis` (parts,): misfit that
    it leaves in each later one."""

    fit: Fit
    chis: tuple[float, ...]


def weigh(ranked: Sequence[Ranked], parts: Sequence[Part], span_s: float) -> list[Weighed]:
    """Each hypothesis over all records; in the later ones its effects are there throughout, as they ended in the first.

    Args:
        span_s: length of the first record, at whose end the effects have the sizes that they go on with.
    """
    totals = [hypothesis.fit.total for hypothesis in ranked]
    chis: list[list[float]] = [[] for _ in ranked]
    for part in parts:
        laws = {law.candidate.id: law for law in part.laws}
        costs = []
        for i, hypothesis in enumerate(ranked):
            # An effect that does nothing in a later record leaves the twin as it is there.
            before = [e for e in hypothesis.entries if e.candidate.id in laws]
            grown = [e.shape.entered.mean(span_s - 1.0, span_s) for e in before]
            entries = tuple(
                from_the_start(replace(e, law=laws[e.candidate.id]), share * e.size).refreshed(part.contest)
                for e, share in zip(before, grown, strict=True)
            )
            part.reset()
            fitted = fit(part.contest, Model.of(part.contest.probe, entries), part.state)
            sizes = zip(before, grown, fitted.entries, strict=True)
            costs.append(fitted.total + sum(_apart(e, share, later) for e, share, later in sizes))
            chis[i].append(fitted.chi)
        # What even the best leaves over noise is the twin's own error: differences count by as much less.
        excess = max(min(chi[-1] for chi in chis) / part.contest.expected, 1.0)
        totals = [total + cost / excess for total, cost in zip(totals, costs, strict=True)]
    return [
        Weighed(replace(hypothesis.fit, total=total), tuple(chi))
        for hypothesis, total, chi in zip(ranked, totals, chis, strict=True)
    ]


def _apart(first: Entry, grown: float, later: Entry) -> float:
    """What two sizes of one effect, fitted apart, cost in weighted squares; of the first, its `grown` share."""
    size, sd = grown * first.size, grown * first.sd
    spread = sd**2 + later.sd**2 + (SAME_SIZE * size) ** 2
    return (size - later.size) ** 2 / max(spread, 1e-30)
