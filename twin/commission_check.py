"""Checks of a commissioned twin before it is written: one that its record does not support is worse than none."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from twin.commission import CommissionResult

ABSURD_SIGMA = 10.0
"""Standard deviations of a sensor's noise below which an error is never absurd, however little the sensor moves."""
CLOCK_FACTOR = 3.0
"""Change of all heat capacities alike from which the record's clock is in question: a datasheet is that good."""


def refusal_reason(result: CommissionResult, measured: ArrayLike) -> str:
    """Return why the twin must not be used, a sentence, or "" where nothing speaks against it.

    It must not where the record identifies none of the tunables, or where most sensors are predicted worse over the
    part that no fit saw than by any constant within what they read in the whole record (their range), so that the twin
    knows nothing of them. A single sensor so far off may be dead or wired to another place.

    Args:
        measured: (n, m) degC, what was commissioned on, NaN where missing.
    """
    if result.values and len(result.cannot_tell) == len(result.values):
        return (
            f"the record identifies none of the {len(result.values)} tunables: inputs that never move, readings of "
            "another rig or a clock at another rate do that; record the rig while its inputs are moved, or give "
            "--time-scale where its clock is not in seconds"
        )
    y = np.asarray(measured, dtype=np.float64)
    absurd, judged = [], 0
    for j, (sensor, error) in enumerate(result.rmse_after.items()):
        read = y[np.isfinite(y[:, j]), j]
        if not len(read) or np.isnan(error):
            continue
        judged += 1
        span = float(np.ptp(read))
        if not error <= max(span, ABSURD_SIGMA * float(result.network.sigma[j])):
            absurd.append(f"{sensor} by {error:.3g} K where it moves by {span:.3g} K")
    if judged and len(absurd) > judged / 2:
        return (
            f"the twin errs over the part that no fit saw by more than its sensors move at all ({'; '.join(absurd[:3])}"
            f"{'; ...' if len(absurd) > 3 else ''}); check the units of the record's columns, its clock and the twin's "
            "structure"
        )
    return ""


def clock_warning(result: CommissionResult) -> str:
    """Return a sentence where the fitted heat capacities say that the record's clock runs at another rate, or "".

    A clock that is N times too slow makes every capacity N times too small and leaves the rest of the fit as good. So
    all capacities that the record identifies have then changed alike, by more than a datasheet is wrong.
    """
    heat = [
        name for name in result.values
        if result.network.parameters[name].unit == "J/K" and (name not in result.cannot_tell or name in result.at_bound)
    ]  # fmt: skip
    factors = np.array([result.values[name] / result.start[name] for name in heat])
    if len(factors) < 2 or not (factors > 0.0).all():
        return ""
    alike = bool((factors > CLOCK_FACTOR).all() or (factors < 1.0 / CLOCK_FACTOR).all())
    if not alike:
        return ""
    middle = float(np.exp(np.median(np.log(factors))))
    return (
        f"all heat capacities that the record identifies came out about {middle:.2g} times what the twin file says "
        f"({', '.join(heat)}): a clock at another rate does that; if a second of the record is not one of the rig, "
        "give --time-scale"
    )
