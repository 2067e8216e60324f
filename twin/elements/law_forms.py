"""Vocabulary of laws: forms that follow a driver x, and time courses; their parameters and their formulas as text.

    constant     size
    linear       gain (x - reference)
    power        size sign(r) |r|^exponent,  r = (x - reference) / scale, between -1000 and 1000
    saturating   size sign(r) (1 - exp(-|r|))
    dead_band    gain (y - clip(y, -width, width)),  y = x - reference
    threshold    size from x = on until x = off; with on below off it acts on the low side
    memory       gain (z - reference),  lag_s dz/dt = x - z
    rate         gain (x - z) / lag_s: the rate of change, without what is faster than lag_s

The value of a form is multiplied by that of a time course, from 0 to 1, with s = t - start_s:

    always       1
    step         0, from start_s on 1
    interval        1 from start_s to end_s, else 0
    ramp         from 0 at start_s in a straight line to 1 at end_s
    settling     1 - exp(-s / settle_s)
    periodic     1 in the first `duty` of each period_s from start_s on, else 0
    pulse        exp(-s / decay_s), 0 before start_s

A constant heat or fluid in a pulse is given by its `amount` (J, kg) instead of its size, amount / decay_s.

t is the stamp of the sample. A course is averaged over edge_s from each sample on. With edge_s equal to the sample
interval no energy is lost between the samples, and the value is continuous in all times.

`twin.laws.values` evaluates the same vocabulary on arrays. Sources: dead band, relay with hysteresis, first-order lag
and filtered derivative as in Astrom & Hagglund, Advanced PID Control, 2006, secs. 2.5, 3.3 and 8.4.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from twin.elements.base import ParameterSpec

FORMS: dict[str, tuple[str, ...]] = {
    "constant": ("size",),
    "linear": ("gain", "reference"),
    "power": ("size", "reference", "scale", "exponent"),
    "saturating": ("size", "reference", "scale"),
    "dead_band": ("gain", "reference", "width"),
    "threshold": ("size", "on", "off"),
    "memory": ("gain", "reference", "lag_s"),
    "rate": ("gain", "lag_s"),
}
"""Form -> its parameters, the strength first: at 0 the law has no effect."""
COURSES: dict[str, tuple[str, ...]] = {
    "always": (),
    "step": ("start_s", "edge_s"),
    "interval": ("start_s", "end_s", "edge_s"),
    "ramp": ("start_s", "end_s", "edge_s"),
    "settling": ("start_s", "settle_s", "edge_s"),
    "periodic": ("start_s", "period_s", "duty", "edge_s"),
    "pulse": ("start_s", "decay_s", "edge_s"),
}
"""Time course -> its parameters."""
LEAST_RATIO, MOST_RATIO = 1.0e-3, 1.0e3
"""Smallest |r| of a power law, below which it is a straight line (an exponent below 1 has no slope at 0), and the
largest.
"""
STEEP = 1.0e9
"""Slope with which a switch turns: as sharp as arithmetic allows, and the same on arrays as in a kernel."""
REACH_K = 100.0
"""Difference of temperatures for which the slope of a power law is bounded, K; beyond it the value is limited."""
MOST_S = 1.0e10
"""Largest stamp, s: seconds since 1970 fit."""

Par = Callable[[str], str]
_TIMES = {
    "start_s": ("s", None, -MOST_S, MOST_S, "begins at this stamp"),
    "end_s": ("s", None, -MOST_S, MOST_S, "ends at this stamp"),
    "settle_s": ("s", None, 1.0, 1.0e7, "time constant of the growth"),
    "period_s": ("s", None, 1.0, 1.0e8, "from one switching on to the next"),
    "duty": ("1", 0.5, 0.0, 1.0, "share of the period in which it is on"),
    "decay_s": ("s", None, 1.0e-3, 1.0e7, "time constant of the decay"),
    "edge_s": ("s", 1.0, 1.0e-2, 1.0e6, "interval of the samples, over which the course is averaged"),
}


def form_specs(form: str, value: tuple[str, float], driver: tuple[str, str]) -> tuple[ParameterSpec, ...]:
    """Return the parameters of a form.

    Parameters
    ----------
    form
        One of `FORMS`.
    value
        Unit of the law's value, and the largest strength in it.
    driver
        Unit of the driver, and that of its differences (degC, K).
    """
    (unit, most), (level, step) = value, driver
    per = f"{unit}/({step.strip('()')}/s)" if form == "rate" else f"{unit}/{step}"
    size = "value at saturation" if form == "saturating" else "value at one scale" if form == "power" else "value"
    known = {
        "size": ParameterSpec("size", unit, 0.0, -most, most, "tunable", f"{size}; 0 without an effect"),
        "gain": ParameterSpec("gain", per, 0.0, -most, most, "tunable", "value for one unit of the driver"),
        "reference": ParameterSpec("reference", level, 0.0, -1.0e6, 1.0e6, "fixed", "driver at which it is zero"),
        "scale": ParameterSpec("scale", step, 1.0, 1.0e-3, 1.0e6, "fixed", "unit of the driver's distance"),
        "exponent": ParameterSpec("exponent", "1", 1.0, 0.25, 4.0, "fixed", "of the driver's distance"),
        "width": ParameterSpec("width", step, 0.0, 0.0, 1.0e6, "fixed", "distance without an effect, to each side"),
        "on": ParameterSpec("on", level, None, -1.0e6, 1.0e6, "fixed", "driver at which it switches on"),
        "off": ParameterSpec("off", level, None, -1.0e6, 1.0e6, "fixed", "driver at which it switches off"),
        "lag_s": ParameterSpec("lag_s", "s", 60.0, 1.0, 1.0e7, "fixed", "time constant with which z follows x"),
    }
    return tuple(known[name] for name in FORMS[form])


def course_specs(course: str) -> tuple[ParameterSpec, ...]:
    """Return the parameters of a time course."""
    found = []
    for name in COURSES[course]:
        unit, default, lower, upper, source = _TIMES[name]
        found.append(ParameterSpec(name, unit, default, lower, upper, "fixed", source))
    return tuple(found)


def form_text(form: str, x: str, par: Par, memory: str = "") -> str:
    """Return the value of a form.

    Parameters
    ----------
    form
        One of `FORMS`.
    x
        Expression of the driver.
    par
        Function from a parameter's name to its identifier.
    memory
        Identifier of the switch (0 or 1) of a threshold, or of z.
    """
    y = f"({x} - {par('reference')})" if "reference" in FORMS[form] else ""
    if form == "constant":
        return par("size")
    if form == "linear":
        return f"{par('gain')} * {y}"
    if form == "power":
        r = f"min(max({y} / {par('scale')}, -{MOST_RATIO!r}), {MOST_RATIO!r})"
        distance = f"max(max({r}, -{r}), {LEAST_RATIO!r})"
        return f"{par('size')} * {r} * exp(({par('exponent')} - 1.0) * log({distance}))"
    if form == "saturating":
        r = f"{y} / {par('scale')}"
        return f"{par('size')} * (exp(-max(-{r}, 0.0)) - exp(-max({r}, 0.0)))"
    if form == "dead_band":
        return f"{par('gain')} * ({y} - min(max({y}, -{par('width')}), {par('width')}))"
    if form == "threshold":
        return f"{par('size')} * {memory}"
    if form == "memory":
        return f"{par('gain')} * ({memory} - {par('reference')})"
    return f"{par('gain')} * ({x} - {memory}) / {par('lag_s')}"


def switch_text(x: str, par: Par, before: str) -> tuple[str, str]:
    """Return the switch of a threshold from its state before, and its state at rest: on only beyond `on`."""
    sense = f"(1.0 - 2.0 * min(max(({par('off')} - {par('on')}) * {STEEP!r}, 0.0), 1.0))"
    reached = f"min(max({sense} * ({x} - {par('on')}) * {STEEP!r} + 1.0, 0.0), 1.0)"
    short_of_off = f"min(max({sense} * ({x} - {par('off')}) * {STEEP!r}, 0.0), 1.0)"
    return f"max({reached}, min({before}, {short_of_off}))", reached


def follow_text(x: str, par: Par, before: str, span: str) -> tuple[str, str]:
    """Return the mean of z over an interval in which x is held, and z at its end."""
    share = f"({par('lag_s')} / max({span}, 1e-9))"
    fade = f"exp(-1.0 / {share})"
    return f"{x} + ({before} - {x}) * {share} * (1.0 - {fade})", f"{x} + ({before} - {x}) * {fade}"


def slope_text(form: str, par: Par) -> str:
    """Return a bound on the slope of a form by its driver, free of temperatures."""
    strength = par(FORMS[form][0])
    size = f"max({strength}, -{strength})"
    if form in ("constant", "threshold", "memory"):
        return "0.0"
    if form == "power":
        p, scale = par("exponent"), par("scale")
        far = f"log(min(max({REACH_K!r} / {scale}, 1.0), {MOST_RATIO!r}))"
        near = repr(math.log(LEAST_RATIO))
        return f"{size} / {scale} * max({p}, 1.0) * exp(max(({p} - 1.0) * {far}, ({p} - 1.0) * {near}))"
    if form == "saturating":
        return f"{size} / {par('scale')}"
    return f"{size} / {par('lag_s')}" if form == "rate" else size


def course_text(course: str, t: str, par: Par) -> str:
    """Return the value of a time course at the stamp `t`, "" for one that is always 1."""
    if course == "always":
        return ""
    start, edge = par("start_s"), par("edge_s")
    s, after = f"({t} - {start})", f"({t} + {edge} - {start})"
    if course == "step":
        return f"min(max({after}, 0.0), {edge}) / {edge}"
    if course == "interval":
        length = f"max({par('end_s')} - {start}, 0.0)"
        return f"(min(max({after}, 0.0), {length}) - min(max({s}, 0.0), {length})) / {edge}"
    if course == "ramp":
        length = f"max({par('end_s')} - {start}, {edge})"
        return f"min(max(({s} + 0.5 * {edge}) / {length}, 0.0), 1.0)"
    if course == "periodic":
        return f"({_time_on(after, par)} - {_time_on(s, par)}) / {edge}"
    tau = par("settle_s" if course == "settling" else "decay_s")
    gone, gone_after = (f"{tau} * (1.0 - exp(-max({x}, 0.0) / {tau}))" for x in (s, after))
    if course == "pulse":
        return f"({gone_after} - {gone}) / {edge}"
    return f"(max({after}, 0.0) - {gone_after} - max({s}, 0.0) + {gone}) / {edge}"


def _time_on(s: str, par: Par) -> str:
    """Return the time for which a periodic course has been on since it began, s."""
    late, period = f"max({s}, 0.0)", par("period_s")
    phase = f"({late} % {period})"
    return f"(({late} - {phase}) * {par('duty')} + min({phase}, {par('duty')} * {period}))"
