"""Classification of one deviating thermometer among several: it errs, or its place is warmer or colder than others.

A thermometer errs at once; a place has a mass, and comes to its new temperature within a minute. A thermometer errs by
as much whatever the rig does, or more the warmer it is; a place that loses heat, or whose contact is poor, differs by
more the warmer it is beside the room. How many watts that takes no loop shows as long as they are few, so a place is
told in the kelvins that its thermometer shows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.discovery.effects.shapes import EARLY_S
from twin.discovery.thermometers.members import CORRELATED, Members, Odd
from twin.network import Array

SLOW_S = (20.0, 40.0, 80.0, 160.0, 320.0)
"""Time constants of a place that comes to its new temperature."""
AROUND_S, SOONER_S, EVERY_S = 2700.0, 1500.0, 5.0
"""How much of a record around an onset is looked at, how far from it the onset may be, and in what steps."""
RARER = 2.0 * np.log(10.0)
"""Places that differ in a way that no loop shows are rarer than thermometers that err, so are thermometers that err by
a share, and so is what takes heat away, but by being warm, than what gives some; in weighted squares."""
LEFT = 0.1
"""Share of its squares that an error may leave of what one thermometer differs by."""


@dataclass(frozen=True)
class FaultHypothesis:
    """One thing that may be the matter: `kind` at the thermometer or, where `local`, at its place, following `driver`;
    `share` of the weight of all."""

    kind: str
    driver: str
    local: bool
    share: float


def fault_hypotheses(found: Members, odd: Odd) -> tuple[FaultHypothesis, ...]:
    """What may be the matter where one member differs, the likeliest first; none where nothing explains it."""
    good, i = found.good, found.columns.index(odd.column)
    y = found.by_itself(i, found.residual[good])
    course = odd.shape.block_means(found.edges_s)[good]
    grows = odd.shape.name != "step"
    drives = {driver: values[good] for driver, values in found.follows.items()}
    temperature = drives.pop("temperature")
    columns = {"": course[:, None], "temperature": np.column_stack([course, course * temperature])}
    columns |= {driver: (course * values)[:, None] for driver, values in drives.items()}
    left = {driver: _left(y, x) for driver, x in columns.items()}
    least = min(left.values())
    if least > max(LEFT * float(y @ y), len(y) * found.most**2):
        return ()
    # What even the best leaves over what is healthy says how much the others' squares are worth.
    worth = CORRELATED * max(float(found.sd[i]) ** 2, least / len(y))
    sudden = _sudden(found, i, odd) if not grows and odd.shape.onset_s > EARLY_S else 0.0
    source = RARER if odd.final > 0.0 else 2.0 * RARER
    first = "elapsed_time" if grows else "constant"
    costs = {
        ("sensor", first, False): left[""] / worth,
        ("sensor", "temperature", False): left["temperature"] / worth + RARER + np.log(len(y) / CORRELATED),
        ("heat_source", first, True): left[""] / worth + source + sudden,
    }
    if "temperature_difference" in left:
        costs["heat_loss", "elapsed_time" if grows else "temperature_difference", True] = (
            left["temperature_difference"] / worth + RARER + sudden
        )
    if "heater_power" in left:
        costs["heat_source", "heater_power", True] = left["heater_power"] / worth + source + sudden
    most = min(costs.values())
    weights = {key: float(np.exp(-0.5 * (cost - most))) for key, cost in costs.items()}
    total = sum(weights.values())
    return tuple(
        FaultHypothesis(*key, weight / total) for key, weight in sorted(weights.items(), key=lambda item: -item[1])
    )


def has_thermal_onset(found: Members, odd: Odd) -> bool:
    """Whether a member came to differ as a place does that has a mass, and not at once."""
    return odd.shape.name == "step" and _sudden(found, found.columns.index(odd.column), odd) < -RARER


def _left(y: Array, columns: Array) -> float:
    """Squares of y (b,) that are left beside columns (b, e)."""
    size, *_ = np.linalg.lstsq(columns, y, rcond=None)
    return float(((y - columns @ size) ** 2).sum())


def _sudden(found: Members, i: int, odd: Odd) -> float:
    """Weighted squares by which a member came in at once rather than as a place does; negative the other way round."""
    time_s = (np.arange(len(found.fine)) + 0.5) * found.step_s
    near = np.abs(time_s - odd.shape.onset_s) < AROUND_S
    y = found.by_itself(i, found.fine[near])
    seen = np.isfinite(y)
    y, t = y[seen], time_s[near][seen]
    if len(y) < 2.0 * AROUND_S / found.step_s / 3.0:
        return 0.0
    noise = float(np.var(np.diff(y))) / 2.0
    onsets = odd.shape.onset_s + np.arange(-SOONER_S, SOONER_S, EVERY_S)
    y = y - y.mean()

    def left(slow_s: float) -> float:
        since = t[None, :] - onsets[:, None]
        edge = np.clip(since / found.step_s + 0.5, 0.0, 1.0)
        steps = edge if slow_s == 0.0 else np.where(since > 0.0, -np.expm1(-np.maximum(since, 0.0) / slow_s), 0.0)
        steps = steps - steps.mean(axis=1, keepdims=True)
        gained = (steps @ y) ** 2 / np.maximum((steps**2).sum(axis=1), 1e-12)
        return float(y @ y - gained.max())

    at_once, slowly = left(0.0), min(left(slow_s) for slow_s in SLOW_S)
    return (slowly - at_once) / max(noise, min(at_once, slowly) / len(y))
