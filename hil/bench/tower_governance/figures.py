"""Figures of the rows, from what was known of each cell at each time and from the truth.

Nothing here calibrates: all values were known at their time.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import rankdata

from hil.bench.tower_governance.cases import (
    CLEAN_END,
    CLEAN_FIRST,
    CLEANING,
    HEALTHY_DAYS,
    PLAIN,
    RAMP,
    RAMP_END,
)
from hil.bench.tower_governance.known import LEVEL, CellTrial, Proposal, WindowError, says_loss
from twin import NORMAL90
from twin.tower import DAY_S, DEVIATIONS

TOLERANCE = 0.015
"""Tolerance of the fill in row A17: a loss of 5 % that is proposed earlier than this is a false alarm."""
APART_S = DAY_S
"""Time within which two calibrations' drift alarms are the same: an alarm needs a day of its indicators."""
LARGE_K = 0.5
"""Error of a window's outlet above which a gate should withhold it."""
INSPECTION_SD = {"fill": 0.038 / NORMAL90, "air": 0.02, "uniformity": 0.03 / NORMAL90, "bias": 0.05}
"""Standard uncertainty of the simulated inspections, traverses and reference thermometers of a station."""
CONFIRMED, OPEN, FALSE = "confirmed", "open", "false"
AFTER_D = (4.0, 9.0)
"""Days after a cleaning at which its trace is reported again."""


@dataclass(frozen=True, slots=True)
class RampFigures:
    """A ramp: days on which the true loss of fill, that proposed and that accepted reach 5 %; the true loss at its end,
    that proposed and that accepted; whether 5 % were proposed too early; drift alarms."""

    crossed_day: float | None
    found_day: float | None
    accepted_day: float | None
    true_loss: float
    found_loss: float | None
    accepted_loss: float | None
    early: bool
    drift_alarms: int

    @property
    def delay_d(self) -> float | None:
        """Days from the true crossing to the calibration that proposes it."""
        return None if self.found_day is None or self.crossed_day is None else self.found_day - self.crossed_day


def ramp_figures(cell: CellTrial) -> RampFigures:
    """Return the figures of a cell with a ramp of the fill."""
    first, adopted = (next((one for one in cell.known if says_loss(one, gated)), None) for gated in (False, True))
    end = cell.at_day(RAMP_END)
    assert end is not None
    found, accepted = (
        None if (one := by.get("fill")) is None else 1.0 - one.value for by in (end.present, end.accepted)
    )
    return RampFigures(
        None if cell.crossed_s is None else cell.day(cell.crossed_s),
        None if first is None else cell.day(first.time_s),
        None if adopted is None else cell.day(adopted.time_s),
        1.0 - end.true["fill"],
        found,
        accepted,
        first is not None and first.true["fill"] > LEVEL + TOLERANCE,
        len(drift_alarms_of(cell)),
    )


def false_losses(cell: CellTrial) -> int:
    """Return how often a loss of 5 % of a cell's fill is proposed while the truth is further from it than the
    tolerance, each time until a calibration proposes less."""
    false = [says_loss(one) and one.true["fill"] > LEVEL + TOLERANCE for one in cell.known]
    return sum(now and not before for before, now in zip([False, *false[:-1]], false, strict=True))


def drift_alarms_of(cell: CellTrial) -> list[tuple[float, tuple[str, ...]]]:
    """Return the drift alarms of a cell as its calibrations raised them, each once."""
    found: list[tuple[float, tuple[str, ...]]] = []
    for state in cell.known:
        for time_s, names in state.alarms:
            if cell.day(time_s) >= HEALTHY_DAYS and all(abs(time_s - other) > APART_S for other, _ in found):
                found.append((time_s, names))
    return found


@dataclass(frozen=True, slots=True)
class CleaningFigures:
    """Trace of a cleaning in a calibration: name of its time, day, true and found change of the uniformity, and the
    change of each deviation in standard deviations of the proposal before."""

    when: str
    day: float
    true: float
    found: float
    moved: dict[str, float]

    @property
    def seen(self) -> bool:
        """Return True if the uniformity alone moves, to the right side, by a standard deviation at least."""
        right = self.moved["uniformity"] * np.sign(self.true) >= 1.0
        return bool(right and self.others < 1.0)

    @property
    def others(self) -> float:
        """Largest change of another deviation, in standard deviations."""
        return max(abs(v) for name, v in self.moved.items() if name != "uniformity")


def cleaning_figures(cell: CellTrial) -> list[CleaningFigures]:
    """Return the trace of a cell's cleaning after its third excited window, and days later."""
    before = [one for one in cell.known if cell.day(one.time_s) <= CLEAN_FIRST][-1]
    times = {} if cell.third_s is None else {"3 excited windows": cell.third_s}
    times |= {f"{d:g} days": cell.start_s + DAY_S * (CLEAN_END + d) for d in AFTER_D}
    found = []
    for name, time_s in times.items():
        after = next((one for one in cell.known if abs(one.time_s - time_s) < 1.0), None)
        if after is not None and after.present.keys() >= set(DEVIATIONS) <= before.present.keys():
            found.append(_trace(name, cell.day(time_s), before.present, after.present))
    return found


def _trace(name: str, day: float, before: dict[str, Proposal], after: dict[str, Proposal]) -> CleaningFigures:
    moved = {n: (after[n].value - before[n].value) / before[n].sd for n in DEVIATIONS}
    first, last = before["uniformity"], after["uniformity"]
    return CleaningFigures(name, day, last.true - first.true, last.value - first.value, moved)


@dataclass(frozen=True, slots=True)
class GateFigures:
    """Gates on windows: windows, share withheld, MAE of the outlet K of accepted and of withheld ones, windows with a
    large error, and the AUROC of the gates, and of the interval's width, for these."""

    windows: int
    withheld: float
    accepted_K: float
    withheld_K: float
    large: int
    auroc: float
    width_auroc: float


def gate_figures(windows: Sequence[WindowError]) -> GateFigures:
    """Return the figures of gates; a window is withheld where one of its own reason codes holds."""
    held = np.array([bool(one.codes) for one in windows], dtype=bool)
    error = np.array([one.error for one in windows], dtype=float)
    minutes = np.array([one.minutes for one in windows], dtype=float)
    half = np.array([one.half for one in windows], dtype=float)
    large = error > LARGE_K
    return GateFigures(
        len(windows),
        float(held.mean()) if len(held) else float("nan"),
        _weighted(error[~held], minutes[~held]),
        _weighted(error[held], minutes[held]),
        int(large.sum()),
        auroc(held.astype(float), large),
        auroc(np.nan_to_num(half, nan=np.inf), large),
    )


def _weighted(values: np.ndarray, weights: np.ndarray) -> float:
    return float(np.average(values, weights=weights)) if len(values) else float("nan")


def auroc(score: np.ndarray, positive: np.ndarray) -> float:
    """Return the area under the receiver operating characteristic of a score, ties counted half; NaN for one class.

    Source: Hanley & McNeil, Radiology 143 (1982) 29.
    """
    count, rest = int(positive.sum()), int((~positive).sum())
    if not count or not rest:
        return float("nan")
    ranks = rankdata(score)
    return float((ranks[positive].sum() - 0.5 * count * (count + 1)) / (count * rest))


@dataclass(frozen=True, slots=True)
class Judged:
    """A persistent proposal: cell, deviation, proposal with its truth, and the value before."""

    cell: CellTrial
    name: str
    proposal: Proposal
    before: float

    @property
    def nearer(self) -> bool:
        """Return True if the truth is nearer to the proposal than to the value before."""
        return abs(self.proposal.true - self.proposal.value) < abs(self.proposal.true - self.before)

    @property
    def verdict(self) -> str:
        """Return `CONFIRMED` or `FALSE` by the side of the middle on which the truth is, `OPEN` where an inspection
        cannot decide."""
        middle = 0.5 * (self.proposal.value + self.before)
        if abs(self.proposal.true - middle) < INSPECTION_SD[self.name]:
            return OPEN
        return CONFIRMED if self.nearer else FALSE


def persistent_proposals(cell: CellTrial) -> list[Judged]:
    """Return the persistent proposals of a cell: accepted in its last windows, and further from the value before than
    their own 90 % interval; the first value before is that of the clean cell, later ones are the proposals."""
    found = []
    for name in DEVIATIONS:
        value = 0.0 if name == "bias" else 1.0
        for state in cell.known:
            one = state.present.get(name)
            if one is not None and one.persistent and abs(one.value - value) > NORMAL90 * one.sd:
                found.append(Judged(cell, name, one, value))
                value = one.value
    return found


def verdict_counts(judged: Sequence[Judged]) -> Counter[str]:
    """Return the number of proposals by verdict."""
    return Counter(one.verdict for one in judged)


def of_kind(cells: Sequence[CellTrial], kind: str) -> list[CellTrial]:
    """Return the cells of a kind: `RAMP`, `CLEANING` or `PLAIN`."""
    assert kind in (RAMP, CLEANING, PLAIN)
    return [one for one in cells if one.kind == kind]
