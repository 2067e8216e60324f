"""Checks of a commissioned twin before it is written: a twin that its record does not support is worse than none."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from twin.commissioning.healthy_fit import CommissionResult

ABSURD_SIGMA = 10.0
"""Standard deviations of a sensor's noise below which an error is never absurd, however little the sensor moves."""
CLOCK_FACTOR = 3.0
"""Common factor of all heat capacities from which the record's clock is questionable: a datasheet is more accurate."""


def refusal_reason(result: CommissionResult, measured: ArrayLike) -> str:
    """Return why the twin must not be used, one sentence, or "" where nothing speaks against it.

    A twin is refused where the record identifies none of its tunables. It is also refused where most sensors are
    predicted no better than by a constant, their mean, on the held-out segment or on the fitted part. A single such
    sensor may be dead or wired to another place.

    Parameters
    ----------
    result
        The commissioned twin.
    measured
        (n, m) degC, the readings of the record, NaN where missing.
    """
    if result.values and len(result.unidentifiable) == len(result.values):
        return (
            f"the record identifies none of the {len(result.values)} tunables: its inputs may never move, its readings "
            "may be of another rig, or its clock may run at another rate; record the rig while its inputs are moved, "
            "or give --time-scale where its clock is not in seconds"
        )
    y = np.asarray(measured, dtype=np.float64)
    absurd, judged = [], 0
    for j, (sensor, error) in enumerate(result.rmse_after.items()):
        read = y[np.isfinite(y[:, j]), j]
        if not len(read) or np.isnan(error):
            continue
        judged += 1
        worst, moved = max(error, result.rmse_fitted[sensor]), float(read.std())
        if not worst < max(moved, ABSURD_SIGMA * float(result.network.sigma[j])):
            absurd.append(f"{sensor} is off by {worst:.3g} K, its mean by {moved:.3g} K")
    if judged and len(absurd) > judged / 2:
        return (
            f"the fitted twin predicts the readings no better than a constant does ({'; '.join(absurd[:3])}"
            f"{'; ...' if len(absurd) > 3 else ''}); check the units of the record's columns, its clock and the twin's "
            "structure"
        )
    return ""


def clock_warning(result: CommissionResult) -> str:
    """Return a sentence where the fitted heat capacities suggest that the record's clock runs at another rate, or "".

    A clock that is N times too slow makes every capacity N times too small and leaves the rest of the fit as good. So
    all identifiable capacities then change by about the same factor, by more than a datasheet is wrong.
    """
    identified = [n for n in result.values if n not in result.unidentifiable or n in result.at_bound]
    heat = [name for name in identified if result.network.parameters[name].unit == "J/K"]
    factors = np.array([result.values[name] / result.start[name] for name in heat])
    if len(factors) < 2 or not (factors > 0.0).all():
        return ""
    if not ((factors > CLOCK_FACTOR).all() or (factors < 1.0 / CLOCK_FACTOR).all()):
        return ""
    middle = float(np.exp(np.median(np.log(factors))))
    return (
        f"all heat capacities that the record identifies are about {middle:.2g} times those of the twin file "
        f"({', '.join(heat)}); a clock at another rate has this effect: if a second of the record is not one of the "
        "rig, give --time-scale"
    )
