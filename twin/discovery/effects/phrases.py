"""Phrases for sizes, times and candidates in the reports of a diagnosis."""

from __future__ import annotations

import math
import re

from twin.discovery.effects.shapes import Shape
from twin.elements.candidates import Candidate

SHORT_S = 120.0
"""Time, s, below which seconds are written."""
_OPPOSITES = (("} more", "} less"), ("} too high", "} too low"))
_IRREGULAR = {"has": "have", "is": "are", "was": "were", "does": "do"}
_ENDING = re.compile(r"((?:ss|sh|ch|x|zz))es$|s$")
"""Ending of a verb of the third person: `passes`, `reaches`, `gives`."""
_PRONOUNS = (("its", "their"), ("beside it", "beside them"))
_SINGULAR = ("ss", "us", "is")
"""Endings of single things: mass, apparatus, chassis."""
_ONE_IN_S = ("gas", "lens", "bias", "canvas", "atlas")


def said(candidate: Candidate, size: float, spread: float = 0.0, record_s: float = math.inf) -> str:
    """Return the action of a candidate of this size, plus or minus `spread`, in words.

    A time constant above `record_s`, the record's length, is given as a lower bound: it is not identifiable from the
    record.
    """
    c = candidate
    named = c.kind == "sensor" and c.where.endswith("_C")
    who = c.where if named else f"The {c.where.replace('_', ' ')}"
    says = c.says
    bounds = (c.lower, c.upper)
    for much, little in _OPPOSITES:
        if size < 0.0 and much in says:
            says, size, bounds = says.replace(much, little), -size, (-c.upper, -c.lower)
    if size < 0.0 and c.kind == "heat_transfer" and " from " in says:
        _, _, rest = says.partition(" ")
        says = f"gives {' to '.join(rest.rsplit(' from ', 1))}"
        size, bounds = -size, (-c.upper, -c.lower)
    slow = "longer than the record" if c.slow_s > record_s else f"of {lasting(c.slow_s)}"
    value, share = (amount(size, unit, spread, bounds) for unit in (c.unit, "W/W"))
    says = agreeing(c.where, says)
    return f"{who} {says.format(value=value, share=share, slow=slow)}"


def when(shape: Shape, start: float) -> str:
    return f"since {clock(start + shape.onset_s)}" if shape.onset_s > 0.0 else "from the beginning of the record"


def is_plural(name: str) -> bool:
    """Return True for the name of several things by its last word, as `modules` or `heat_sinks`.

    A name that ends in a number or a unit is that of one thing or reading, and so is an abbreviation (`BMS`).
    """
    last = re.split(r"[\W_]+", name)[-1]
    return last.endswith("s") and len(last) > 2 and not last.endswith(_SINGULAR) and last not in _ONE_IN_S


def agreeing(name: str, says: str) -> str:
    """Return what `name` does, a phrase that begins with a verb of the third person, in the plural if `name` is
    plural.
    """
    if not is_plural(name):
        return says
    verb, gap, rest = says.partition(" ")
    for one, many in _PRONOUNS:
        rest = re.sub(rf"\b{one}\b", many, rest)
    return f"{_IRREGULAR.get(verb) or _ENDING.sub(lambda found: found[1] or '', verb)}{gap}{rest}"


def amount(value: float, unit: str, spread: float = 0.0, bounds: tuple[float, float] = (-math.inf, math.inf)) -> str:
    """Return a size as an operator reads it, with its interval, no wider than `bounds`, where it has a `spread`."""
    part = unit == "W/W" or unit.startswith("of the")
    named = {"1": "", "W/W": " %"}.get(unit, f" % {unit}" if part else f" {unit}")
    factor = 100.0 if part else 1.0
    if unit in ("J/K", "W") and abs(value) >= 10_000.0:
        factor, named = 1e-3, f" k{unit}"
    low, high = (_digits(factor * x) for x in interval(value, spread, bounds))
    return _digits(factor * value) + named + (f" ({low} to {high})" if low != high else "")


def interval(value: float, spread: float, bounds: tuple[float, float]) -> tuple[float, float]:
    """Return `value` minus and plus `spread`, cut where no size is possible; it always holds `value`."""
    return min(max(value - spread, bounds[0]), value), max(min(value + spread, bounds[1]), value)


def _digits(value: float) -> str:
    """Return a number with three significant digits, without an exponent."""
    said = f"{value:.3g}"
    return f"{float(said):,.0f}" if abs(float(said)) >= 1_000.0 else said


def lasting(seconds: float) -> str:
    """Return a time constant in words."""
    return f"{seconds:.0f} s" if seconds < SHORT_S else f"{seconds / 60.0:.0f} min"


def clock(seconds: float) -> str:
    minutes = round(seconds / 60.0)
    if minutes < 60:
        return f"{minutes} min"
    return f"{minutes // 60} h {minutes % 60:02d} min"
