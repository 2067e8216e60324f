"""Verdict on one chaos case: time to safe by the rig's own log, samples, values, times, and the run folder."""

from __future__ import annotations

import contextlib
import json
import math
import sqlite3
import statistics
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from drivers.virtual.devices import Moment
from hil.bench.chaos.device import DELAY_S
from hil.bench.chaos.kinds import ChaosKind, Ending, gravest
from hil.bench.chaos.plan import ChaosCase, order
from hil.bench.chaos.stage import ChaosStage, unstepped
from hil.bench.faults import PERIOD_S, WATCHDOG_S, judge
from hil.run.outputs import DEAD_TIME_S

LIMIT_S = 2.0
"""Time from the event until nothing heats, by any agent but the rig's own watchdog, s."""
ROUGH_S = 2.0 * PERIOD_S
"""Tolerance for the rig's watchdog, s: it is checked once a period, and its last heartbeat may follow the event."""
WITHHELD_AFTER_S = DEAD_TIME_S + 0.5
"""Delay in s after the event beyond which a heartbeat, with the heater still powered, counts as holding the watchdog
off. A run allows the meter its dead time; half a second is for ticks and for the meter's noise.

A run allows the meter its dead time; half a second is for ticks and for the meter's noise.
"""
ALARM_S = 5.0
"""Longest time from a set-point of another master to the alarm, s."""
TIME_TOLERANCE_S = 0.5
"""Largest difference between a row's time and the instant of its recording, s. A stall of the machine of up to 0.4 s
counts as the machine's.
"""
_NOT_OF_TIME = ("a traceback", "a resume ended with a traceback", "another master", "exit code", "run.json", "ended as")
_ENDED = ("finishing", "faulted", "aborted", "done")

Strike = tuple[ChaosKind, float]
"""Kind and wall time of an attack, s."""


@dataclass(slots=True)
class ChaosResult:
    """Result of one case.

    `event_s` is how long after the first attack the run could no longer go on as it should. `by_rig`: the rig's own
    watchdog cut. `misplaced` counts rows whose time is not that of their values. `left_out` says why an attack was not
    possible on this machine.
    """

    names: list[str]
    index: int
    watchdog: bool
    early: bool = False
    ending: str = ""
    ended: str = ""
    status: str = ""
    event_s: float = 0.0
    safe: float | None = None
    by_rig: bool = False
    heated: bool = False
    struck: bool = True
    acknowledged: int = 0
    lost: int = 0
    wrong: list[str] = field(default_factory=list)
    misplaced: int = 0
    readable: bool = True
    claimed: bool | None = None
    """Return the run's own statement on being safe, from `run.json`."""
    resumed: bool | None = None
    failures: list[str] = field(default_factory=list)
    left_out: str = ""
    reason: str = ""
    stall_s: float = 0.0
    attempts: int = 1

    @property
    def name(self) -> str:
        """Return the names of the kinds, joined."""
        return " + ".join(self.names)


def as_document(result: ChaosResult) -> dict[str, Any]:
    """Return the result as JSON data."""
    return asdict(result)


def judged(result: ChaosResult, case: ChaosCase, stage: ChaosStage, strikes: list[Strike]) -> judge.JournalContent:
    """Complete `result` from the rig's log and the run's files; return the journal in this machine's time."""
    truth, path = stage.moments(), stage.look()
    raw = judge.read_journal(path)
    journal = _on_our_clock(raw, stage)
    ending, event_s = event_of(strikes, stage, journal)
    began = strikes[0][1]
    before = [moment for moment in truth if moment.wall_s <= event_s]
    result.ending, result.event_s = ending, event_s - began
    result.heated = any(moment.heater_W > 0.0 for moment in before if moment.wall_s >= began - 1.0)
    result.stall_s = max(judge.longest_stall_s(truth, stage.harness.started_s), stage.starved_s)
    result.acknowledged = 0 if stage.destroyed else len(stage.seen.rows)
    result.lost = 0 if stage.destroyed else judge.lost(stage.seen, raw)
    result.wrong = judge.wrong_values(journal, truth)
    result.misplaced = misplaced_rows(path, stage, began)
    safe = judge.safe_since(truth, event_s)
    result.safe = None if safe is None else active_s(stage.nobody, event_s, safe)
    watchdog = judge.watchdog_at(truth, began)
    result.by_rig = watchdog is not None and safe is not None and abs(watchdog - safe) <= ROUGH_S
    manifest = read_manifest(stage)
    result.status = "" if manifest is None else str(manifest.get("exit_status"))
    result.reason = "" if manifest is None else str(manifest.get("reason"))[:300]
    result.readable = not (problems := _unreadable(case, stage, ending, raw, manifest))
    result.failures += problems
    result.failures += _power(result, case, stage, ending, truth, event_s, safe)
    result.failures += _claims(result, case, stage, ending, truth, manifest)
    result.failures += _records(result, strikes, journal, stage.asked_s)
    if not case.early and (error := traceback_in(stage.harness.said())):
        result.failures.append(f"a traceback in the terminal instead of a sentence: {error}")
    return journal


def is_of_the_machine(result: ChaosResult) -> bool:
    """Return True if a stall of the machine may cause a failure; a traceback or a claim has another cause."""
    return any(not failure.startswith(_NOT_OF_TIME) for failure in result.failures)


def traceback_in(said: str) -> str:
    """Return the last lines of the first traceback in `said`; "" if there is none."""
    _, found, after = said.partition("Traceback (most recent call last)")
    if not found:
        return ""
    lines = after.splitlines()[1:]
    end = next((k for k, line in enumerate(lines) if line and not line.startswith(" ")), len(lines) - 1)
    return " / ".join(line.strip() for line in lines[max(end - 3, 0) : end + 1])[-400:]


def event_of(strikes: list[Strike], stage: ChaosStage, journal: judge.JournalContent) -> tuple[Ending, float]:
    """Return the required ending of the attacks, and the wall time by which the heater must be cut, s.

    That is the attack, where it ends the run; the signal at the end, where the run has to go on; the last sample, where
    the run may end and did. What another master switches on after that counts from then.
    """
    began = strikes[0][1]
    left = next((row[0] for row in journal.states if row[0] >= began and row[2] in _ENDED), math.inf)
    struck = [strikes[0], *(strike for strike in strikes[1:] if strike[1] <= left)]
    ending = gravest(kind.ending for kind, _ in struck)
    must = [at_s for kind, at_s in struck if order("pauses") <= order(kind.ending) < order("lies")]
    if stage.asked_s < math.inf:
        must.append(stage.asked_s)
    if ending == "lies" and left < math.inf:
        must.append(left)  # The run has ended for another reason, and from then on the heater must obey.
    event_s = min(must) if must else max([began, *journal.wall_s[-1:]])
    return ending, max(event_s, stage.foreign_s)


def active_s(nobody: list[tuple[float, float]], since_s: float, until_s: float) -> float:
    """Return the time from `since_s` to `until_s` outside of the intervals `nobody`, in which nothing could act, s."""
    total, at_s = 0.0, since_s
    for begin, end in sorted(nobody):
        total += max(min(begin, until_s) - at_s, 0.0)
        at_s = max(at_s, end)
    return total + max(until_s - at_s, 0.0)


def _on_our_clock(journal: judge.JournalContent, stage: ChaosStage) -> judge.JournalContent:
    if stage.clock is None:
        return journal
    return replace(
        journal,
        wall_s=tuple(unstepped(wall_s, stage) for wall_s in journal.wall_s),
        states=tuple((unstepped(row[0], stage), *row[1:]) for row in journal.states),
        events=tuple((unstepped(row[0], stage), *row[1:]) for row in journal.events),
    )


def misplaced_rows(journal: Path, stage: ChaosStage, began_s: float) -> int:
    """Return the number of rows with a good value whose time is not the instant of their recording."""
    try:
        database = sqlite3.connect(f"file:{journal}?mode=ro", uri=True)
    except sqlite3.Error:
        return 0
    try:
        rows = database.execute("SELECT time_s, wall_s, quality FROM samples ORDER BY tick").fetchall()
    except sqlite3.Error:
        return 0
    finally:
        database.close()
    lead = [unstepped(wall_s, stage) - time_s for time_s, wall_s, _ in rows]
    usual = [lead[k] for k, row in enumerate(rows) if row[1] < began_s]
    if not usual:
        return 0
    base = statistics.median(usual)
    return sum(not all(row[2]) and abs(lead[k] - base) > TIME_TOLERANCE_S for k, row in enumerate(rows))


def read_manifest(stage: ChaosStage) -> dict[str, Any] | None:
    """Return the run's `run.json`; None if it is missing or damaged."""
    folder = stage.harness.folder()
    with contextlib.suppress(OSError, ValueError):
        document = json.loads(((folder or stage.place) / "run.json").read_text(encoding="utf-8"))
        return document if isinstance(document, dict) else None
    return None


def _unreadable(
    case: ChaosCase, stage: ChaosStage, ending: Ending, journal: judge.JournalContent, manifest: dict[str, Any] | None
) -> list[str]:
    """Return the defects of the run folder."""
    if not journal.sound and not stage.destroyed:
        return ["the journal is damaged"]
    if stage.destroyed or (case.early and not journal.ticks):
        return []
    folder = stage.harness.folder()
    if folder is None:
        return ["there is no run folder"]
    if manifest is None:
        return ["run.json cannot be read"]
    if any(kind.spoils for kind in case.kinds) or order(ending) >= order("frozen"):
        return []
    if manifest.get("exit_status") == "running":
        return ["run.json says that the run goes on"]
    missing = [name for name in ("record.parquet", "report.html") if not (folder / name).is_file()]
    if missing and "hil resume" not in stage.harness.said():
        return [f"{' and '.join(missing)} missing, and no word on how to make them"]
    return []


def _power(
    result: ChaosResult,
    case: ChaosCase,
    stage: ChaosStage,
    ending: Ending,
    truth: list[Moment],
    event_s: float,
    safe_s: float | None,
) -> list[str]:
    """Return the limits on the heater that were exceeded between the event and `safe_s`, when it was off for good."""
    if not result.heated:
        wrong = [] if case.early else ["nothing heated when the attack came"]
        result.struck = case.early
        return wrong + (["something heats after the attack"] if truth and truth[-1].heater_W > 0.0 else [])
    if ending == "lies":
        return _lied(result, case, stage, event_s, math.inf if safe_s is None else safe_s)
    limit_s = WATCHDOG_S + ROUGH_S if ending == "unguarded" else LIMIT_S
    if result.safe is None:
        return ["the heater was never cut"]
    return [f"safe {result.safe:.2f} s after the event, the limit is {limit_s:g} s"] if result.safe > limit_s else []


def _lied(result: ChaosResult, case: ChaosCase, stage: ChaosStage, event_s: float, off_s: float) -> list[str]:
    """Return the broken requirements on a device that disobeys: only the rig's watchdog can cut there."""
    assert stage.device is not None
    broken = []
    late = late_beats(stage.device.beats, stage.nobody, event_s, off_s)
    if late:
        broken.append(f"{len(late)} heartbeats later than {WITHHELD_AFTER_S:g} s although the heater had power")
    limit_s = DELAY_S + LIMIT_S if stage.device.mode == "delay" else math.inf
    if case.watchdog:
        limit_s = WITHHELD_AFTER_S + WATCHDOG_S + ROUGH_S
    if result.safe is None:
        if limit_s < math.inf:
            broken.append("the heater was never cut")
    elif result.safe > limit_s:
        broken.append(f"safe {result.safe:.2f} s after the event, the limit is {limit_s:g} s")
    return broken


def late_beats(beats: list[float], nobody: list[tuple[float, float]], event_s: float, off_s: float) -> list[float]:
    """Return the heartbeats before `off_s` that held the rig's watchdog off for longer than a meter may take."""
    return [at_s for at_s in beats if at_s < off_s and active_s(nobody, event_s, at_s) > WITHHELD_AFTER_S]


def _claims(
    result: ChaosResult,
    case: ChaosCase,
    stage: ChaosStage,
    ending: Ending,
    truth: list[Moment],
    manifest: dict[str, Any] | None,
) -> list[str]:
    """Return the false statements of the run about itself."""
    broken, code = [], stage.code
    result.claimed = None if manifest is None else manifest.get("safe")
    has_power = bool(truth) and truth[-1].heater_W > 0.0
    if result.claimed is True and has_power:
        broken.append("run.json says safe, and the heater has power")
    # A device that lies contradicts the read-back, whether or not it came to change the ending.
    told_lies = any(kind.ending == "lies" for kind in case.kinds)
    obeyed = ending in ("rides", "pauses", "stops") and not told_lies
    if result.claimed is False and not has_power and obeyed and not _harness_gone(case):
        broken.append("run.json says not safe, and nothing heats")
    if ending in ("frozen", "killed", "unguarded") or case.early:
        return broken
    if code == 0:
        broken.append("exit code 0 of a run that did not get to its end")
    elif code is not None and code < 0 and ending != "either" and not _harness_gone(case):
        broken.append(f"the process died of signal {-code}")
    wanted = case.kinds[0].status if len(case.kinds) == 1 else ""
    if wanted and result.status not in ("", wanted):
        broken.append(f"ended as {result.status}, not as {wanted}")
    return broken


def _harness_gone(case: ChaosCase) -> bool:
    """Return True if an attack, or the guardian in place of a stopped harness, may have killed it."""
    return any("harness" in kind.disables for kind in case.kinds)


def _records(result: ChaosResult, strikes: list[Strike], journal: judge.JournalContent, asked_s: float) -> list[str]:
    """Return the defects of samples, values and events."""
    broken = []
    if result.lost:
        broken.append(f"{result.lost} acknowledged samples lost")
    if result.wrong:
        broken.append(f"{len(result.wrong)} wrong values recorded as good: {result.wrong[0]}")
    if result.misplaced:
        broken.append(f"{result.misplaced} rows with values of another time than theirs")
    for kind, at_s in strikes:
        until_s = min(at_s + ALARM_S, asked_s)
        told = (row[2] for row in journal.events if at_s <= row[0] <= until_s and row[1] in ("WARN", "ERROR"))
        went_on = bool(journal.wall_s) and journal.wall_s[-1] > at_s + 1.0
        if kind.alarm and went_on and not any(word in text for text in told for word in kind.alarm):
            broken.append("another master wrote a set-point, and no alarm was recorded")
    return broken
