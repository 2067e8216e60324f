"""Gates of a proposal: every one must hold, or the proposal goes to an engineer with its reason codes.

| code | holds back where |
|---|---|
| `MISSING_REQUIRED` | more than a quarter of the required channels is hidden |
| `LOW_SENSITIVITY:<parameter>` | the condition is above 80; of the weaker of the deviations that are confounded |
| `HIGH_UNCERTAINTY` | the outlet's interval is wider than 0.8 K either way |
| `OUT_OF_ENVELOPE` | the operating point is further from those before than 99.5 % of further ones would be |
| `CONTRADICTORY_EVENT` | a deviation jumped and no event explains it |
| `CONTRADICTORY_LABEL:<parameter>` | a label contradicts what is known without it, or another label |
| `CONTRADICTORY_RECORD` | the outlet thermometer steps further or more often in the record than a thermometer does |
| `OUT_OF_BOUNDS:<parameter>` | the value is outside the bounds of the deviation |
| `WETBULB_DROPPED` | the wet bulb was dropped for its closure in more than a quarter of the minutes |
| `BYPASS` | the bypass was open in more than a quarter of the minutes |
| `NO_SECOND_THERMOMETER` | of the bias: neither a second thermometer nor a certificate |
| `FEW_EXCITED_WINDOWS` | of fill, air, uniformity: fewer than three excited windows before |
| `NO_INSPECTION:<parameter>` | of fill and uniformity: no inspection of the cell, and no label of it, within 90 days |
| `REVERTED:<parameter>` | an operator reverted this value, and nothing new shows it (`hil.tower.governance.reverted`) |
| `BALANCE_OFF:<reason>` | the station's water balance is not used, for information |

Reasons: `NO_MAKEUP` and `NO_BASIN` where flow or volume is unknown, `NOT_ALL_CELLS` where a cell of the station is not
calibrated, `NO_WHOLE_SUM` without six hours of known flows, `NOT_CLOSED` where most sums contradict the cells.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from twin.network import Network
from twin.tower import DEVIATIONS, IDS, MOST_HIDDEN, Array, TargetWindow, novelty
from twin.tower.cell_observations import Label

ProposalsOf = Callable[[int], Sequence[tuple[str, float, float]]]
"""Name, value and standard deviation of each deviation that is proposed in a window of this number."""

MOST_HALF_K = 0.8
MOST_DROPPED = 0.25
EXCITED_WINDOWS = 3
INSPECTED_DAYS = 90.0
"""A fill that loses 0.2 to 0.6 % a week has moved by some 5 % after these days: an older inspection says little."""
CERTIFIED_DAYS = 365.0
"""Usual interval between calibrations of a thermometer."""


@dataclass(frozen=True)
class Verdict:
    """Reason codes of a window that hold for all deviations, and those of each deviation; `notes` are for
    information."""

    codes: tuple[str, ...]
    of: dict[str, tuple[str, ...]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def accepts(self, name: str) -> bool:
        """Return True if all gates of a deviation hold."""
        return not self.codes and not self.of.get(name, ())


@dataclass(frozen=True)
class GateEvidence:
    """Evidence beside the record: labels of the cell, inspections by event s, steps and jumps that nothing explains
    s, and whether a basin thermometer is in use. `balance`: reason for which the water balance is not used, or
    nothing."""

    labels: Sequence[Label]
    inspections_s: Sequence[float]
    unexplained_s: Sequence[float]
    second_thermometer: bool
    balance: str = ""
    contradictory: bool = False
    """The record contradicts itself somewhere: what it says elsewhere waits for whoever mends it."""
    conflicts: frozenset[str] = frozenset()
    """Deviations with a label that contradicts what is known without it."""


def judge(windows: Sequence[TargetWindow], dropped: Array, bypass: Array, evidence: GateEvidence) -> list[Verdict]:
    """Return the verdict on each window.

    Parameters
    ----------
    windows
        Windows of one cell in order of time.
    dropped, bypass
        Share of its minutes without wet bulb, and with bypass.
    """
    notes = (f"BALANCE_OFF:{evidence.balance}",) if evidence.balance else ()
    distance = novelty([w.features for w in windows], [not w.told.refused for w in windows])
    verdicts, excited = [], 0
    for window, apart, dry, open_ in zip(windows, distance, dropped, bypass, strict=True):
        codes = []
        if window.told.hidden > MOST_HIDDEN:
            codes.append("MISSING_REQUIRED")
        if not window.half <= MOST_HALF_K:
            codes.append("HIGH_UNCERTAINTY")
        if apart > 1.0:
            codes.append("OUT_OF_ENVELOPE")
        if any(window.start_s - 86400.0 <= at < window.end_s for at in evidence.unexplained_s):
            codes.append("CONTRADICTORY_EVENT")
        if evidence.contradictory:
            codes.append("CONTRADICTORY_RECORD")
        if dry > MOST_DROPPED:
            codes.append("WETBULB_DROPPED")
        if open_ > MOST_DROPPED:
            codes.append("BYPASS")
        if window.excited and not window.told.refused:
            excited += 1
        verdicts.append(Verdict(tuple(codes), _of_each(window, excited, evidence), notes))
    return verdicts


def held_beyond_bounds(
    windows: Sequence[TargetWindow], verdicts: Sequence[Verdict], proposals: ProposalsOf, network: Network
) -> list[Verdict]:
    """Return the verdicts with values held back that lie outside the bounds of their deviations.

    Parameters
    ----------
    windows, verdicts
        Windows of a cell, and the verdict on each.
    proposals
        Function that returns the proposals of a window.
    network
        Twin of the cell, whose parameters have the bounds.
    """
    bounds = {name: tuple(float(b[0]) for b in network.bounds([identifier])) for name, identifier in IDS.items()}
    found = []
    for k, verdict in enumerate(verdicts):
        of = dict(verdict.of)
        for name, value, _ in proposals(k) if windows[k].share_known > 0.0 else ():
            low, high = bounds[name]
            if np.isfinite(value) and not low < value < high:
                of[name] = (*of.get(name, ()), f"OUT_OF_BOUNDS:{name}")
        found.append(replace(verdict, of=of))
    return found


def _of_each(window: TargetWindow, excited: int, evidence: GateEvidence) -> dict[str, tuple[str, ...]]:
    def labelled(name: str, days: float) -> bool:
        return any(
            one.parameter == name and abs(window.end_s - one.time_s) <= 86400.0 * days for one in evidence.labels
        )

    inspected = any(abs(window.end_s - at) <= 86400.0 * INSPECTED_DAYS for at in evidence.inspections_s)
    found: dict[str, tuple[str, ...]] = {}
    for name in DEVIATIONS:
        codes = [f"LOW_SENSITIVITY:{name}"] if name in window.told.frozen else []
        if name in evidence.conflicts:
            codes.append(f"CONTRADICTORY_LABEL:{name}")
        if name == "bias":
            if not evidence.second_thermometer and not labelled(name, CERTIFIED_DAYS):
                codes.append("NO_SECOND_THERMOMETER")
        else:
            if excited < EXCITED_WINDOWS:
                codes.append("FEW_EXCITED_WINDOWS")
            if name != "air" and not inspected and not labelled(name, INSPECTED_DAYS):
                codes.append(f"NO_INSPECTION:{name}")
        found[name] = tuple(codes)
    return found
