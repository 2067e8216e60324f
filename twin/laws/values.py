"""Laws on arrays: the vocabulary of `twin.elements.law_forms`, evaluated on recorded or simulated drivers.

A diagnosis uses it to fit laws to a driver; a test holds it equal to the formulas of the kernels. Values belong to the
interval that begins at each sample, in which a driver is held. A kernel integrates a memory of a temperature
continuously; here the temperature is held over each interval like any driver.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.elements.law_forms import COURSES, FORMS, LEAST_RATIO, MOST_RATIO

Array = NDArray[np.float64]


def law_values(
    form: str, course: str, parameters: Mapping[str, float], driver: ArrayLike | None, time_s: ArrayLike
) -> Array:
    """Return the values (n,) of a law, in the unit of its strength.

    Parameters
    ----------
    form, course
        One of `FORMS` and one of `COURSES`.
    parameters
        Name -> value, as in a twin file.
    driver
        (n,) values of the driver; None for the form `constant`.
    time_s
        (n,) stamps, s, rising.

    Raises
    ------
    ValueError
        There is no such form or course, a parameter is missing, or the form needs a driver.
    """
    if form not in FORMS or course not in COURSES:
        raise ValueError(
            f"no law {form!r} with course {course!r}; forms: {', '.join(FORMS)}; courses: {', '.join(COURSES)}"
        )
    parameters = dict(parameters)
    if "amount" in parameters and course == "pulse":
        parameters.setdefault("size", parameters["amount"] / parameters["decay_s"])
    missing = [name for name in (*FORMS[form], *COURSES[course]) if name not in parameters]
    if missing:
        raise ValueError(f"the law {form} ({course}) lacks {', '.join(missing)}")
    t = np.asarray(time_s, dtype=np.float64)
    if driver is None and form != "constant":
        raise ValueError(f"the law {form} needs a driver")
    x = np.zeros(t.size) if driver is None else np.broadcast_to(np.asarray(driver, dtype=np.float64), t.shape)
    return form_values(form, parameters, x, t) * course_values(course, parameters, t)


def form_values(form: str, p: Mapping[str, float], x: Array, time_s: Array) -> Array:
    """Return the values (n,) of a form for a driver (n,) at stamps (n,)."""
    y = x - p.get("reference", 0.0)
    if form == "constant":
        return np.full(x.shape, p["size"])
    if form == "linear":
        return np.asarray(p["gain"] * y)
    if form == "power":
        r = np.clip(y / p["scale"], -MOST_RATIO, MOST_RATIO)
        return np.asarray(p["size"] * r * np.maximum(np.abs(r), LEAST_RATIO) ** (p["exponent"] - 1.0))
    if form == "saturating":
        return np.asarray(p["size"] * np.sign(y) * -np.expm1(-np.abs(y) / p["scale"]))
    if form == "dead_band":
        return np.asarray(p["gain"] * (y - np.clip(y, -p["width"], p["width"])))
    if form == "threshold":
        return p["size"] * switched(x, p["on"], p["off"])
    z = followed(x, time_s, p["lag_s"])
    return np.asarray(p["gain"] * (z - p["reference"]) if form == "memory" else p["gain"] * (x - z) / p["lag_s"])


def switched(x: Array, on: float, off: float) -> Array:
    """Return the state (n,), 0 or 1, of a switch with hysteresis; at rest it is on only beyond `on`."""
    sense = -1.0 if on < off else 1.0
    event = np.where(sense * (x - on) >= 0.0, 1.0, np.where(sense * (x - off) <= 0.0, 0.0, np.nan))
    known = np.isfinite(event)
    last = np.maximum.accumulate(np.where(known, np.arange(x.size), -1))
    return np.where(last >= 0, event[np.maximum(last, 0)], 0.0)


def followed(x: Array, time_s: Array, lag_s: float) -> Array:
    """Return the mean (n,) over each interval of a first-order lag that begins at rest; x is held."""
    span = np.diff(time_s)
    span = np.append(span, span[-1] if span.size else 1.0)
    share = lag_s / np.maximum(span, 1e-9)
    fade = np.exp(-1.0 / share)
    begin, z = np.empty(x.size), float(x[0]) if x.size else 0.0
    for i, (value, stay) in enumerate(zip(x.tolist(), fade.tolist(), strict=True)):
        begin[i] = z
        z = value + (z - value) * stay
    return np.asarray(x + (begin - x) * share * (1.0 - fade))


def course_values(course: str, p: Mapping[str, float], time_s: Array) -> Array:
    """Return the values (n,), 0 to 1, of a time course: its mean over `edge_s` from each stamp on."""
    if course == "always":
        return np.ones(time_s.shape)
    s, edge = time_s - p["start_s"], p["edge_s"]
    if course == "ramp":
        length = max(p["end_s"] - p["start_s"], edge)
        return np.clip((s + 0.5 * edge) / length, 0.0, 1.0)
    return np.asarray((_integral(course, p, s + edge) - _integral(course, p, s)) / edge)


def _integral(course: str, p: Mapping[str, float], s: Array) -> Array:
    """Return the integral of a course up to `s` after its start, s."""
    late = np.maximum(s, 0.0)
    if course == "step":
        return late
    if course == "interval":
        return np.minimum(late, max(p["end_s"] - p["start_s"], 0.0))
    if course == "periodic":
        phase = late % p["period_s"]
        return np.asarray(p["duty"] * (late - phase) + np.minimum(phase, p["duty"] * p["period_s"]))
    if course == "pulse":
        return np.asarray(-p["decay_s"] * np.expm1(-late / p["decay_s"]))
    return np.asarray(late + p["settle_s"] * np.expm1(-late / p["settle_s"]))
