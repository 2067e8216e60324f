"""Present state and past of one run for any number of viewers: its journal is read once a second, in one thread.

Nothing here writes into the run's folder.
"""

from __future__ import annotations

import contextlib
import json
import math
import time
from pathlib import Path
from typing import Any

import numpy as np

from drivers.signals import Quality, Signal
from hil.alarms import AlarmError, AlarmWatch, alarm_document
from hil.journal import ACKNOWLEDGED, ENDED, JournalError, JournalReader, JournalSamples, State, StateRow, TwinOutput
from hil.panel.errors import PanelError
from hil.panel.trends import Trends, number
from hil.run_folder import RunFolder, RunFolderError, left_safe, read_diagnosis_verdict, read_notes, read_verdict

BLOCK_TICKS = 20_000
"""Ticks that are read at a time."""
MOST_EVENTS = 30
"""Events and notes that a page shows."""
MOST_LIMITS = 20
"""Limits of a test that did not pass, which a page shows; the report has all."""
RECENT_S = 600.0
"""Part of the run's end that a page may show in full, s."""
MOST_FRESH = 40
"""Predictions that a state has at most: some ten seconds of four twins."""
SLOW_S = 5.0
"""Time from one look at what changes rarely to the next: manifest, diagnosis, files, s."""


class RunFeed:
    """Feed of the run in `folder`; all calls come from one thread.

    Raises
    ------
    RunFolderError
        This is no run folder.
    JournalError
        The journal cannot be read.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = RunFolder(folder)
        self._manifest = self._folder.read_manifest()
        self._reader = JournalReader(self._folder.journal)
        header = self._reader.header
        self._signals = header.signals
        self._shown = [k for k, signal in enumerate(header.signals) if signal.kind != "status"]
        self._sensors = {name: list(columns) for name, columns in header.twin_sensors.items()}
        index = {signal.column: k for k, signal in enumerate(header.signals)}
        self._columns = {name: [index[column] for column in columns] for name, columns in self._sensors.items()}
        names = [header.signals[k].name for k in self._shown]
        names += [f"{sensor} measured" for sensor in self._sensors]
        names += [f"{sensor} {twin}" for twin in header.twin_names for sensor in self._sensors]
        self.trends = Trends(names, header.period_s)
        self._place = {name: k for k, name in enumerate(names)}
        self._tick, self._state_id, self._event_id = -1, 0, 0
        self._twin_ticks = dict.fromkeys(header.twin_names, -1)
        self._last: JournalSamples | None = None
        self._predicted: dict[str, list[float]] = {}
        self._fresh: list[dict[str, Any]] = []
        self._past: tuple[int, bytes] | None = None
        self._state: StateRow | None = None
        self._tripped_at, self._acknowledged = -1, (-1, "")
        self._events: list[dict[str, Any]] = []
        self._slow: dict[str, Any] = {}
        self._slow_at = -math.inf
        self._alarms: AlarmWatch | None = None
        self._no_alarms = ""
        try:
            self._alarms = AlarmWatch(folder)
        except AlarmError as error:
            self._no_alarms = str(error)
        except BaseException:
            self._reader.close()
            raise

    @property
    def state(self) -> str:
        """Return the state of the run at the last poll."""
        return "" if self._state is None else self._state.target

    def poll(self) -> bytes:
        """Read what is new, and return the present state of the run as JSON.

        Raises
        ------
        PanelError
            The run's folder or its journal is gone.
        JournalError
            The journal cannot be read any more.
        """
        if not self._folder.journal.is_file():
            raise PanelError(f"{self._folder.path} is gone; it was deleted or moved")
        self._read()
        return json.dumps(self._document(), allow_nan=False, separators=(",", ":")).encode("utf-8")

    def history(self) -> bytes:
        """Return the past as JSON: the course of all series, thinned; made once a tick, for all who ask."""
        if self._past is not None and self._past[0] == self._tick:
            return self._past[1]
        document = {
            "all": self.trends.document(),
            "recent": self._recent(),
            "sensors": list(self._sensors),
            "twins": list(self._reader.header.twin_names),
        }
        past = json.dumps(document, allow_nan=False, separators=(",", ":")).encode("utf-8")
        self._past = self._tick, past
        return past

    def act(self, name: Any, alarm: str, by: str, reason: str, for_s: float, count: int | None) -> str:
        """Do an act on an alarm; raises AlarmError. See `hil.alarms.AlarmWatch.act`."""
        if self._alarms is None:
            raise PanelError(self._no_alarms)
        return self._alarms.act(name, alarm, by, reason, for_s, count)

    def look_again(self) -> None:
        """Read what changes rarely at the next poll, too: an operator has acted."""
        self._slow_at = -math.inf

    def close(self) -> None:
        """Close the journal."""
        self._reader.close()
        if self._alarms is not None:
            self._alarms.close()

    def _recent(self) -> dict[str, Any]:
        """Return the course of the last `RECENT_S`, in bins of at least a second."""
        period_s = self._reader.header.period_s
        after = max(-1, self._tick - round(RECENT_S / period_s))
        start_s = (after + 1) * period_s
        recent = Trends(self.trends.names, max(1.0, period_s))
        self._add_samples(recent, self._reader.samples(after, BLOCK_TICKS), start_s)
        for twin in self._twin_ticks:
            self._add_twin(recent, self._reader.twin_outputs(twin, after, BLOCK_TICKS), start_s)
        document = recent.document()
        return document | {"time_s": [round(start_s + time_s, 3) for time_s in document["time_s"]]}

    def _add_samples(self, trends: Trends, samples: JournalSamples, start_s: float) -> None:
        good = np.where(samples.quality == Quality.GOOD, samples.values, np.nan)
        measured = [good[:, of].mean(axis=1) for of in self._columns.values()]  # NaN where one of them is
        block = np.column_stack([good[:, self._shown], *measured])
        trends.add(np.asarray(samples.time_s - start_s, dtype=np.float64), list(range(block.shape[1])), block)

    def _add_twin(self, trends: Trends, output: TwinOutput, start_s: float) -> None:
        columns = [self._place[f"{sensor} {output.twin}"] for sensor in self._sensors]
        time_s = output.tick * self._reader.header.period_s - start_s
        trends.add(np.asarray(time_s, dtype=np.float64), columns, output.values)

    def _read(self) -> None:
        while len((samples := self._reader.samples(self._tick, BLOCK_TICKS)).tick):
            self._add_samples(self.trends, samples, 0.0)
            self._tick, self._last = int(samples.tick[-1]), samples
        self._fresh = []
        for twin, after in self._twin_ticks.items():
            while len((output := self._reader.twin_outputs(twin, after, BLOCK_TICKS)).tick):
                self._add_twin(self.trends, output, 0.0)
                after = self._twin_ticks[twin] = int(output.tick.max())
                self._predicted[twin] = output.values[-1].tolist()
                self._fresh += self._points(output)
        self._fresh = self._fresh[-MOST_FRESH:]
        for row in self._reader.states(self._state_id):
            self._state_id, self._state = row.id, row
            if row.event == "trip" or row.target in (State.RUNNING, State.RESTORING):
                self._tripped_at = row.tick if row.event == "trip" else -1
        for event in self._reader.events(self._event_id):
            self._event_id = event.id
            if event.text.startswith(ACKNOWLEDGED):
                self._acknowledged = event.tick, event.text
            self._events.append({"time_s": event.time_s, "level": event.level, "text": event.text})
        self._events = self._events[-MOST_EVENTS:]

    def _document(self) -> dict[str, Any]:
        header, now = self._reader.header, time.monotonic()
        if now - self._slow_at >= SLOW_S:
            self._slow, self._slow_at = self._rarely(), now
        last, wall_s = self._reader.last()
        ended = self._reader.meta("exit_status") is not None or self.state in ENDED
        # The socket of a killed run stays; the lock on its folder does not.
        is_held = self._folder.is_held
        live = not ended and is_held is not False and self._folder.control.exists()
        age_s = time.time() - wall_s if live and math.isfinite(wall_s) else None
        time_s = max(last, 0) * header.period_s
        state = self._state
        profile_s = 0.0 if state is None else state.profile_s
        if state is not None and state.target == State.RUNNING:
            profile_s += time_s - state.time_s
        return {
            "run": self._folder.path.resolve().name,
            "live": live,
            "state": self.state or "beginning",
            "reason": self._reason(),
            "tripped": self._tripped_at > self._acknowledged[0],
            "profile": header.profile,
            "time_s": time_s,
            "profile_s": number(profile_s),
            "duration_s": header.duration_s,
            "period_s": header.period_s,
            "age_s": None if age_s is None else round(max(age_s, 0.0), 1),
            "values": self._values(age_s or 0.0),
            "twins": self._twins(),
            "predicted": self._fresh,
            "alarms": self._alarm_list(),
            "events": self._events,
            **self._slow,
            "status": self._status(is_held),
        }

    def _reason(self) -> str:
        """Return why the run is in its state; a trip that was acknowledged leaves it as it is."""
        tick, text = self._acknowledged
        if self._state is not None and self._state.event == "trip" and self._state.tick <= tick:
            return text
        return "" if self._state is None else self._state.reason

    def _status(self, is_held: bool | None) -> str:
        """Return the state as the manifest has it, `interrupted` for a run that nobody holds any more."""
        if is_held is False and self._manifest.get("exit_status") == "running":
            with contextlib.suppress(RunFolderError):  # a run that has ended says so before it lets go of its folder
                self._manifest = self._folder.read_manifest()
        status = str(self._manifest.get("exit_status", ""))
        return "interrupted" if status == "running" and is_held is False else status

    def _values(self, age_s: float) -> list[dict[str, Any]]:
        """Return value, quality and age of each signal that people read; a value that is not good is not shown."""
        samples = self._last
        if samples is None or not len(samples.tick):
            return []
        sources, values, quality = samples.source_time_s[-1], samples.values[-1], samples.quality[-1]
        set_at = [k for k, signal in enumerate(self._signals) if signal.kind == "setpoint"]
        now_s = float(sources[set_at[0]]) if set_at else float(np.nanmax(sources))
        found = []
        for k in self._shown:
            signal, is_good = self._signals[k], quality[k] == Quality.GOOD
            found.append(
                {
                    "name": signal.name,
                    "unit": _unit(signal),
                    "kind": signal.kind,
                    "readback": signal.readback,
                    "value": number(float(values[k])) if is_good else None,
                    "quality": _quality(int(quality[k])),
                    "age_s": number(max(0.0, now_s - float(sources[k])) + age_s),
                    "doc": signal.doc,
                }
            )
        return found

    def _twins(self) -> list[dict[str, Any]]:
        """Return measured and predicted values of each sensor, degC, and how old a prediction is, s."""
        if self._last is None or not len(self._last.tick):
            return []
        good = np.where(self._last.quality[-1] == Quality.GOOD, self._last.values[-1], np.nan)
        return [
            {
                "sensor": sensor,
                "measured": number(float(good[of].mean())),
                "predicted": {twin: number(values[k]) for twin, values in self._predicted.items()},
            }
            for k, (sensor, of) in enumerate(self._columns.items())
        ]

    def _points(self, output: TwinOutput) -> list[dict[str, Any]]:
        """Return the latest predictions of a block, one a second at most, for the trends of who looks on."""
        period_s = self._reader.header.period_s
        stride = max(1, round(1.0 / period_s))
        chosen = np.flatnonzero(output.tick % stride == 0)[-MOST_FRESH:]
        return [
            {
                "twin": output.twin,
                "time_s": round(float(output.tick[k]) * period_s, 3),
                "values": {s: number(value) for s, value in zip(self._sensors, output.values[k].tolist(), strict=True)},
            }
            for k in chosen
        ]

    def _alarm_list(self) -> dict[str, Any]:
        if self._alarms is None:
            return {"known": False, "text": self._no_alarms, "alarms": []}
        try:
            return {"known": True, "text": "", "alarms": alarm_document(self._alarms.poll())["alarms"]}
        except (AlarmError, JournalError, RunFolderError) as error:
            return {"known": False, "text": str(error), "alarms": []}

    def _rarely(self) -> dict[str, Any]:
        """Return what changes rarely: labels of the end, notes, diagnosis, files."""
        folder = self._folder
        try:
            self._manifest = folder.read_manifest()
            notes = [{"time": note.time, "by": note.by, "text": note.text} for note in read_notes(folder)][
                -MOST_EVENTS:
            ]
        except RunFolderError as error:
            notes = [{"time": "", "by": "", "text": str(error)}]
        diagnosis = read_diagnosis_verdict(folder)
        return {
            "safe": left_safe(self._manifest),
            "notes": notes,
            "tests": _tests(folder),
            "diagnosis": None if diagnosis is None else str(diagnosis),
            "files": {
                "report": folder.report.is_file(),
                "review": folder.review.is_file(),
                "diagnosis": (folder.diagnosis / "diagnosis.html").is_file(),
            },
        }


def _tests(folder: RunFolder) -> list[dict[str, Any]]:
    """Return verdict, title and counts of each test of a run, with a sentence on each limit that did not pass."""
    try:
        tests = read_verdict(folder)["tests"]
    except RunFolderError as error:
        return [{"verdict": "inconclusive", "title": folder.verdict.name, "text": str(error), "limits": []}]
    found = []
    for test in tests:
        limits = test["limits"]
        passed = sum(limit["verdict"] == "pass" for limit in limits)
        open_ones = [
            f"{limit['id']}: {limit['limit']}: {limit['text']}" for limit in limits if limit["verdict"] != "pass"
        ]
        found.append(
            {
                "verdict": test["verdict"],
                "title": test["title"],
                "text": f"{passed} of {len(limits)} limits passed",
                "limits": open_ones[:MOST_LIMITS],
            }
        )
    return found


def _unit(signal: Signal) -> str:
    return {"degC": "°C", "1": ""}.get(signal.unit, signal.unit)


def _quality(value: int) -> str:
    try:
        return Quality(value).name.lower().replace("_", " ")
    except ValueError:
        return "unknown"
