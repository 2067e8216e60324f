"""Gates of a proposal: its parameters are adopted by the live twin only if all gates are open.

Each closed gate is a code with a sentence. A code with a parameter's name holds that parameter only. A code that holds
`EVERY` parameter does not discard the window: a live twin with a large error still follows its rig.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.calibrators.hiera_unet.data.series import STEP_S
from twin.network import Array

HIDDEN = 0.25
"""Share of the required inputs that may be hidden."""
SHORTEST_STEPS = 360
"""Least steps of record for a proposal: half an hour."""
UNSURE_K = 0.8
"""Largest half width of an output's 90 % interval, K."""
VAGUE = 0.5
"""Largest standard deviation of a parameter, as a share of its prior's."""
UNEXPLAINED = 3.0
"""Prediction error, in half widths of its intervals, from which it counts as unexplained; never less than the tolerance
of a calibrated twin."""
ROUGH = 12.0
"""Change from step to step, in noises of a step, that no thermal mass has as a median, and no majority of thermometers
at once."""
FLAT_STEPS = 120
FLAT_K = 1e-6
"""Change from step to step below which a reading is constant, K: means of equal readings differ by rounding."""
LEAKS = 0.05
EVERY = "every parameter"
UNREADABLE = ("SHORT_RECORD", "MISSING_REQUIRED", "FLAT_RECORD", "SHUFFLED_RECORD")
"""Codes of the gates on the record itself."""
BROKEN = ("FLAT_RECORD", "SHUFFLED_RECORD")
"""Codes of a record that is not of a rig, from which nothing is concluded."""


@dataclass(frozen=True)
class Reason:
    """Reason of a closed gate: a code, a plain sentence, and the parameter that it holds, or `EVERY`."""

    code: str
    sentence: str
    parameter: str = ""

    def __str__(self) -> str:
        return f"{self.code}: {self.sentence}"


@dataclass(frozen=True)
class Evidently:
    """Evidence that the gates evaluate.

    Attributes:
        hidden: share of the required inputs that is hidden, since the record began. steps: of record.
        measured: (n, Y) degC, all readings. noise: (Y,) K of one step. condition: of all parameters together.
        told: (P,) bool, identifiable parameters. half_width: (Y,) K mean half widths. missed, left: (Y,) K, root mean
            squares of measured minus predicted over the target, and of the residual of a fit to the latest segment
            there; NaN where nothing was measured. tolerated: K, error of a calibrated twin.
        lost: columns of inputs that were hidden for most of the target. sd, prior: (P,) of the deviations, now and
            before any data. distance: from the envelope, 1 at its limit.
        leakage: dependence of deviations on the noise of the last minutes.
    """

    hidden: float
    steps: int
    measured: Array
    noise: Array
    condition: float
    told: np.ndarray
    half_width: Array
    missed: Array
    left: Array
    tolerated: float
    lost: tuple[str, ...]
    sd: Array
    prior: Array
    distance: float
    leakage: float


def unreadable(hidden: float, steps: int, measured: Array, noise: Array) -> tuple[Reason, ...]:
    """Return the closed gates on the record itself, before any computation with it."""
    found = []
    if steps < SHORTEST_STEPS:
        seen, least = (STEP_S * n / 60.0 for n in (steps, SHORTEST_STEPS))
        found.append(Reason("SHORT_RECORD", f"{seen:.1f} minutes of record have been seen, fewer than {least:.0f}"))
    if hidden > HIDDEN:
        found.append(Reason("MISSING_REQUIRED", f"{hidden:.0%} of the required channels are hidden"))
    whole = np.abs(np.diff(measured, axis=0))
    change = whole[-FLAT_STEPS + 1 :]
    known = np.isfinite(change)
    if known.any() and len(measured) >= FLAT_STEPS and (change[known] < FLAT_K).all():
        found.append(Reason("FLAT_RECORD", "no thermometer has moved at all"))
    middle = [float(np.median(c[k])) / s for c, k, s in zip(change.T, known.T, noise, strict=True) if k.any()]
    if middle and min(middle) > ROUGH:
        found.append(Reason("SHUFFLED_RECORD", "readings jump from step to step as no rig does; are rows in order?"))
    elif torn := int(_torn(whole, noise).sum()):
        times = "once" if torn == 1 else f"{torn} times"
        told = f"most thermometers jump at the same moment, {times} in what was seen; are rows in order?"
        found.append(Reason("SHUFFLED_RECORD", told))
    return tuple(found)


def _torn(change: Array, noise: Array) -> np.ndarray:
    """Return the steps (n,) bool at which more than half of the thermometers, and two of them, jump in `change` (n, Y)
    K.
    """
    jumps = (change > ROUGH * noise).sum(axis=1)
    result: np.ndarray = jumps > np.maximum(np.isfinite(change).sum(axis=1) / 2.0, 1.0)
    return result


def reasons(e: Evidently, ids: tuple[str, ...]) -> tuple[Reason, ...]:
    """Return every closed gate: missing inputs, those on the record, those of single parameters."""
    found = list(unreadable(e.hidden, e.steps, e.measured, e.noise))
    if not e.told.any():
        found.append(
            Reason("LOW_SENSITIVITY", f"the record tells no parameter apart (condition number {e.condition:.2g})")
        )
    widest = float(np.max(e.half_width))
    if widest > UNSURE_K:
        found.append(Reason("HIGH_UNCERTAINTY", f"an output is known to no better than {widest:.2f} K"))
    if e.distance > 1.0:
        found.append(Reason("OUT_OF_ENVELOPE", f"{e.distance:.1f} times as far from what was trained on as is allowed"))
    # What a lost input did is no event of the rig's: the twin follows as it can, and no parameter is offered.
    surprised = not e.lost and (e.missed > np.maximum(UNEXPLAINED * e.half_width, e.tolerated)).any()
    if surprised and (e.left > e.tolerated).any():
        found.append(
            Reason("CONTRADICTORY_EVENT", "neither parameters nor corrections explain what was measured: a jump?")
        )
    if e.leakage > LEAKS:
        found.append(Reason("LEAKAGE", f"shuffling the last moments moves a parameter by {e.leakage:.0%} of its range"))
    if e.lost and e.steps >= SHORTEST_STEPS:
        unread = f"{' and '.join(e.lost)} {'were' if len(e.lost) > 1 else 'was'} not read"
        return (Reason("LOST_INPUT", f"{unread}, which parameters would only make up for", EVERY), *found)
    for k, name in enumerate(ids):
        if not e.told[k] and e.told.any():
            found.append(Reason("LOW_SENSITIVITY", f"{name} is not identifiable from the record: held", name))
        elif e.sd[k] > VAGUE * e.prior[k]:
            found.append(Reason("HIGH_UNCERTAINTY", f"{name} is known too vaguely: held", name))
    return tuple(found)


def held(found: tuple[Reason, ...], ids: tuple[str, ...]) -> np.ndarray:
    """Return the held parameters (P,) bool: all of them if a gate for the whole window is closed."""
    if any(not r.parameter for r in found):
        return np.ones(len(ids), dtype=bool)
    closed = {r.parameter for r in found}
    return np.array([EVERY in closed or name in closed for name in ids])
