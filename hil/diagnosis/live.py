"""Diagnosis of the record so far while a run goes on, in a process of its own with the lowest priority.

The process reads the journal itself. The engine only reports how far the run has come, and never waits. One diagnosis
runs at a time, on the newest data. Its finding becomes an event if it differs from the last one reported.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import re
import shlex
import shutil
import signal
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from drivers.signals import ConfigurationError, Quality
from hil.journal import JournalError, JournalReader, JournalSamples, JournalWriter, samples_sha256
from hil.record import Parts, RecordError
from hil.tracking import Child

if TYPE_CHECKING:
    from twin.discovery import Columns, Diagnosis

SURE = 0.8
"""Least confidence of every effect for an adoption; 0.9 is the highest, since one fault in ten is of no listed law."""
WORSE = 1.02
"""Largest ratio of a sensor's held-out error with the effects to that of the re-tuned twin: room for noise alone."""
LEAST_INTERVAL_S = 60.0
"""Least interval of diagnoses while a run goes on, s."""
END_ONLY = "end"
"""Value in place of an interval: diagnose only the whole run, at its end."""
FINISH_TIMEOUT_S = 900.0
_LOWEST_PRIORITY = 19
"""Longest wait for the last diagnosis, s, and niceness of its process."""
_RESIZED = 0.2
_SHIFTED_S = 1800.0
"""Relative change of a size, and change of an onset, s, from which a finding is reported anew."""


@dataclass(frozen=True, slots=True)
class LiveConfig:
    """Settings of a live diagnosis: twin file, journal, healthy record, interval in s of profile time."""

    twin: Path
    journal: Path
    healthy: Path | None
    every_s: float
    adopt: bool = False


@dataclass(frozen=True, slots=True)
class ReportedEffect:
    """Size and onset of an effect, for the comparison with a later diagnosis; `value` with its 90 % interval in its
    unit.
    """

    kind: str
    where: str
    value: float
    low: float
    high: float
    onset_s: float


@dataclass(frozen=True, slots=True)
class InterimFinding:
    """Finding of one diagnosis of the record up to `until_s`; `sentence` is the verdict in words."""

    verdict: str
    sentence: str
    effects: tuple[ReportedEffect, ...]
    until_s: float


@dataclass(frozen=True, slots=True)
class Reply:
    """Answer of the process: the finding, or the reason for none, and the result of an adoption.

    `adopted` is the file of a revision that this diagnosis saved, `revision` that of the last one that any did.
    `document` is that of the diagnosis of the whole run.
    """

    found: InterimFinding | None = None
    problem: str = ""
    adopted: Path | None = None
    refusal: str = ""
    page: Path | None = None
    revision: Path | None = None
    document: dict[str, Any] | None = None


def interval_of(text: str) -> float:
    """Return the interval in s of `hourly`, `30min`, `2h`, infinity for `end`; raise ConfigurationError."""
    if text == END_ONLY:
        return math.inf
    if text == "hourly":
        return 3600.0
    match = re.fullmatch(r"(\d+(?:\.\d+)?) ?(min|h)", text)
    seconds = 0.0 if match is None else float(match[1]) * {"min": 60.0, "h": 3600.0}[match[2]]
    if seconds < LEAST_INTERVAL_S:
        raise ConfigurationError(
            f"--diagnose {text!r} is no interval; write hourly, 30min or 2h (at least 1min), or end"
        )
    return seconds


def interim_finding(diagnosis: Diagnosis, until_s: float) -> InterimFinding:
    """Return the part of a diagnosis that is reported while the run goes on."""
    effects = tuple(
        ReportedEffect(e.kind, e.where, e.value, e.interval90[0], e.interval90[1], e.onset_s) for e in diagnosis.effects
    )
    text = ". ".join(e.says for e in diagnosis.effects if e.says)
    if diagnosis.verdict == "ambiguous":
        named = {(e.kind, e.where) for e in diagnosis.effects}
        left = dict.fromkeys((a.kind, a.where) for a in diagnosis.indistinguishable if (a.kind, a.where) not in named)
        others = ", ".join(f"{kind.replace('_', ' ')} at {where}" for kind, where in left)
        text = f"{text}; in the record so far that is not distinguishable from {others}" if others else text
    if diagnosis.verdict in ("adequate", "unexplained") or not text:
        text = diagnosis.summary.rstrip(".")
    return InterimFinding(diagnosis.verdict, text, effects, until_s)


def changed(before: InterimFinding | None, now: InterimFinding) -> bool:
    """Return True if verdict or place differ, or a size or an onset by more than its uncertainty."""
    if before is None:
        return now.verdict != "adequate"
    if before.verdict != now.verdict or len(before.effects) != len(now.effects):
        return True
    for a, b in zip(_ordered(before), _ordered(now), strict=True):
        if (a.kind, a.where) != (b.kind, b.where):
            return True
        spread = max(a.high - a.low, b.high - b.low)
        if abs(b.value - a.value) > max(spread, _RESIZED * abs(a.value)) or abs(b.onset_s - a.onset_s) > _SHIFTED_S:
            return True
    return False


def _ordered(found: InterimFinding) -> list[ReportedEffect]:
    return sorted(found.effects, key=lambda e: (e.kind, e.where))


def refusal(diagnosis: Diagnosis) -> str | None:
    """Return the reason against adopting a diagnosis, or None."""
    if diagnosis.verdict != "effect found":
        return f"the verdict is {diagnosis.verdict}"
    if diagnosis.network is None:
        return "there is nothing to add to the twin"
    least = min(e.confidence for e in diagnosis.effects)
    if least < SURE:
        return f"the confidence is {least:.2f}, less than {SURE:g}"
    errors = diagnosis.errors
    worse = [name for name, e in errors.items() if not e.after <= WORSE * e.before]
    if worse:
        return f"on held-out data {', '.join(worse)} is worse with the effect than re-tuned"
    if not sum((e.after / e.noise) ** 2 for e in errors.values()) < sum(
        (e.before / e.noise) ** 2 for e in errors.values()
    ):
        return "on held-out data the effect is no better than re-tuning"
    return None


class _DiagnosisWorker:
    """Work of the other process: read new rows of the journal and diagnose all of them."""

    def __init__(self, config: LiveConfig) -> None:
        from hil.diagnosis.columns import read_healthy
        from hil.diagnosis.experiment_file import limits_of, rig_of
        from twin import load

        self._config = config
        self._network = load(config.twin)
        self._healthy = read_healthy(self._network, config.twin, config.healthy, None) if config.healthy else None
        rig = rig_of(config.journal.parent)
        self._limits = limits_of(rig) if rig is not None else None
        self._blocks: list[JournalSamples] = []
        self._samples_sha256: str | None = None
        self._adopted: InterimFinding | None = None
        self._revision: Path | None = None

    def look(self, out: Path | None) -> Reply:
        """Diagnose the journal as it is; `out` is the folder for the results of the last diagnosis."""
        from twin import TwinFileError
        from twin.discovery import diagnose

        try:
            record = self._read()
            if record is None:
                return Reply(problem="there are no samples yet")
            diagnosis = diagnose(self._network, record, self._healthy, limits=self._limits)
        except (TwinFileError, RecordError) as error:
            return Reply(problem=str(error))
        found = interim_finding(diagnosis, float(record.time_s[-1]))
        adopted, why = self._adopt(diagnosis, found) if self._config.adopt else (None, "")
        page = None if out is None else self._write(diagnosis, out)
        document = None if out is None else diagnosis.document()
        return Reply(found, adopted=adopted, refusal=why, page=page, revision=self._revision, document=document)

    def _read(self) -> Columns | None:
        from hil.diagnosis.columns import columns_of
        from hil.record import Record

        reader = JournalReader(self._config.journal)
        try:
            new = reader.samples(int(self._blocks[-1].tick[-1]) if self._blocks else -1)
            names = [signal.column for signal in reader.header.signals]
            begins = [row.tick for row in reader.segments()]
        finally:
            reader.close()
        if len(new.tick):
            self._blocks.append(new)
        if not self._blocks:
            return None
        time_s = np.concatenate([b.time_s for b in self._blocks])
        ticks = np.concatenate([b.tick for b in self._blocks])
        parts = Parts.of(time_s, np.searchsorted(begins, ticks, side="right"))
        good = np.concatenate([np.where(b.quality == Quality.GOOD, b.values, np.nan) for b in self._blocks])
        self._samples_sha256 = samples_sha256(time_s, dict(zip(names, good.T, strict=True)))
        values = np.where(parts.aside[:, None], np.nan, good[parts.rows])
        return columns_of(self._network, Record(time_s[parts.rows], dict(zip(names, values.T, strict=True))), None)

    def _adopt(self, diagnosis: Diagnosis, found: InterimFinding) -> tuple[Path | None, str]:
        """Return the file of a new revision, or the reason for none."""
        from hil.diagnosis.revision import revise

        why = refusal(diagnosis)
        if why is not None:
            return None, why if found.verdict != "adequate" else ""
        if not changed(self._adopted, found):
            return None, ""
        self._revision = revise(diagnosis, self._network, self._config.twin, self._config.journal)
        self._adopted = found
        return self._revision, ""

    def _write(self, diagnosis: Diagnosis, out: Path) -> Path:
        from hil.diagnosis.experiment_file import rig_of, write_experiment
        from hil.diagnosis.healthy_record import is_other_record
        from hil.diagnosis.results import provenance, whole_results, write

        run = self._config.journal.parent
        extra: dict[str, object] = {
            "record": str(run / "record.parquet"),
            "twin": str(self._config.twin),
            "revision": str(self._revision) if self._revision else None,
            "healthy": str(self._config.healthy) if self._config.healthy else None,
            "provenance": provenance(
                {"twin": self._config.twin, "healthy record": self._config.healthy},
                self._samples_sha256,
                ["--healthy"] if is_other_record(self._config.twin, self._config.healthy) else [],
            ),
        }
        with whole_results(out, extra) as staged:
            page = write(diagnosis, self._network.sensor_names, staged, extra)
            write_experiment(diagnosis, staged, rig_of(run))
        return out / page.name


def _serve(connection: Connection, config: LiveConfig) -> None:
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGQUIT):
        signal.signal(number, signal.SIG_IGN)  # These signals belong to the engine, which ends this process in order.
    with contextlib.suppress(OSError):
        os.nice(_LOWEST_PRIORITY)
    try:
        worker = _DiagnosisWorker(config)
        connection.send(Reply())
        while (asked := connection.recv()) is not None:
            connection.send(worker.look(asked or None))
    except (EOFError, BrokenPipeError):
        return
    except Exception as error:
        with contextlib.suppress(OSError):
            connection.send(error)


class LiveDiagnosis:
    """Publisher of the engine that starts diagnoses of the record so far and journals new findings. It never waits."""

    def __init__(self, config: LiveConfig, journal: JournalWriter, say: Callable[[str], None]) -> None:
        self._config = config
        self._journal = journal
        self._say = say
        self._child: Child | None = None
        self._free = False
        self._due_s = config.every_s
        self._tick, self._time_s = -1, 0.0
        self._last: InterimFinding | None = None
        self._refused = ""
        self._over = False
        self._answer = asyncio.Event()
        self._reply: Reply | None = None
        self._failure: str | None = None

    def start(self) -> None:
        """Start the process; it reports by itself when it is ready."""
        self._child = Child(_serve, self._config, "diagnosis")
        self._child.listen(self._receive)
        if self._config.healthy is None:
            self._event("WARN", "diagnosis: no healthy record, so small effects are not detected")

    def _event(self, level: str, text: str) -> None:
        self._journal.event(self._tick, self._time_s, level, text)
        self._say(text)

    async def publish(self, ticks: list[int], time_s: list[float], rows: list[list[float]]) -> None:
        """Take note of the run's progress, and start a diagnosis if one is due and the process is free."""
        self._tick, self._time_s = ticks[-1], time_s[-1]
        if self._free and self._time_s >= self._due_s:
            self._due_s = (self._time_s // self._config.every_s + 1) * self._config.every_s
            self._ask("")

    def _ask(self, what: Path | str) -> None:
        assert self._child is not None
        self._free = False
        try:
            self._child.connection.send(what)
        except OSError as error:
            self._fail(str(error))

    async def finish(self, out: Path) -> Reply:
        """Diagnose the whole run into the folder `out`, and wait for it, since the run is over."""
        self._over = True
        self._journal.commit()
        try:
            async with asyncio.timeout(FINISH_TIMEOUT_S):
                await self._until_free()
                if self._failure is None:
                    self._ask(out)
                    await self._until_free()
        except TimeoutError:
            self._fail(f"no result within {FINISH_TIMEOUT_S:g} s")
        return self._reply if self._failure is None and self._reply else Reply(problem=self._failure or "no result")

    def give_up(self) -> None:
        """End `finish` without the diagnosis of the whole run."""
        self._failure = "skipped by the operator"
        self._answer.set()

    async def _until_free(self) -> None:
        while not self._free and self._failure is None:
            self._answer.clear()
            await self._answer.wait()

    def _receive(self) -> None:
        from twin import TwinFileError

        assert self._child is not None
        try:
            message = self._child.connection.recv()
        except (EOFError, OSError):
            self._fail("the process ended")
            return
        if isinstance(message, Reply):
            self._free = True
            self._reply = message
            self._tell(message)
        else:
            # A sentence for the user; any other error is a defect, of which the kind tells more.
            told = isinstance(message, ConfigurationError | JournalError | RecordError | TwinFileError)
            self._fail(str(message) if told else f"{type(message).__name__}: {message}")
        self._answer.set()

    def _tell(self, reply: Reply) -> None:
        now = reply.found
        if now is None:
            return
        if changed(self._last, now):
            level, ahead = ("INFO", "") if now.verdict == "adequate" else ("WARN", f", {now.verdict}")
            self._event(level, f"diagnosis of the first {now.until_s / 3600.0:.1f} h{ahead}: {now.sentence}")
        self._last = now
        if reply.adopted is not None:
            where = shlex.quote(str(reply.adopted))
            self._event("INFO", f"diagnosis: the static twin of this run is unchanged; adopted as {where}")
        elif reply.refusal and reply.refusal != self._refused:
            self._event("INFO", f"diagnosis: not adopted, {reply.refusal}")
        self._refused = reply.refusal

    def _fail(self, why: str) -> None:
        if self._failure is None:
            self._failure = why
            what = (
                "the last diagnosis failed" if self._over else "the live diagnosis stopped, the run goes on without it"
            )
            self._event("ERROR", f"{what}: {why}")
        self._free = False
        if self._child is not None:
            self._child.ignore()
        self._answer.set()

    async def close(self) -> None:
        """End the process in any state; harmless when repeated."""
        child, self._child = self._child, None
        if child is not None:
            from hil.diagnosis.store import STAGED

            await child.end()
            for left in self._config.journal.parent.glob(f"{STAGED}*"):
                shutil.rmtree(left, ignore_errors=True)
