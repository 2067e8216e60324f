"""Which explanations remain: those that are not worse than the best by more than can be told."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from twin.discovery.evidence.finding import Finding, Ranked
    from twin.discovery.scoring.search import Entry

LEAST_WEIGHT = 0.003
OPEN = 0.15
"""Share of the weight from which another driver of the same effect is worth an experiment."""
SHARE = 0.003
"""Of the gain: two explanations closer than this are not told apart, whatever the noise."""


def width(gain: float) -> float:
    """How much worse, in weighted squares, an explanation may be and still not be excluded; it grows with the gain,
    since at a large one the form assumed decides and not the noise."""
    return max(10.0, SHARE * gain)


def instead(other: Ranked, first: Ranked) -> Entry:
    """The effect of another explanation that stands where the first has something else, its last where none does."""
    known = {e.label for e in first.entries}
    return next((e for e in other.entries[::-1] if e.label not in known), other.entries[-1])


def remaining(finding: Finding) -> tuple[Ranked, ...]:
    """The answer and what cannot be told from it, one for each kind, place and driver."""
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
    """Of what remains, what is worth an experiment: all of it where the finding is ambiguous, else other drivers of
    the same effect that have some weight."""
    left = remaining(finding)
    if not left:
        return ()
    if not ambiguous:
        first = left[0].entries[-1].label
        left = (left[0], *(r for r in left[1:] if r.weight > OPEN and instead(r, left[0]).label[:2] == first[:2]))
    return left if len(left) > 1 else ()
