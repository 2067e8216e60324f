"""Hypotheses of a search by evidence, weighed by records made later."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin.discovery.refit.model import Model
from twin.discovery.refit.validation import validate
from twin.discovery.selection.ladder import MORE_LEFT, MORE_SHARE
from twin.discovery.selection.part import Part
from twin.discovery.selection.ranking import Finding, Ranked
from twin.discovery.selection.weighing import weigh


def weighed(finding: Finding, first: Part, later: Sequence[Part]) -> tuple[Finding, tuple[str, ...]]:
    """The finding with its hypotheses ranked by all records, and what is to be said of the later ones.

    What is said of the answer itself, its score and the blocks left out, stays that of the first record.
    """
    each = weigh(finding.ranked, later, finding.contest.grid.span_s)
    for part in later:
        part.reset()
    odds = np.array([
        math.log(max(r.weight, 1e-300)) - 0.5 * (w.fit.total - r.fit.total)
        for r, w in zip(finding.ranked, each, strict=True)
    ])  # fmt: skip
    shares = np.exp(odds - odds.max())
    shares /= shares.sum()
    order = np.argsort(-odds)
    told_later = [0.5 * (r.fit.total - w.fit.total) for r, w in zip(finding.ranked, each, strict=True)]
    ranked = tuple(
        Ranked(each[i].fit, -2.0 * float(odds[i]), float(shares[i]), finding.ranked[i].log_bayes + told_later[i])
        for i in order
    )
    at = int(order[0])
    best = finding.ranked[at].fit
    notes = [
        f"with the answer, later record {number} still leaves {chi:.2f} of misfit where noise alone leaves "
        f"{part.contest.expected:.2f}; there is more in it, so diagnose that record by itself"
        for number, (chi, part) in enumerate(zip(each[at].chis, later, strict=True), start=1)
        if chi > max(MORE_LEFT * part.contest.expected, MORE_SHARE * part.contest.chi)
    ]
    same = at == 0
    folds = finding.folds if same else validate(first.contest, Model.of(first.basis.probe, best.entries), best)
    first.reset()
    told = finding.fit if same else best
    return replace(finding, ranked=ranked, fit=told, entries=best.entries, folds=folds), tuple(notes)
