"""Identifiability of a cell's deviations in a window: scaled sensitivities, condition number, combined direction.

    S = d(observation)/d(deviation) * bound / tolerance,    condition = largest over smallest singular value of S

A window whose condition number is above `MOST_CONDITION` is refused: the least singular vector names the deviations
that only their combination is known of, and the weaker of them is frozen until the rest is identifiable. The
Cramer-Rao standard deviations count the rows at the correlation time of the errors.

Source: Brun, Reichert & Kuensch, Water Resour. Res. 37 (2001) 1015 (scaled sensitivities, collinearity); Ljung, System
Identification, 2nd ed., sec. 7.4.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.tower.air import Array
from twin.tower.cell import CellDeviations, Design, Inputs, solve_cell
from twin.tower.model import DEVIATIONS, GLOBALS
from twin.tower.twin_file import BOUNDS

MOST_CONDITION = 80.0
"""Limit of the paper (2023). With the law of a dry share it separates the days whose flow or fan moves as `EXCITATION`
requires from the others."""
MOST_HIDDEN = 0.25
"""Share of channels that may be hidden."""
TOLERANCE = {"outlet": 0.3, "fan": 0.025, "evaporation": 0.05, "basin": 0.4}
"""K, share, share, K."""
CORRELATION_MIN = 30.0
EXCITATION = {"flow": 0.12, "fan": 0.15, "wet_bulb": 2.5}
"""Ranges within a window from which it is looked at at all: shares of design flow and of full speed, K."""
_STEP = 0.01
CLEAN = CellDeviations()
INFINITE = 1e9
"""Condition number where a direction is not seen at all; those that are seen reach 1e7, by rounding."""


def condition_text(condition: float) -> str:
    """Return a condition number in words: whole, and "infinite" where a direction is not seen at all."""
    return "infinite" if condition >= INFINITE else f"{condition:.0f}"


@dataclass(frozen=True)
class Identifiability:
    """Identifiability of the deviations in a window.

    Attributes
    ----------
    condition
        Of all deviations.
    sd
        Cramer-Rao standard deviations by name, in units of the deviation.
    combined
        Weight of each deviation in the direction that is known least, by name, of unit length.
    frozen
        Deviations that are held so that the rest is identifiable, the first frozen first.
    condition_left
        Of the rest.
    hidden
        Share of hidden channels.
    """

    condition: float
    sd: Mapping[str, float]
    combined: Mapping[str, float]
    frozen: tuple[str, ...]
    condition_left: float
    hidden: float = 0.0

    @property
    def refused(self) -> str:
        """Reason code of the refusal, or nothing."""
        if self.hidden > MOST_HIDDEN:
            return "MISSING_REQUIRED"
        return f"LOW_SENSITIVITY:{self.frozen[0]}" if self.condition > MOST_CONDITION and self.frozen else ""

    def condition_says(self) -> str:
        """Return the condition number in words."""
        return condition_text(self.condition)

    def says(self) -> str:
        """Return the combined direction in words."""
        ranked = sorted(self.combined.items(), key=lambda item: -abs(item[1]))
        first = np.sign(ranked[0][1]) or 1.0
        parts = [
            f"{'-' if weight * first < 0 else '+'} {abs(weight):.2f} {name}"
            for name, weight in ranked
            if abs(weight) >= 0.2
        ]
        return " ".join(parts).removeprefix("+ ")


def excited(u: Inputs, design: Design) -> bool:
    """Return True if a window passes the excitation thresholds; they only pre-filter, the condition number decides."""
    if len(u.t_in) < 2:
        return False
    moved = {
        "flow": float(np.ptp(u.m_w)) / design.m_w0,
        "fan": float(np.ptp(u.speed)),
        "wet_bulb": float(np.ptp(u.wet)),
    }
    return any(moved[name] >= least for name, least in EXCITATION.items())


def cell_sensitivities(
    design: Design, u: Inputs, sensors: Sequence[str], at: CellDeviations = CLEAN, kappa: float = -1.0
) -> Array:
    """Return the scaled sensitivities of a clean cell's observations (n * sensors, 4), row blocks in the order of
    `sensors`.

    Parameters
    ----------
    sensors
        Among outlet, fan, evaporation, basin.
    kappa
        Of the fan's power in a loss of air.
    """
    columns = []
    for name in DEVIATIONS:
        high, low = (_observed(design, u, sensors, at, name, sign * _STEP, kappa) for sign in (1.0, -1.0))
        columns.append((high - low) / (2.0 * _STEP) * BOUNDS[name])
    return np.stack(columns, axis=1)


def weighed_sensitivities(jac: Array, power: NDArray[np.bool_], kappa: float, second: bool) -> list[Array]:
    """Return the sensitivities of outlet, fan's power and, where it is used, basin in their tolerances, each (n, 4).

    Parameters
    ----------
    jac
        Of the outlet's reading to each deviation (n, 4).
    power
        Rows with a fan power (n,).
    kappa
        Of the fan's power in a loss of air.
    second
        A basin thermometer is in use.
    """
    fan = np.zeros_like(jac)
    fan[:, DEVIATIONS.index("air")] = np.where(power, kappa, 0.0)
    # The level of the fan's power is open by as much as its prior: a window learns little of the air from it.
    level = next(one.sd for one in GLOBALS if one.name == "power_gain")
    rows = [jac / TOLERANCE["outlet"], fan / np.hypot(TOLERANCE["fan"], level)]
    if second:
        water = jac.copy()
        water[:, DEVIATIONS.index("bias")] = 0.0
        rows.append(water / TOLERANCE["basin"])
    return rows


def _observed(
    design: Design, u: Inputs, sensors: Sequence[str], at: CellDeviations, name: str, step: float, kappa: float
) -> Array:
    values = {n: float(getattr(at, n)) for n in DEVIATIONS}
    values[name] += step
    out = solve_cell(u, design, CellDeviations(**values))
    rows = {
        "outlet": (out.t_out + values["bias"]) / TOLERANCE["outlet"],
        "basin": out.t_out / TOLERANCE["basin"],
        "fan": np.full(len(u.t_in), values["air"] ** -kappa / TOLERANCE["fan"]),
        "evaporation": np.log(np.maximum(out.evaporation, 1e-6 * design.m_w0)) / TOLERANCE["evaporation"],
    }
    return np.concatenate([rows[sensor] for sensor in sensors])


def identifiability(
    scaled: Array, minutes_per_row: float = 1.0, hidden: float = 0.0, limit: float = MOST_CONDITION
) -> Identifiability:
    """Return what scaled sensitivities (n, 4) tell.

    Parameters
    ----------
    minutes_per_row
        Between rows of one sensor.
    hidden
        Share of hidden channels.
    """
    rows = scaled[np.isfinite(scaled).all(axis=1)]
    information = rows.T @ rows * min(minutes_per_row / CORRELATION_MIN, 1.0)
    condition, direction = _condition(information)
    with np.errstate(divide="ignore", invalid="ignore"):
        covariance = np.linalg.pinv(information + 1e-12 * np.eye(len(information)), hermitian=True)
    sd = {name: float(np.sqrt(max(covariance[j, j], 0.0)) * BOUNDS[name]) for j, name in enumerate(DEVIATIONS)}
    left, frozen = list(range(len(DEVIATIONS))), []
    now, weakest = condition, direction
    while now > limit and len(left) > 1:
        frozen.append(left.pop(_weaker(information, left, weakest)))
        now, weakest = _condition(information[np.ix_(left, left)])
    combined = {name: float(w) for name, w in zip(DEVIATIONS, direction, strict=True)}
    return Identifiability(condition, sd, combined, tuple(DEVIATIONS[j] for j in frozen), now, hidden)


def _weaker(information: Array, left: Sequence[int], direction: Array) -> int:
    """Return the position in `left` of the weaker of the two deviations that dominate the least known direction."""
    pair = np.argsort(-np.abs(direction))[:2]
    strength = [information[left[k], left[k]] for k in pair]
    return int(pair[int(np.argmin(strength))])


def _condition(information: Array) -> tuple[float, Array]:
    """Return condition number and least known direction of an information matrix."""
    values, vectors = np.linalg.eigh(information)
    largest, smallest = float(values[-1]), float(max(values[0], 0.0))
    return (float(np.sqrt(largest / smallest)) if smallest > 1e-14 * largest and largest > 0.0 else INFINITE), vectors[
        :, 0
    ]
