"""Alarms of a run in its folder, live or ended: the journal is followed by a process of its own, and acts are kept.

Nothing here is part of a tick: the conditions are judged on the rows that the journal has.
"""

from __future__ import annotations

import math
import shlex
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from drivers.signals import Quality
from hil.alarms.act_file import append_act, read_acts
from hil.alarms.alarm_list import LONGEST_SHELVING_S, Act, ActName, AlarmList, Change, fold, refusal, utc
from hil.alarms.definitions import GUARDIAN, META_KEY, RUN_INTERRUPTED, RUN_TRIP, TWIN, AlarmDefinition, from_document
from hil.alarms.detection import Delay, Detected, Detector, Ticks, detector_of
from hil.alarms.errors import AlarmError
from hil.alarms.guardian_log import GuardianLog
from hil.alarms.states import SHELVED
from hil.files import is_blank, plain
from hil.journal import JournalReader, JournalSamples, StateRow
from hil.run_folder import RunFolder

BLOCK_TICKS = 20_000
"""Ticks that are read at a time: some 10 MB of a rig of 24 points."""
RESIDUAL_S = 10.0
"""Time over which a residual is averaged, s: as long as the off-delay that an interlock has by default."""
CUT_CHECK_S = 5.0
"""Time without a new tick after which a run is asked whether it was interrupted, s."""


class _Residual:
    """Alarm on measured minus predicted, by means over `RESIDUAL_S` of ticks that have both."""

    def __init__(self, item: AlarmDefinition, reader: JournalReader) -> None:
        header = reader.header
        assert item.limit is not None
        self.item, self._delay = item, Delay(item)
        self._sensor = list(header.twin_sensors).index(item.sensor)
        names = {signal.column: k for k, signal in enumerate(header.signals)}
        self._columns = [names[column] for column in header.twin_sensors[item.sensor]]
        self._bin = max(1, math.ceil(RESIDUAL_S / header.period_s))
        self._at = -1

    def changes(self, reader: JournalReader) -> list[tuple[int, float, bool, float]]:
        """Return tick, time, came or went, and residual in K, of the changes that the journal has now."""
        last = min(reader.last_twin_tick(self.item.twin), reader.last()[0])
        end = (last + 1) // self._bin * self._bin - 1  # whole bins alone, however the run is read
        found: list[tuple[int, float, bool, float]] = []
        while self._at < end:
            limit = min(BLOCK_TICKS // self._bin * self._bin or self._bin, end - self._at)
            samples, output = self._pair(reader, limit, self._at + limit)
            self._at += limit
            if len(samples.tick) == 0 or len(output) == 0:
                continue
            bins = samples.tick // self._bin
            edges = np.flatnonzero(np.diff(bins, prepend=bins[0] - 1))
            known = np.isfinite(output)
            total = np.add.reduceat(np.where(known, output, 0.0), edges)
            count = np.add.reduceat(known.astype(np.float64), edges)
            mean = np.divide(total, count, out=np.full(len(total), np.nan), where=count > 0)
            ends = np.concatenate([edges[1:], [len(bins)]]) - 1
            off, limit_K = np.abs(mean), self.item.limit or 0.0
            seen = Detected(off > limit_K, off > limit_K - self.item.deadband, mean)
            for k, active in self._delay.block(samples.time_s[ends], seen):
                found.append((int(samples.tick[ends[k]]), float(samples.time_s[ends[k]]), active, float(mean[k])))
        return found

    def _pair(self, reader: JournalReader, limit: int, stop: int) -> tuple[JournalSamples, np.ndarray[Any, Any]]:
        """Return the samples up to tick `stop`, and their residual (n,) in K, NaN where one of both is not known."""
        samples = reader.samples(self._at, limit)
        inside = samples.tick <= stop
        samples = JournalSamples(*(getattr(samples, name)[inside] for name in JournalSamples.__slots__))
        output = reader.twin_outputs(self.item.twin, self._at, limit)
        block, bad = samples.values[:, self._columns], samples.quality[:, self._columns] != Quality.GOOD
        measured = np.where(bad.any(axis=1), np.nan, block.mean(axis=1))
        predicted = np.full(len(samples.tick), np.nan)
        place = np.searchsorted(samples.tick, output.tick)
        there = (place < len(samples.tick)) & np.isin(output.tick, samples.tick)
        predicted[place[there]] = output.values[there, self._sensor]
        return samples, measured - predicted


class AlarmWatch:
    """Alarms of the run in `folder`. `poll` reads what is new; see `hil.alarms.alarm_list` for the result.

    Raises
    ------
    RunFolderError
        `folder` is no run folder.
    JournalError
        The journal cannot be read.
    AlarmError
        The journal holds no definitions of alarms.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = RunFolder(folder)
        self._uid = self.folder.read_manifest().get("uid")
        self._reader = JournalReader(self.folder.journal)
        try:
            self.definitions = from_document(self._reader.meta(META_KEY), str(self.folder.journal))
        except AlarmError:
            self._reader.close()
            raise
        header = self._reader.header
        self._detectors: list[tuple[AlarmDefinition, Detector, Delay]] = [
            (item, detector, Delay(item))
            for item in self.definitions
            if (detector := detector_of(item, header.signals, header.period_s)) is not None
        ]
        self._residuals = [
            _Residual(item, self._reader)
            for item in self.definitions
            if item.kind == "residual" and item.twin in header.twin_names and item.sensor in header.twin_sensors
        ]
        self._changes: list[Change] = []
        self._tick, self._state, self._calibration = -1, 0, 0
        self._tripped = self._interrupted = False
        self._disturbed: set[str] = set()
        self._cut_checked = -math.inf
        self._cut: Change | None = None
        self._manifest: dict[str, Any] = {}
        self._guardian = GuardianLog(folder, self._rig_time_s)
        self._cut_seen = math.inf
        self._folded: list[Change] = []
        self._kept: AlarmList | None = None
        self._key: object = None

    @property
    def tick(self) -> int:
        """Return the last tick that was read, -1 before the first."""
        return self._tick

    def poll(self, now_s: float | None = None) -> AlarmList:
        """Read what the journal has got since, and return the alarm list at `now_s`, s since 1970, or now.

        It is the same object as before where nothing has changed.

        Raises
        ------
        JournalError
            The journal cannot be read any more.
        AlarmError
            The file of the acts is damaged.
        """
        self._read_ticks()
        self._read_states()
        self._read_windows()
        for residual in self._residuals:
            for tick, time_s, active, value in residual.changes(self._reader):
                self._add(tick, time_s, residual.item.id, active, value)
        changes, acts = [*self._changes, *self._end_of_run()], read_acts(self.folder)
        key = len(self._changes), tuple(changes[len(self._changes) :]), len(acts)
        if self._kept is None or key != self._key or any(a.state in SHELVED for a in self._kept.statuses.values()):
            self._kept = fold(self.definitions, changes, acts, time.time() if now_s is None else now_s)
            self._key, self._folded = key, changes
        return self._kept

    def has_ended(self) -> bool:
        """Return True if the run has ended or was interrupted. Call it before `poll`, which then reads the rest.

        A run has ended when its manifest says so, and its guardian no longer acts.
        """
        if self._cut is None and self._reader.meta("exit_status") is None:
            return False
        self._cut_checked = -math.inf
        was_cut = self.folder.was_cut
        if not was_cut and self.folder.read_manifest().get("exit_status") == "running":
            return False
        now = time.monotonic()
        self._cut_seen = min(self._cut_seen, now) if was_cut else math.inf
        self._guardian.read()
        return not self._guardian.is_at_work(now - self._cut_seen if was_cut else None)

    def act(
        self,
        name: ActName,
        alarm: str,
        by: str,
        reason: str = "",
        for_s: float = math.nan,
        count: int | None = None,
    ) -> str:
        """Do an act on an alarm, and return what it did as a sentence.

        Parameters
        ----------
        name
            `acknowledge`, `shelve` or `unshelve`.
        alarm
            Id of the alarm; `all` for every one that admits the act, other than shelving.
        by
            Operator.
        reason
            Needed for a shelving.
        for_s
            Duration of a shelving, s.
        count
            How often the alarm had come when the operator looked; None for an operator who sees the list as it is now.

        Raises
        ------
        AlarmError
            There is no such alarm, its state does not admit the act, it came again since the operator looked, or a
            shelving has no reason or no end.
        """
        now_s = time.time()
        if name == "shelve":
            _require_end_and_reason(for_s, reason)
        kept = self.poll(now_s)
        if alarm == "all" and name != "shelve":
            chosen = [item for item in kept.standing() if refusal(item, name) is None]
            if not chosen:
                listed = f"`hil alarms {shlex.quote(str(self.folder.path))}` lists them"
                raise AlarmError(f"no alarm of {self.folder.path} admits it; {listed}")
        else:
            chosen = [kept.statuses[self._known(alarm)]]
        for status in chosen:
            if count is not None and status.count != count:
                since = utc(status.wall_s)
                raise AlarmError(f"{status.definition.id} came again since you looked, at {since}; look at it first")
            if (why := refusal(status, name)) is not None:
                raise AlarmError(why)
        lines = []
        for status in chosen:
            known = [change.tick for change in self._folded if change.id == status.definition.id]
            tick = max([self._tick, *known])
            act = Act(name, status.definition.id, tick, now_s, by, reason, now_s + for_s, len(known))
            append_act(self.folder, act)
            done = {
                "acknowledge": f"acknowledged; it came at {utc(status.wall_s)}",
                "unshelve": "taken back into the list",
            }
            lines.append(f"{status.definition.id}: {done.get(name) or f'shelved until {utc(now_s + for_s)}'}")
        return "\n".join(lines)

    def close(self) -> None:
        """Close the journal."""
        self._reader.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _known(self, alarm: str) -> str:
        import difflib

        names = [item.id for item in self.definitions]
        if alarm in names:
            return alarm
        near = difflib.get_close_matches(alarm, names, n=1, cutoff=0.5)
        hint = f"did you mean {near[0]}?" if near else "`hil alarms RUN --all` lists them"
        raise AlarmError(f"{self.folder.path} has no alarm {alarm[:80]!r}; {hint}")

    def _read_ticks(self) -> None:
        while True:
            samples = self._reader.samples(self._tick, BLOCK_TICKS)
            if not len(samples.tick):
                return
            ticks = Ticks(samples.time_s, samples.values, samples.quality)
            for item, detector, delay in self._detectors:
                found = detector.block(ticks)
                for k, active in delay.block(samples.time_s, found):
                    self._add(int(samples.tick[k]), float(samples.time_s[k]), item.id, active, float(found.value[k]))
            self._tick = int(samples.tick[-1])
            if math.isfinite(self._cut_checked):
                self._cut_checked = time.monotonic()  # it grows, so it was not interrupted

    def _read_states(self) -> None:
        for row in self._reader.states(self._state):
            self._state = row.id
            if row.event == "cut":
                self._run(row, RUN_INTERRUPTED, True, row.reason)
            elif row.event in ("trip", "fail", "fault"):
                if self._tripped:
                    self._run(row, RUN_TRIP, False, "")
                self._tripped = self._run(row, RUN_TRIP, True, row.reason)
            elif row.target in ("running", "restoring"):
                self._run(row, RUN_INTERRUPTED, False, "")
                self._tripped = self._run(row, RUN_TRIP, False, "")

    def _run(self, row: StateRow, alarm: str, active: bool, text: str) -> bool:
        wall_s = row.wall_s
        if row.event == "cut":  # the resumption writes it, later by the length of the interruption
            before = self._reader.wall_s_at(row.tick)
            wall_s = before if math.isfinite(before) else wall_s
        self._changes.append(Change(row.tick, row.time_s, wall_s, alarm, active, text=text))
        return active

    def _read_windows(self) -> None:
        for row in self._reader.calibrations(self._calibration):
            self._calibration, key = row.id, row.calibrator
            try:
                found = _disturbance(row.document) if row.document.get("disturbed") is not None else None
            except (ValueError, TypeError, LookupError, ArithmeticError):
                raise AlarmError(f"{self.folder.journal} holds a damaged window of {plain(key, 60)}") from None
            tick = round(row.end_s / self._reader.header.period_s)
            if found is not None and key not in self._disturbed:
                if not self._disturbed:
                    power = row.document.get("disturbed_W")
                    value = float(power) if isinstance(power, int | float) else math.nan
                    self._add(tick, row.end_s, TWIN, True, value, f"{key}: {found}")
                self._disturbed.add(key)
            elif found is None and key in self._disturbed:
                self._disturbed.discard(key)
                if not self._disturbed:
                    self._add(tick, row.end_s, TWIN, False)

    def _add(self, tick: int, time_s: float, alarm: str, active: bool, value: float = math.nan, text: str = "") -> None:
        wall_s = self._reader.wall_s_at(tick)
        self._changes.append(Change(tick, time_s, wall_s, alarm, active, value, text))

    def _rig_time_s(self, wall_s: float) -> float:
        """Return the rig time of the last row up to a time of the wall clock, s since 1970."""
        return self._reader.tick_at(wall_s) * self._reader.header.period_s

    def _end_of_run(self) -> list[Change]:
        """Return the changes that the folder shows: an interruption, and what the guardian did."""
        now = time.monotonic()
        if now - self._cut_checked >= CUT_CHECK_S:
            self._cut_checked = now
            last, wall_s = self._reader.last()
            time_s = max(last, 0) * self._reader.header.period_s
            at_s = wall_s if math.isfinite(wall_s) else time.time()
            self._cut = (
                Change(last, time_s, at_s, RUN_INTERRUPTED, True, text="the run was killed, or the power failed")
                if self._reader.meta("exit_status") is None and self.folder.was_cut
                else None
            )
            self._manifest = self.folder.read_manifest()
        found = [] if self._cut is None else [self._cut]
        self._guardian.read()
        found += self._guardian.changes
        said = str(self._manifest.get("guardian") or "")
        if said and not self._guardian.changes:
            last, wall_s = self._reader.last()
            period_s = self._reader.header.period_s
            found.append(Change(max(last, 0), max(last, 0) * period_s, wall_s, GUARDIAN, True, text=said))
        return found


def _disturbance(document: dict[str, Any]) -> str | None:
    from hil.tracking import disturbance  # it needs the twins, which few runs have to be asked for

    return disturbance(document)


def _require_end_and_reason(for_s: float, reason: str) -> None:
    if not (math.isfinite(for_s) and for_s > 0):
        raise AlarmError("a shelving needs an end, or nobody sees the alarm again; add --for, as --for 30min")
    if for_s > LONGEST_SHELVING_S:
        raise AlarmError(f"an alarm is shelved for at most {LONGEST_SHELVING_S / 86400:g} days; shelve it again then")
    if is_blank(reason):
        raise AlarmError("a shelving needs a reason, which the next shift reads; add --reason")
