"""Variations of simulated records for the training: other sizes of their effects, and effects put into healthy windows.

The energy balance is linear in small effects. So an effect of another size is the healthy power and a multiple of the
change, and a hypothesis at work is its direction times a course in time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin.calibrators.hiera_unet.effects.balance import WINDOW_S, Figures, Hypothesis
from twin.calibrators.hiera_unet.effects.labels import Effect, own_scores
from twin.calibrators.hiera_unet.effects.memory import Memory
from twin.network import Array

FACTORS = (0.4, 2.5)
"""Range of the multiple of an effect's size, drawn by its logarithm."""
SCORES = (2.0, 200.0)
"""Range of the score of an effect that is put in, over its first hour."""
OFTEN = {"heat_source": 5.0, "sensor": 5.0, "heat_loss": 2.0, "flow": 4.0, "heat_rejection": 4.0, "room": 4.0}
"""Weight of a kind in the draw, shared by its hypotheses; 1 for others."""
STEP_S = 10.0


def resized(figures: Figures, calm: Figures, effect: Effect, rng: np.random.Generator) -> tuple[Figures, Effect]:
    """Return a record whose effect has another size."""
    factor = float(np.exp(rng.uniform(*np.log(FACTORS))))

    def between(name: str) -> Array:
        one, other = getattr(figures, name), getattr(calm, name)
        found: Array = other + factor * (one - other)
        return found

    changed = replace(figures, **{name: between(name) for name in ("power", "direction", "levels", "rates")})
    return changed, replace(effect, size=factor * effect.size)


def put_in(
    calm: Figures, memory: Memory, hypotheses: Sequence[Hypothesis], rng: np.random.Generator
) -> tuple[Figures, Effect]:
    """Return a healthy record with a drawn hypothesis at work from a drawn onset on, and the truth about it."""
    kinds = [h.kind for h in hypotheses]
    weight = np.array([OFTEN.get(kind, 1.0) / kinds.count(kind) for kind in kinds])
    alive = np.abs(calm.direction).sum(axis=(0, 2)) > 0.0
    weight *= alive
    h = int(rng.choice(len(hypotheses), p=weight / weight.sum()))
    named = hypotheses[h]
    last = float(calm.end_s[-1])
    begin = float(calm.end_s[0]) - WINDOW_S
    acts = begin if rng.random() < 0.15 else float(rng.uniform(begin + 0.1 * (last - begin), last - 3600.0))
    t = np.arange(begin, last, STEP_S)
    course = _course(t, acts, calm, rng)
    mean, rate = _windowed(t, course, calm.end_s)
    added = mean[:, None] * calm.direction[:, h] + rate[:, None] * calm.kick[h]
    trial = replace(calm, power=calm.power + added)
    first = int(np.searchsorted(calm.end_s, acts, side="right"))
    reached = own_scores(trial, calm, memory)[min(first + 11, len(calm.end_s) - 1)]
    size = float(np.exp(rng.uniform(*np.log(SCORES)))) / max(float(reached), 1e-9)
    size *= 1.0 if rng.random() < 0.5 else -1.0
    if named.kind in ("flow", "bypass", "heat_rejection", "coupling", "actuator"):
        size = float(np.clip(size, -0.9, 0.9))
    places: tuple[str, ...] = (named.where,)
    if named.kind == "actuator":
        node = int(np.abs(calm.direction[:, h]).sum(axis=0).argmax())
        places += tuple(one.where for k, one in enumerate(hypotheses) if one.kind == "heat_source" and k == node)
    sized = named.kind if named.kind in ("heat_source", "sensor") else ""
    truth = Effect(places, ((named.named, named.where),), acts, size * mean if sized else np.nan * mean, sized)
    return replace(calm, power=calm.power + size * added), truth


def _course(t: Array, acts: float, calm: Figures, rng: np.random.Generator) -> Array:
    """Return a course in time that is 0 before the onset."""
    since = t - acts
    form = rng.choice(["step", "step", "ramp", "pulses", "input", "input", "wander"])
    if form == "ramp":
        found = np.clip(since / rng.uniform(600.0, 14_400.0), 0.0, 1.0)
    elif form == "pulses":
        period = rng.uniform(1500.0, 9000.0)
        found = (since % period < rng.uniform(0.2, 0.6) * period).astype(np.float64)
    elif form == "input":
        level = calm.levels[:, int(rng.integers(calm.levels.shape[1]))]
        level = level / max(float(np.abs(level).max()), 1e-9)
        found = np.interp(t, calm.end_s - 0.5 * WINDOW_S, level) ** int(rng.integers(1, 3))
    elif form == "wander":
        keep = np.exp(-STEP_S / 5400.0)
        shocks = rng.normal(size=len(t)) * np.sqrt(1.0 - keep**2)
        found = np.empty(len(t))
        value = float(rng.normal())
        for k, shock in enumerate(shocks):
            value = keep * value + shock
            found[k] = value
    else:
        found = np.ones(len(t))
    return np.asarray(np.where(since >= 0.0, found, 0.0), dtype=np.float64)


def _windowed(t: Array, course: Array, end_s: Array) -> tuple[Array, Array]:
    """Return mean (K,) and rate (K,), 1/s, of a course in each window, by the weight of the energy balance."""
    count = round(WINDOW_S / STEP_S)
    angle = np.pi * (np.arange(count) + 0.5) / count
    weight, slope = np.sin(angle) ** 2, np.pi / WINDOW_S * np.sin(2.0 * angle)
    padded = np.concatenate([course, np.full(count, course[-1])])
    first = np.round((end_s - WINDOW_S - t[0]) / STEP_S).astype(np.intp)
    each = padded[first[:, None] + np.arange(count)]
    return each @ weight / weight.sum(), -(each @ slope) / weight.sum()
