"""Simulated records of rigs with known truth, and the windows that are cut from them.

Seed and number of a campaign reproduce it bit by bit. About a third are healthy, for the first phase of training.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from twin.calibrators.hiera_unet.context_fit.evidence import estimate, identifiable
from twin.calibrators.hiera_unet.data.features import Features
from twin.calibrators.hiera_unet.data.series import STEP_S, ResampledSeries
from twin.calibrators.hiera_unet.data.windows import CONTEXT, TARGET
from twin.calibrators.hiera_unet.simulated import changes as undeclared
from twin.calibrators.hiera_unet.simulated.gaps import damaged, logged
from twin.calibrators.hiera_unet.simulated.loads import drive, wander
from twin.calibrators.hiera_unet.simulated.plants import Family, TrainingRig
from twin.network import Array

HEALTHY = 0.35
STEPS = 2520
"""Steps of a campaign: three and a half hours."""
WINDOWS = 3
APART = 60
"""Steps between the windows of a campaign, as in service."""
EARLY = 0.12
"""Share of campaigns whose first window begins before the record does."""
PER_RIG = 8
"""Campaigns of one rig."""
AMISS = 0.05
"""Share of its full size from which a change counts as present."""
SAME, STEADY = 0.03, 0.05
"""Difference of deviations that counts as none; change of a label within the target from which the label is unknown."""
INPUT_NOISE = {"_W": 0.8, "_pct": 0.06, "_C": 0.03}
INPUT_WANDER = {"_W": 0.0, "_pct": 0.0, "_C": 0.04}


@dataclass(frozen=True)
class LabelledRecord:
    """Record with its truth, over n steps.

    Attributes:
        truth: (n, Y) degC, readings without noise and faults. theta: (n, P), NaN where the plant has no such parameter.
            amiss: (n,) bool, an undeclared change is present.
        nominal: (p,) of the commissioned twin. source: generator of the record. what: the changes, in words.
    """

    series: ResampledSeries
    truth: Array
    theta: Array
    amiss: np.ndarray
    nominal: Array
    source: str
    what: tuple[str, ...] = ()

    @property
    def onset(self) -> int:
        """Return the first step with an undeclared change; n if there is none."""
        return int(np.argmax(self.amiss)) if self.amiss.any() else len(self.amiss)


@dataclass(frozen=True)
class WindowLabel:
    """Label of a window, and its fit: theta (P,), known (P,), changed, fit (`ContextFit.kept`)."""

    end: int
    theta: Array
    known: np.ndarray
    changed: bool
    fit: Array


def simulated(family: Family, seed: int, number: int) -> LabelledRecord:
    """Return campaign `number` of a seed: a rig of the family, operated at random, healthy or not."""
    rng = np.random.default_rng([seed, number, 3])
    rig = rig_of(family, seed, number // PER_RIG)
    hour = float(rng.uniform(0.0, 24.0))
    inputs = drive(family.network, rng, STEPS, hour, power=rig.power)
    changes = () if rng.uniform() < HEALTHY else undeclared.draw(family, rig.plant, rng, inputs, hour)
    return recorded(family, rig, rng, inputs, hour, changes)


def recorded(
    family: Family,
    rig: TrainingRig,
    rng: np.random.Generator,
    inputs: Array,
    hour: float,
    changes: tuple[undeclared.Change, ...],
    *,
    gaps: bool = True,
) -> LabelledRecord:
    """Return the logged record of a rig that is driven with `inputs` (n, c) from `hour` o'clock on, with changes.

    Args:
        gaps: whether readings may be missing or stuck.
    """
    n = len(inputs)
    theta = undeclared.moved(changes, len(family.deviations), n)
    heat = undeclared.heated(changes, family, n)
    state = family.start(rig.plant, inputs, rng)
    # The thermometers' constant offsets belong to the rig: the twin was commissioned with them.
    truth = family.readings(_vectors(family, rig, theta, changes), state, inputs, heat) + rig.offsets
    amiss = np.zeros(n, dtype=bool)
    for change in changes:
        amiss |= change.course > AMISS
    read = truth.copy()
    for change in changes:
        if change.error is not None:
            read[:, change.sensor] = change.error(read[:, change.sensor])
    told, measured = _logged(family, rig, rng, inputs, read)
    said: tuple[str, ...] = ()
    if gaps:
        told, measured, said = damaged(rng, told, measured)
    known_time = rng.uniform() < 0.7
    series = ResampledSeries(
        np.arange(n, dtype=np.float64) * STEP_S,
        told,
        measured,
        np.full(measured.shape, np.nan),
        hour=hour if known_time else float("nan"),
        day=float(rng.uniform(0.0, 365.0)) if known_time else float("nan"),
    )
    label = theta + undeclared.equivalent(heat, family)
    return LabelledRecord(series, truth, label, amiss, rig.nominal, "twin", (*(c.what for c in changes), *said))


def _logged(
    family: Family, rig: TrainingRig, rng: np.random.Generator, inputs: Array, read: Array
) -> tuple[Array, Array]:
    """Return the inputs and readings as logged."""
    told = inputs.copy()
    for j, column in enumerate(family.network.input_columns):
        ending = next((e for e in INPUT_NOISE if column.endswith(e)), "")
        if ending:
            noise = INPUT_NOISE[ending] * rng.standard_normal(len(told)) / np.sqrt(STEP_S)
            told[:, j] += np.where(told[:, j] != 0.0, noise, 0.0) + wander(rng, len(told), INPUT_WANDER[ending], 600.0)
    return told, logged(rng, read, rig.sigma)


def _vectors(
    family: Family, rig: TrainingRig, theta: Array, changes: tuple[undeclared.Change, ...]
) -> list[tuple[int, Array]]:
    """Return the plant's vector at each of its changes, slow ones in steps of five minutes."""
    rows = [theta] + [c.course[:, None] for c in changes if c.added]
    course = np.hstack(rows)
    moved = np.abs(np.diff(course, axis=0, prepend=course[:1]))
    edges = {0, *np.flatnonzero((moved > 0.02).any(axis=1)).tolist()}
    if ((moved > 0.0) & (moved <= 0.02)).any():
        edges |= set(range(0, len(theta), APART))
    starts = sorted(e for e in edges if e < len(theta) - 1)
    found = []
    for first, last in zip(starts, [*starts[1:], len(theta)], strict=True):
        middle = min((first + last) // 2, len(theta) - 1)
        vector = family.deviated(rig.plant, theta[middle])
        for change in changes:
            for k, amount in change.added.items():
                vector[k] += change.course[middle] * amount
        found.append((first, vector))
    return found


@lru_cache(maxsize=4)
def _rig_of(family: Family, seed: int) -> TrainingRig:
    return family.rig(seed)


def rig_of(family: Family, seed: int, number: int) -> TrainingRig:
    """Return rig `number` of a seed."""
    return _rig_of(family, int(np.random.default_rng([seed, number, 5]).integers(1, 2**31)))


def ends(campaign: LabelledRecord, rng: np.random.Generator, count: int = WINDOWS) -> list[int]:
    """Return the last steps (exclusive) of windows: mostly after the change, if there is one."""
    n = len(campaign.series)
    reach = APART * (count - 1)
    low = CONTEXT if rng.uniform() > EARLY else TARGET + 240
    if campaign.amiss.any() and rng.uniform() < 0.75:
        low = max(low, min(campaign.onset + TARGET // 2, n - reach))
    last = int(rng.integers(low, max(n - reach, low) + 1))
    return [min(last + APART * k, n) for k in range(count)]


def label(features: Features, campaign: LabelledRecord, end: int) -> WindowLabel:
    """Return truth and evidence of the window that ends before step `end`."""
    frame = features.frame(campaign.series, end, campaign.nominal)
    rows = campaign.theta[end - TARGET : end]
    theta = rows.mean(axis=0)
    with np.errstate(invalid="ignore"):
        away = np.nanmax(np.abs(campaign.theta[:end] - theta), axis=1, initial=0.0) > SAME
    before = np.flatnonzero(away[: end - TARGET // 2])
    since = int(before[-1]) + 1 if before.size else 0
    known = identifiable(features, frame, campaign.nominal, since - (end - CONTEXT))
    known &= np.isfinite(theta) & (np.ptp(rows, axis=0) < STEADY)
    evidence = estimate(features, frame, campaign.nominal)
    changed = bool(campaign.amiss[end - TARGET : end].any())
    return WindowLabel(end, theta, known, changed, evidence.kept())
