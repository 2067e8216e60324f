"""Simulated rigs of the zoo with many records each: windows of the energy balance, and the truth about each effect.

Each record comes twice, with an effect and without one, of the same noise. Their difference is what the effect does to
each window, and the second is a healthy record. Sealed families and reserved effects are not drawn.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hil.bench.zoo.case import ALL_ALONG, MOST_ROWS, SCORES, draw_schedules, inject, noisy
from hil.bench.zoo.effects import EFFECTS, Injection, NoSuchPlaceError, Scene
from hil.bench.zoo.plants import (
    ALWAYS,
    DEVELOPMENT,
    FAMILIES,
    HEAT,
    HOUR_S,
    KINDS,
    Array,
    Schedule,
    ZooPlant,
    draw_drive,
    draw_plant,
)
from hil.bench.zoo.twins import sheet_twin
from hil.bench.zoo.visibility import Yardstick, yardstick
from hil.record import Record
from twin import CommissionOptions, CommissionResult, Network, commission
from twin.calibrators.hiera_unet.effects.balance import Balance, Figures

UNSEEN = ("exchanger", "parallel")
"""Development families that no training draws."""
SEEN = tuple(family for family in DEVELOPMENT if family not in UNSEEN)
FIRST_SEED = 500_000_000
"""First seed of these plants; no trial of the zoo has them."""
RECORD_H = (6.0, 14.0)
"""Length of a record, h: shorter than in the zoo, since the first hours after an onset count."""
RULER_STEP_S = 10.0
"""Step of the runs that measure a true score, s."""
EARLY_S = (1200.0, 3600.0)
"""Times after the onset for which a true score of the record up to then is kept, s: two windows, and an hour."""
EARLY_SCORES = (2.0, 300.0)
"""Range from which the wanted true score of the first two windows is drawn, by its logarithm; the whole record's score
is at most that of the zoo.
"""
LEAST_SHARE = 1e-3
"""Share of the largest change of a reading or an input, over noise, from which an effect acts."""
CLOSE = 0.25
TRIES = 4


@dataclass(frozen=True)
class Rig:
    """Simulated rig with its commissioned twin, its healthy record and the windows of that."""

    family: str
    seed: int
    plant: ZooPlant
    usual: Schedule
    fit: CommissionResult
    healthy: Record
    balance: Balance
    usually: Figures

    @property
    def network(self) -> Network:
        """Return the commissioned twin."""
        return self.fit.network


@dataclass(frozen=True)
class Watched:
    """Record of a rig with an effect and the same record without it.

    Attributes
    ----------
    figures, calm
        Windows with the effect and without it.
    truth
        Effect, accepted answers, places, size, onset, true scores; plain data.
    size
        True size in each window (K,), in the unit of `unit` in the truth; NaN where none is defined.
    """

    figures: Figures
    calm: Figures
    truth: dict[str, Any]
    size: Array


def make_rig(family: str, seed: int) -> Rig:
    """Draw a plant, make its healthy record, commission its twin."""
    if family not in DEVELOPMENT:
        raise ValueError(f"family {family!r} is none for development; choose from {', '.join(DEVELOPMENT)}")
    plant = draw_plant(family, seed)
    rng = np.random.default_rng([seed, sorted(FAMILIES).index(family), 1])
    usual, _ = draw_schedules(rng)
    drive = draw_drive(usual, plant.full_w, len(plant.pumps), rng)
    shown = plant.readings(plant.run(drive, usual.period_s), usual.period_s)
    healthy = noisy(plant, usual.times, shown, plant.columns(drive), rng)
    network = sheet_twin(plant.sheet, fan_varies=usual.fan_varies, pump_varies=usual.pump_varies)
    fit = commission(network, healthy.time_s, *network.select(healthy.columns), CommissionOptions(starts=1))
    balance = Balance(fit.network)
    figures = balance.figures(healthy.time_s, *fit.network.select(healthy.columns))
    return Rig(family, seed, plant, usual, fit, healthy, balance, figures)


def make_records(
    rig: Rig, count: int, effects: tuple[str, ...] = (), *, kept: list[Record] | None = None
) -> list[Watched]:
    """Return records of a rig, each with an effect of its own.

    Parameters
    ----------
    rig
        The rig.
    count
        Number of records.
    effects
        Names of effects, drawn otherwise; one without a place in the plant gives way to a drawn one.
    kept
        List that the records with effects are appended to.
    """
    found = []
    for k in range(count):
        rng = np.random.default_rng([rig.seed, sorted(FAMILIES).index(rig.family), 2, k])
        found.append(_record(rig, rng, effects[k % len(effects)] if effects else "", kept))
    return found


def _record(rig: Rig, rng: np.random.Generator, wanted: str, kept: list[Record] | None) -> Watched:
    plant, network = rig.plant, rig.network
    hours = min(float(rng.uniform(*RECORD_H)), rig.usual.period_s * MOST_ROWS / HOUR_S)
    schedule = Schedule(str(rng.choice(KINDS)), rig.usual.pump_varies, rig.usual.fan_varies, hours, rig.usual.period_s)
    drive = draw_drive(schedule, plant.full_w, len(plant.pumps), rng)
    onset = 0.0 if rng.random() < ALL_ALONG else float(rng.uniform(0.15, 0.6)) * schedule.hours * HOUR_S
    t = schedule.times
    calm = plant.run(drive, schedule.period_s)
    calm_shown, calm_inputs = plant.readings(calm, schedule.period_s), plant.columns(drive)
    kind, injection = _chosen(Scene(plant, drive, schedule, t, onset, rng, calm), wanted)
    thin = max(int(RULER_STEP_S / schedule.period_s), 1)
    ruler, still = _ruler(rig, t[::thin], {c: v[::thin] for c, v in {**calm_inputs, **calm_shown}.items()})
    score = float(np.exp(rng.uniform(*np.log(EARLY_SCORES))))
    amount = injection.first
    for attempt in range(TRIES):
        shown, inputs = inject(plant, drive, schedule, injection, amount, calm, calm_shown)
        changed = _selected(network, {c: v[::thin] for c, v in {**inputs, **shown}.items()})
        acts = _acts_s(t, (shown, inputs), (calm_shown, calm_inputs))
        reached, _ = ruler.scores(*changed, *still)
        early = [_up_to(ruler, t[::thin], acts + reach, changed, still) for reach in EARLY_S]
        factor = min(score / max(early[0], 1e-9), SCORES[1] / max(reached, 1e-9))
        enough = abs(factor - 1.0) < CLOSE or (factor > 1.0 and amount >= injection.most)
        if enough or attempt == TRIES - 1:
            break
        amount = float(min(amount * np.clip(factor, 1e-3, 30.0), injection.most))
    seeds = int(rng.integers(2**31))
    noise = [np.random.default_rng(seeds) for _ in range(2)]
    record = noisy(plant, t, shown, inputs, noise[0])
    without = noisy(plant, t, calm_shown, calm_inputs, noise[1])
    if kept is not None:
        kept.append(record)
    figures = rig.balance.figures(t, *network.select(record.columns))
    truth = {
        "family": rig.family,
        "seed": rig.seed,
        "effect": kind,
        "group": next(e.group for e in EFFECTS if e.name == kind),
        "places": sorted({injection.place, *(a.where for a in injection.answers)}),
        "answers": sorted({(a.kind, a.where) for a in injection.answers}),
        "amount": amount,
        "acts_s": acts,
        "score": reached,
        "early": early,
        "hours": schedule.hours,
        "load": schedule.kind,
    }
    size, unit = _true_size(injection, amount, (shown, calm_shown), t, figures.end_s)
    return Watched(figures, rig.balance.figures(t, *network.select(without.columns)), {**truth, "unit": unit}, size)


def _chosen(scene: Scene, wanted: str) -> tuple[str, Injection]:
    """Return name and injection of the wanted effect, or of the first drawn one that has a place."""
    usual = [e for e in EFFECTS if not e.reserved]
    order = [e for e in usual if e.name == wanted] + [usual[k] for k in scene.rng.permutation(len(usual))]
    for effect in order:
        try:
            return effect.name, effect.build(scene)
        except NoSuchPlaceError:
            continue
    raise NoSuchPlaceError(f"no effect fits {scene.plant.family}")


def _selected(network: Network, columns: dict[str, Array]) -> tuple[Array, Array]:
    """Return readings and inputs, in the order of a yardstick."""
    inputs, measured = network.select(columns)
    return measured, inputs


def _ruler(rig: Rig, t: Array, columns: dict[str, Array]) -> tuple[Yardstick, tuple[Array, Array]]:
    healthy = rig.healthy
    step = max(int(RULER_STEP_S / rig.usual.period_s), 1)
    usual = (healthy.time_s[::step], *rig.network.select({c: v[::step] for c, v in healthy.columns.items()}))
    still = _selected(rig.network, columns)
    found = yardstick(rig.fit, usual, t, still[1], still[0][0])
    # A mean over a block holds all samples, of which every `step`-th was run.
    return replace(found, noise=found.noise / step), still


def _up_to(
    ruler: Yardstick, t: Array, until_s: float, changed: tuple[Array, Array], still: tuple[Array, Array]
) -> float:
    """Return the true score of the change up to a time: later samples as without the effect."""
    late = t > until_s
    readings, inputs = (np.where(late[:, None], b, a) for a, b in zip(changed, still, strict=True))
    return ruler.scores(readings, inputs, *still)[0]


def _acts_s(t: Array, changed: tuple[dict[str, Array], ...], still: tuple[dict[str, Array], ...]) -> float:
    """Return the time from which any reading or recorded input differs."""
    first = len(t) - 1
    for one, other in zip(changed, still, strict=True):
        for column, values in one.items():
            gap = np.abs(values - other[column])
            acting = np.flatnonzero(gap > max(LEAST_SHARE * float(gap.max()), 1e-9))
            if acting.size:
                first = min(first, int(acting[0]))
    return float(t[first])


def _true_size(
    injection: Injection, amount: float, shown: tuple[dict[str, Array], dict[str, Array]], t: Array, end_s: Array
) -> tuple[Array, str]:
    """Return the true power (W) or reading error (K) averaged over each window, and its unit; NaN for other effects."""
    from twin.calibrators.hiera_unet.effects.balance import WINDOW_S

    course: Array | None = None
    unit = ""
    if injection.readings:
        (column,) = injection.readings
        course, unit = shown[0][column] - shown[1][column], "K"
    elif injection.modifiers and all(m.target == HEAT and m.law == ALWAYS for m in injection.modifiers):
        course, unit = amount * np.sum([m.amplitude for m in injection.modifiers], axis=0), "W"
    if course is None:
        return np.full(len(end_s), np.nan), ""
    total = np.concatenate([[0.0], np.cumsum(np.broadcast_to(course, len(t)))])
    a, b = np.searchsorted(t, end_s - WINDOW_S), np.searchsorted(t, end_s)
    return (total[b] - total[a]) / np.maximum(b - a, 1), unit
