"""Effects that came and went: on for one spell inside a record, and over.

No element ends, so such an effect is described and never adopted. It has to be looked for all the same: what grows, or
follows the time of day, can imitate a spell nearly well enough to be believed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twin.discovery.diagnosis import Course, Effect
from twin.discovery.effects.laws import Law
from twin.discovery.effects.phrases import clock, said
from twin.discovery.scoring.contest import Contest
from twin.discovery.scoring.search import Entry
from twin.discovery.scoring.sweep import LAST_SHARE
from twin.discovery.selection.ranking import KINDS
from twin.gauss_newton import SE90
from twin.network import Array

SIMPLE = ("constant", "temperature_difference")
SIMPLER = 0.95
"""Share of the best gain that a plain law needs to be preferred: what it follows a spell can hardly tell."""
ALIKE = 10.0
"""Gains that differ by less say nothing; what is likelier beforehand is named."""
BETTER, BETTER_SHARE = 25.0, 0.02
"""Gain that a spell must have over everything that lasts, and share of the latter's."""
AS_SEVERAL = 0.95
"""Share of the gain of several effects that one spell needs to be believed instead of them."""
FREER = 1.05
"""Gain of effects, as multiples, that a free unknown must have to show that their form is another."""
MOST = 0.8
"""Share of twice a free unknown's log evidence that a spell must gain to stand for what nothing explains."""
_TINY = 1e-9


@dataclass(frozen=True)
class Spell:
    """A law that acts between two moments, s of the record; sizes are the candidate's, `gain` in weighted squares."""

    law: Law
    begin_s: float
    end_s: float
    size: float
    sd: float
    gain: float


def came_and_went(contest: Contest, laws: list[Law], lasting: list[Entry], chosen: tuple[Entry, ...]) -> Spell | None:
    """The best spell of any law, where it beats whatever lasts; None where nothing has ended.

    Args:
        lasting: what a scan of the same contest found. chosen: the effects of an answer that is believed so far, to a
            part of the record, which it has to beat as well; several of them it need only come near.
    """
    if not lasting:
        return None
    together = explained(contest, laws, chosen)
    rival = max(e.gain for e in lasting)
    if len(chosen) == 1:
        rival = max(rival, together)
    found = [s for law in laws if not law.candidate.begins and (s := _best(contest, law)) is not None]
    most = max((s.gain for s in found), default=0.0)
    if most < max(rival + max(BETTER, BETTER_SHARE * rival), AS_SEVERAL * together if len(chosen) > 1 else 0.0):
        return None
    plain = [s for s in found if s.gain >= max(SIMPLER * most, rival) and s.law.candidate.driver in SIMPLE]
    near = plain or [s for s in found if s.gain == most]
    top = max(s.gain for s in near)
    best = max((s for s in near if s.gain > top - ALIKE), key=lambda s: KINDS.get(s.law.candidate.kind, 0.5))
    return best if best.end_s < contest.hours[-1] * 3600.0 * LAST_SHARE else None


def explained(contest: Contest, laws: list[Law], chosen: tuple[Entry, ...]) -> float:
    """Gain of effects, their sizes fitted together, in a contest that knows their laws as `laws`."""
    here = {law.candidate.id: law for law in laws}
    answer = [replace(e, law=here[e.candidate.id]).placed(contest) for e in chosen]
    return contest.estimate(np.stack(answer)).gain if answer else 0.0


def outdone(gain: float, free: Course) -> bool:
    """Whether an unknown that is `free` to change from block to block says more than effects of a form and a size.

    It has to pay for its freedom, so it never does where their form is right, and hardly where it is nearly so.
    """
    return 2.0 * free.log_evidence > FREER * gain + BETTER


def explains(spell: Spell, free: Course) -> bool:
    """Whether a spell says nearly as much as an unknown that is `free` to change from block to block."""
    return spell.gain >= MOST * 2.0 * free.log_evidence


def described(spell: Spell) -> dict[str, Any]:
    """A spell as the description of something unexplained; times in s of the record."""
    c = spell.law.candidate
    return {
        "site": c.where, "unit": c.unit, "like": {"kind": c.kind, "where": c.where, "driver": c.driver},
        "mean": spell.size, "mean_sd": spell.sd, "onset_s": spell.begin_s, "end_s": spell.end_s, "driver": "history",
    }  # fmt: skip


def as_effect(spell: Spell, contest: Contest, start: float) -> Effect:
    """A spell as an effect of kind `unknown`, its times from `start`, s, and as sure as a block is long."""
    c, spread, onset = spell.law.candidate, SE90 * spell.sd, start + spell.begin_s
    return Effect(
        kind="unknown", where=c.where, driver="history", change="new", value=spell.size, unit=c.unit,
        interval90=(spell.size - spread, spell.size + spread), onset_s=onset,
        onset_interval90_s=(max(onset - contest.step_s, start), onset + contest.step_s), shape="spell",
        confidence=1.0, z=float(np.sqrt(spell.gain)),
        evidence="nothing that lasts explains the record as well as something that came and went",
        says=f"{said(c, spell.size)}, from {clock(onset)} to {clock(start + spell.end_s)}, and no longer",
    )  # fmt: skip


def _best(contest: Contest, law: Law) -> Spell | None:
    """The spell of a law with the greatest gain, of two blocks or more."""
    gram, score = contest.small(contest.vector(law))
    b = contest.b
    sums, tops = np.zeros((b + 1, b + 1)), np.concatenate([[0.0], np.cumsum(score)])
    sums[1:, 1:] = gram.cumsum(axis=0).cumsum(axis=1)
    first, last = np.triu_indices(b + 1, 2)
    bottom: Array = sums[last, last] - sums[first, last] - sums[last, first] + sums[first, first]
    bottom = np.maximum(bottom, _TINY * max(float(np.diag(sums).max()), _TINY))
    top = tops[last] - tops[first]
    c = law.candidate
    size = np.clip(top / bottom, c.lower, c.upper)
    gain = np.where(np.abs(size) >= c.lumped, (2.0 * top - bottom * size) * size, 0.0)
    k = int(np.argmax(gain))
    if gain[k] <= 0.0:
        return None
    edges_s = contest.edges * contest.grid.step_s
    return Spell(
        law, float(edges_s[first[k]]), float(edges_s[last[k]]), float(size[k]), float(bottom[k]) ** -0.5, float(gain[k])
    )
