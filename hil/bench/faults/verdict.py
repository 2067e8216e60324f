"""Verdict on one case of the fault campaign: its outcome, and the broken requirements."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Any

from drivers.virtual.devices import Moment
from hil.bench.faults import judge
from hil.bench.faults.kinds import Ending, FaultKind
from hil.bench.faults.plan import FaultCase, worst
from hil.bench.faults.rig import PERIOD_S, STALE_LIMIT_S, WATCHDOG_S
from hil.bench.faults.stage import Stage

Strike = tuple[FaultKind, float]
"""Fault and the wall time of its occurrence, s."""
REACT_S = 1.0
"""Time from detection to safe, s."""
TRUTH_STEP_S = 2.0 * PERIOD_S
"""Tolerance for the watchdog, s: it is checked once a period, and its last heartbeat may follow the fault."""


@dataclass(slots=True)
class FaultResult:
    """Result of one case. Times in s after the occurrence; `detected` and `safe` are None if that never happened. `by`
    is the detecting agent: the harness, its guardian or the rig's watchdog. `acknowledged` and `lost` count samples.

    `by` is who detected: the harness, its guardian or the rig's watchdog. `acknowledged` and `lost` count samples.
    """

    kind: str
    number: int
    ended: str = ""
    by: str = ""
    noticed: float | None = None
    detected: float | None = None
    safe: float | None = None
    heated: bool = False
    acknowledged: int = 0
    lost: int = 0
    unsaved_s: float | None = None
    wrong: list[str] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    reason: str = ""
    stall_s: float = 0.0
    attempts: int = 1
    resumed: bool | None = None
    refused: bool | None = None
    """True if a resume of a run that was over before its first sample was refused in a sentence with a remedy."""
    wire_down: bool = False
    """True if, of two faults, the harness detected while its wire to the heater was down, so that only the rig could
    act.
    """
    struck: bool = True
    """True if the fault came while something heated, for kinds that require it."""


def as_document(result: FaultResult) -> dict[str, Any]:
    """Return the result as JSON data."""
    return asdict(result)


def judged(result: FaultResult, case: FaultCase, stage: Stage, strikes: list[Strike]) -> judge.JournalContent:
    """Complete `result` from the files of rig and harness; return the journal."""
    truth, journal = stage.moments(), judge.read_journal(stage.look())
    _judge(result, case, stage, journal, truth, strikes)
    return journal


def _blamed(
    case: FaultCase, stage: Stage, journal: judge.JournalContent, strikes: list[Strike]
) -> tuple[Ending, float]:
    """Return the required outcome of the faults on a run that went on, and its time: the gravest one's occurrence."""
    left = judge.ended_at(journal, strikes[0][1])
    if left is None and "tmpfs" in case.places:
        left = stage.told_s
    struck = [strikes[0], *((kind, at_s) for kind, at_s in strikes[1:] if left is None or at_s <= left)]
    ending = worst(kind.ending for kind, _ in struck)
    return ending, min(at_s for kind, at_s in struck if kind.ending == ending)


def _judge(
    result: FaultResult,
    case: FaultCase,
    stage: Stage,
    journal: judge.JournalContent,
    truth: list[Moment],
    strikes: list[Strike],
) -> None:
    harness = stage.harness
    ending, occurred_s = _blamed(case, stage, journal, strikes)
    before = [moment for moment in truth if moment.wall_s <= occurred_s]
    result.heated = bool(before) and before[-1].heater_W > 0.0
    result.stall_s = max(judge.longest_stall_s(truth, harness.started_s), stage.starved_s)
    result.acknowledged, result.lost = len(stage.seen.rows), judge.lost(stage.seen, journal)
    result.wrong = judge.wrong_values(journal, truth)
    noticed, left = judge.noticed_at(journal, occurred_s, stage.asked_s), judge.ended_at(journal, occurred_s)
    watchdog, safe = judge.watchdog_at(truth, occurred_s), judge.safe_since(truth, occurred_s)
    guardian = judge.guardian_at(harness.folder(), occurred_s)
    result.noticed = None if noticed is None else noticed - occurred_s
    rode = result.ended == "rode through"
    result.reason = next((row[3] for row in reversed(journal.states) if row[2] in ("finishing", "faulted")), "")
    if left is None and "tmpfs" in case.places:
        left = stage.told_s  # Its journal cannot record it any more.
    detected = noticed if rode else min((t for t in (left, guardian, watchdog) if t is not None), default=None)
    if not rode:
        by = {left: "harness", guardian: "guardian", watchdog: "rig"}
        result.by = "" if detected is None else by[detected]
        result.ended = result.ended or harness.ended_as() or "ended by itself"
        result.safe = None if safe is None else safe - occurred_s
    if detected is not None:
        result.detected = detected - occurred_s
        cut_by_rig = watchdog is not None and safe is not None and abs(watchdog - safe) <= TRUTH_STEP_S
        wires = (at_s for kind, at_s in strikes if kind.wire == "plc" and kind.ending != "rides")
        result.wire_down = len(strikes) > 1 and cut_by_rig and min(wires, default=math.inf) <= detected
    if journal.ticks and ending == "killed" and "tmpfs" not in case.places:
        result.unsaved_s = max(occurred_s - journal.wall_s[-1], 0.0)
    if "Traceback" in harness.said() and not case.early:
        result.failures.append("it ended with a traceback instead of a sentence")
    result.failures += _broken(result, ending, case.early, journal, rode)


def _broken(result: FaultResult, ending: Ending, early: bool, journal: judge.JournalContent, rode: bool) -> list[str]:
    """Return the requirements that this case broke."""
    broken = []
    if ending == "rides" and not rode:
        broken.append("the run ended of a fault that it has to ride through")
    if ending == "stops" and rode:
        broken.append("the run went on")
    if result.heated and not rode:
        limit = WATCHDOG_S + TRUTH_STEP_S if ending == "killed" else STALE_LIMIT_S
        if result.safe is None:
            broken.append("the heater was never cut")
        elif result.safe > limit:
            broken.append(f"safe {result.safe:.2f} s after the fault, the limit is {limit:g} s")
        react_s = WATCHDOG_S + TRUTH_STEP_S if result.wire_down else REACT_S
        if result.detected is None:
            # A harness that hangs on a rig that restarted has nothing left to detect.
            broken += [] if ending == "killed" and result.safe is not None else ["never detected"]
        elif result.safe is not None and result.safe - result.detected > react_s:
            broken.append(f"safe {result.safe - result.detected:.2f} s after detection")
    if not result.heated and not early:
        result.struck = False
        broken.append("nothing heated when the fault came")
    if not result.heated and result.safe is None and not rode:
        broken.append("something heats after the fault")
    if not journal.sound:
        broken.append("the journal is damaged")
    if result.lost:
        broken.append(f"{result.lost} acknowledged samples lost")
    if result.wrong:
        broken.append(f"{len(result.wrong)} wrong values recorded as good: {result.wrong[0]}")
    if result.unsaved_s is not None and result.unsaved_s > 1.0:
        broken.append(f"the last {result.unsaved_s:.2f} s were not in the journal")
    return broken
