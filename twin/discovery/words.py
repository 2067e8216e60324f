"""A diagnosis in plain words."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from twin.discovery.diagnosis import Alternative, Effect, SensorError, Verdict
from twin.discovery.equivalence import OPEN
from twin.discovery.search import Entry
from twin.discovery.shapes import Shape
from twin.discovery.sites import spoken
from twin.elements.base import Candidate

if TYPE_CHECKING:
    from twin.discovery.ranking import Finding

_OPPOSITES = (("} more", "} less"), ("} too high", "} too low"))
_DRIVEN = {"threshold": "a temperature that switches it"}


def sentence(entry: Entry, start: float = 0.0, grown: float = 1.0, spread: float = 0.0) -> str:
    """The effect in plain words; `grown` is the share of its size that it has reached, `spread` half its interval."""
    text = said(entry.candidate, entry.size * grown, spread)
    since = when(entry.shape, start)
    if entry.shape.name == "ramp":
        until = f" for {clock(entry.shape.growth_s)}" if grown >= 1.0 else ""
        return f"{text} by the end, having grown steadily {since}{until}"
    if entry.shape.name == "saturating":
        return f"{text} by the end, growing {since} with a time constant of {clock(entry.shape.growth_s)}"
    return f"{text}, {since}"


def said(candidate: Candidate, size: float, spread: float = 0.0) -> str:
    """What a candidate of this size, more or less by `spread`, does, in plain words."""
    c = candidate
    named = c.kind == "sensor" and c.where.endswith("_C")
    who = c.where if named else f"The {c.where.replace('_', ' ')}"
    says = _plural(c.says) if not named and c.where.endswith("s") else c.says
    for much, little in _OPPOSITES:
        if size < 0.0 and much in says:
            says, size = says.replace(much, little), -size
    return f"{who} {says.format(value=amount(size, c.unit, spread), share=amount(size, 'W/W', spread))}"


def when(shape: Shape, start: float) -> str:
    return f"since {clock(start + shape.onset_s)}" if shape.onset_s > 0.0 else "from the beginning of the record"


def _plural(says: str) -> str:
    first, _, rest = says.partition(" ")
    verb = {"has": "have", "is": "are", "exchanges": "exchange", "loses": "lose", "takes": "take", "gives": "give"}
    return f"{verb.get(first, first.removesuffix('s'))} {rest}"


def amount(value: float, unit: str, spread: float = 0.0) -> str:
    """A size as an operator reads it, with its interval where it has a `spread`."""
    part = unit == "W/W" or unit.startswith("of the")
    named = {"1": "", "W/W": " %"}.get(unit, f" % {unit}" if part else f" {unit}")
    factor = 100.0 if part else 1.0
    low, high = (f"{factor * (value + side * spread):.3g}" for side in (-1.0, 1.0))
    return f"{factor * value:.3g}{named}" + (f" ({low} to {high})" if low != high else "")


def clock(seconds: float) -> str:
    minutes = round(seconds / 60.0)
    if minutes < 60:
        return f"{minutes} min"
    return f"{minutes // 60} h {minutes % 60:02d} min"


def summarise(
    verdict: Verdict,
    effects: tuple[Effect, ...],
    errors: dict[str, SensorError],
    others: tuple[Alternative, ...],
    description: dict[str, Any],
    finding: Finding,
) -> str:
    """The verdict in plain words."""
    if verdict == "adequate":
        best = finding.ladder[0].best_z
        tried = ", which was not confirmed" if best >= finding.threshold else ""
        return (
            "The twin is adequate: nothing in this record asks for an effect that it lacks "
            f"(best score {best:.1f}{tried}; noise alone reaches {finding.threshold:.1f} in one record of a hundred)."
        )
    worst = max(errors, key=lambda n: errors[n].before / errors[n].noise) if errors else ""
    fit_text = ""
    if worst and finding.fit is not None:
        e = errors[worst]
        fit_text = (
            f" On the part that the fit never saw, {worst} is off by {e.stale:.2g} K, by {e.before:.2g} K when "
            f"re-tuned, by {e.after:.2g} K with the new term, at a noise of {e.noise:.2g} K."
        )
    if verdict == "unexplained":
        if not effects:
            return "The twin does not fit this record and no single place explains it." + fit_text
        u = next((e for e in effects if e.kind == "unknown"), effects[0])
        beside = "".join(f"{e.says}. " for e in effects if e is not u and e.says)
        if u.shape == "spell":
            return f"{beside}{u.says}.{spoken(description)} No effect of the catalogue ends, so nothing is adopted."
        low, high = (amount(x, u.unit) for x in u.interval90)
        return (
            f"{beside}Something at {u.where} is not in the catalogue: {amount(u.value, u.unit)} on average "
            f"({low} to {high}) since {clock(u.onset_s)}, following {u.driver.replace('_', ' ')}.{spoken(description)} "
            "No known effect explains it, so nothing is adopted."
        )
    said = ". ".join(e.says for e in effects)
    named = {(e.kind, e.where) for e in effects}
    places = dict.fromkeys((a.kind, a.where) for a in others if (a.kind, a.where) not in named)
    names = ", ".join(f"{kind.replace('_', ' ')} at {where}" for kind, where in places)
    if verdict == "ambiguous" and names:
        return f"{said}; but this record cannot tell that from {names}." + fit_text
    followed = {e.driver for e in effects}
    drivers = [a.driver for a in others if (a.kind, a.where) in named and a.confidence > OPEN]
    drivers = [_DRIVEN.get(d, d.replace("_", " ")) for d in dict.fromkeys(drivers) if d not in followed]
    if drivers:
        return f"{said}; whether it follows {' or '.join(drivers)} instead this record cannot tell." + fit_text
    return said + "." + fit_text
