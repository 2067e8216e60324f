"""Sentences of a diagnosis: effects, odds and the summary."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from twin.discovery.diagnosis import Alternative, Effect, SensorError, Verdict
from twin.discovery.effects.phrases import SHORT_S, amount, clock, lasting, said, when
from twin.discovery.effects.statement import disturbance_statement
from twin.discovery.evidence.held_out import MUCH_WORSE, leaves_more_squares
from twin.discovery.places.sites import spoken
from twin.discovery.scoring.equivalence import OPEN
from twin.discovery.scoring.search import Entry

if TYPE_CHECKING:
    from twin.discovery.evidence.finding import Finding

MOST_SAID = 14.0
"""Log odds, of a million to one, beyond which the number is not written out."""
RETUNED = 1.5
"""Ratio of the commissioned twin's error to the re-tuned one's from which the summary gives both."""
MEGA = 1e6
"""Heat, J, from which it is given in megajoules."""
_UNKNOWN = {
    "constant": "by the same amount throughout",
    "periodic": "again and again",
    "threshold": "on or off with little between",
    "history": "in a course that follows no input",
    "elapsed_time": "by an amount that changes as time goes on",
}
"""Courses of an unknown quantity that follow no column, in words."""
_DRIVEN = {"threshold": "a temperature that switches it"}


def sentence(entry: Entry, start: float = 0.0, grown: float = 1.0, spread: float = 0.0) -> str:
    """Return an effect in words; `grown` is the share of its size that it has reached, `spread` half its interval."""
    text = said(entry.candidate, entry.size * grown, spread)
    since = when(entry.shape, start)
    if entry.shape.name == "ramp":
        until = f" for {clock(entry.shape.growth_s)}" if grown >= 1.0 else ""
        return f"{text} by the end, having grown steadily {since}{until}"
    if entry.shape.name == "saturating":
        return f"{text} by the end, growing {since} with a time constant of {clock(entry.shape.growth_s)}"
    if entry.shape.name == "transient":
        first, length_s = start + entry.shape.onset_s, entry.shape.growth_s
        if length_s < SHORT_S:
            return f"{text}, at {clock(first)} for {lasting(length_s)}, and no longer{_in_all(entry)}"
        return f"{text}, from {clock(first)} to {clock(first + length_s)}, and no longer{_in_all(entry)}"
    if entry.shape.name == "periodic":
        on = entry.shape.duty * entry.shape.growth_s
        return f"{text}, {since} for {clock(on)} in every {clock(entry.shape.growth_s)}"
    if entry.shape.name == "pulse":
        fading = lasting(entry.shape.growth_s)
        at = clock(start + entry.shape.onset_s)
        return f"{text} at {at}, fading with a time constant of {fading}{_in_all(entry)}"
    return f"{text}, {since}"


def _in_all(entry: Entry) -> str:
    """Return the total mass of water that was filled in, or the total heat of a constant power, in words."""
    total, unit = entry.size * entry.shape.growth_s, entry.candidate.unit
    if unit == "W" and entry.candidate.driver == "constant":
        return f"; {amount(total * 1e-3, 'kJ') if abs(total) < MEGA else amount(total * 1e-6, 'MJ')} in all"
    return f"; {total:.2g} kg in all" if unit == "kg/s" else ""


def odds_of_best(finding: Finding) -> str:
    """Return the posterior odds of the likeliest effect of a record that needs none, in words."""
    best = max(finding.odds, finding.unlisted)
    if best < 0.0:
        return "the twin without any effect is the most probable explanation"
    if best >= finding.claim:
        return f"the likeliest effect has {chances(best)}, and a note says why it is not claimed"
    return f"the likeliest effect has {chances(best)}, and a claim needs {chances(finding.claim)}"


def chances(log_odds: float) -> str:
    """Return odds against no effect in words, with their natural logarithm."""
    times = f"{float(f'{math.exp(log_odds):.1g}'):,.0f} to one" if log_odds < MOST_SAID else "over a million to one"
    return f"odds of {times} (ln {log_odds:.1f})"


def summarise(
    verdict: Verdict,
    effects: tuple[Effect, ...],
    errors: dict[str, SensorError],
    others: tuple[Alternative, ...],
    description: dict[str, Any],
    finding: Finding,
) -> str:
    """Return the summary of a verdict: effects or their absence, held-out errors, and the ambiguity group."""
    if verdict == "adequate":
        stale = max(errors, key=lambda n: errors[n].stale / errors[n].noise) if errors else ""
        moved = bool(stale) and errors[stale].stale > RETUNED * errors[stale].before
        off = f" On the held-out segment, {stale} is off by {errors[stale].stale:.2g} K" if moved else ""
        return (
            f"{'Re-tuned, the' if moved else 'The'} twin is adequate: this record needs no further effect "
            f"({odds_of_best(finding)})."
        ) + (f"{off}, re-tuned by {errors[stale].before:.2g} K." if moved else "")
    worst = max(errors, key=lambda n: errors[n].before / errors[n].noise) if errors else ""
    fit_text = ""
    if worst and finding.fit is not None:
        e = errors[worst]
        fit_text = (
            f" On the held-out segment, {worst} is off by {e.stale:.2g} K, by {e.before:.2g} K when "
            f"re-tuned, by {e.after:.2g} K with the new term, at a noise of {e.noise:.2g} K."
        )
    if verdict == "unexplained":
        if not effects and finding.fit is not None and leaves_more_squares(errors, MUCH_WORSE):
            e = errors[worst := max(errors, key=lambda n: errors[n].after / errors[n].noise)]
            return (
                "The twin does not fit this record, and nothing is told of why: the best effect that was tried leaves "
                f"{worst} off by {e.after:.2g} K on the held-out segment, re-tuning alone by {e.before:.2g} "
                f"K, at a noise of {e.noise:.2g} K, so the weights by which it was found let slow error pass for noise."
            )
        if not effects:
            return "The twin does not fit this record and no single place explains it." + fit_text
        u = next((e for e in effects if e.kind == "unknown"), effects[0])
        beside = "".join(f"{e.says}. " for e in effects if e is not u and e.says)
        if u.shape == "transient":
            return f"{beside}{u.says}.{spoken(description)} No known effect explains it, so nothing is adopted."
        since = u.onset_s if description.get("onset_s") else None
        entered = disturbance_statement(u.where, u.value, u.unit, u.interval90, since, average=True)
        course = _UNKNOWN.get(u.driver, "following " + u.driver.replace("_", " "))
        return (
            f"{beside}Something that no effect of the catalogue explains: {entered}, {course}.{spoken(description)} "
            "Nothing is adopted."
        )
    said = ". ".join(e.says for e in effects)
    named = {(e.kind, e.where) for e in effects}
    places = dict.fromkeys((a.kind, a.where) for a in others if (a.kind, a.where) not in named)
    names = ", ".join(f"{kind.replace('_', ' ')} at {where}" for kind, where in places)
    if verdict == "ambiguous" and names:
        return f"{said}; but on this record that is indistinguishable from {names}." + fit_text
    followed = {e.driver for e in effects}
    drivers = [a.driver for a in others if (a.kind, a.where) in named and a.confidence > OPEN]
    drivers = [_DRIVEN.get(d, d.replace("_", " ")) for d in dict.fromkeys(drivers) if d not in followed]
    if drivers:
        rival = " or ".join(drivers)
        return f"{said}; it may follow {rival} instead, which is not identifiable from this record." + fit_text
    return said + "." + fit_text
