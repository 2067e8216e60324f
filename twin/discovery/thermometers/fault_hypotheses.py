"""Classification of one deviating thermometer among several: sensor fault, or heat gain or loss at its place.

A sensor fault begins at once, while a place with a thermal mass reaches its new temperature within a minute. A bias is
constant, and a gain error follows the temperature; a place that loses heat, or whose contact is poor, deviates in
proportion to its excess over the room. A loop does not show the power of so little heat, so the effect of a place is
given in kelvins of its thermometer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.discovery.effects.shapes import EARLY_S
from twin.discovery.thermometers.deviations import CORRELATED, Deviation
from twin.discovery.thermometers.members import Members
from twin.network import Array

SLOW_S = (20.0, 40.0, 80.0, 160.0, 320.0)
"""Time constants, s, of a place that reaches its new temperature."""
AROUND_S, SOONER_S, EVERY_S = 2700.0, 1500.0, 5.0
"""Segment of a record around an onset, s, the range of the onset in it, and the step of that range."""
RARER = 2.0 * np.log(10.0)
"""Prior cost, in weighted squares, of a rarer fault. Places with an effect that no loop shows are rarer than sensor
faults, gain errors rarer than biases, and heat sinks other than losses rarer than sources."""
LEFT = 0.1
"""Share of a deviation's squares that a sensor fault may leave unexplained."""


@dataclass(frozen=True)
class FaultHypothesis:
    """Fault hypothesis: `kind` at the thermometer or, if `local`, at its place, with `driver`; `share` is its
    probability.
    """

    kind: str
    driver: str
    local: bool
    share: float


def fault_hypotheses(found: Members, deviation: Deviation) -> tuple[FaultHypothesis, ...]:
    """Return the fault hypotheses of a deviating member, the likeliest first; none if nothing explains it."""
    good, i = found.good, found.columns.index(deviation.column)
    y = found.by_itself(i, found.residual[good])
    course = deviation.shape.block_means(found.edges_s)[good]
    grows = deviation.shape.name != "step"
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
    sudden = _sudden(found, i, deviation) if not grows and deviation.shape.onset_s > EARLY_S else 0.0
    source = RARER if deviation.final > 0.0 else 2.0 * RARER
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


def has_thermal_onset(found: Members, deviation: Deviation) -> bool:
    """Return True if a member's deviation began with the lag of a thermal mass, and not at once."""
    return deviation.shape.name == "step" and _sudden(found, found.columns.index(deviation.column), deviation) < -RARER


def _left(y: Array, columns: Array) -> float:
    """Return the squares of y (b,) after a fit of columns (b, e)."""
    size, *_ = np.linalg.lstsq(columns, y, rcond=None)
    return float(((y - columns @ size) ** 2).sum())


def _sudden(found: Members, i: int, deviation: Deviation) -> float:
    """Return the excess of weighted squares of an onset with thermal lag over one at once; negative if lag fits
    better.
    """
    time_s = (np.arange(len(found.fine)) + 0.5) * found.step_s
    near = np.abs(time_s - deviation.shape.onset_s) < AROUND_S
    y = found.by_itself(i, found.fine[near])
    seen = np.isfinite(y)
    y, t = y[seen], time_s[near][seen]
    if len(y) < 2.0 * AROUND_S / found.step_s / 3.0:
        return 0.0
    noise = float(np.var(np.diff(y))) / 2.0
    onsets = deviation.shape.onset_s + np.arange(-SOONER_S, SOONER_S, EVERY_S)
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
