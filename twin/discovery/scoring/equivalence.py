"""Ambiguity group of a finding: explanations that are not significantly worse than the best."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from twin.discovery.evidence.finding import Finding, Ranked
    from twin.discovery.scoring.search import Entry

LEAST_WEIGHT = 0.003
"""Posterior probability above which an explanation stays in the ambiguity group."""
OPEN = 0.15
"""Posterior probability from which another driver of the same effect justifies an experiment."""
SHARE = 0.003
"""Share of the gain within which two explanations are indistinguishable, whatever the noise."""


def width(gain: float) -> float:
    """Return the excess of weighted squares up to which an explanation is not excluded.

    It grows with the gain: at a large gain the assumed form decides, and not the noise.
    """
    return max(10.0, SHARE * gain)


def instead(other: Ranked, first: Ranked) -> Entry:
    """Return the effect of another explanation that replaces one of the first, or its last effect if none does."""
    known = {e.label for e in first.entries}
    return next((e for e in other.entries[::-1] if e.label not in known), other.entries[-1])


def remaining(finding: Finding) -> tuple[Ranked, ...]:
    """Return the answer and its ambiguity group, one explanation for each kind, place and driver."""
    if not finding.ranked:
        return ()
    first = finding.ranked[0]
    taken = {e.label for e in first.entries[:-1]}
    found: dict[tuple[str, str, str], Ranked] = {}
    for r in finding.ranked:
        label = instead(r, first).label
        if label in found or label in taken:
            continue
        if r is first or r.weight > LEAST_WEIGHT:
            found[label] = r
    return tuple(found.values())


def open_questions(finding: Finding, ambiguous: bool) -> tuple[Ranked, ...]:
    """Return the explanations that justify an experiment.

    These are all that remain if the finding is ambiguous, else other drivers of the same effect with enough
    probability.
    """
    left = remaining(finding)
    if not left:
        return ()
    if not ambiguous:
        first = left[0].entries[-1].label
        left = (left[0], *(r for r in left[1:] if r.weight > OPEN and instead(r, left[0]).label[:2] == first[:2]))
    return left if len(left) > 1 else ()
