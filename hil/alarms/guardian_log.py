"""Log of the guardian of a run, `guardian.log`, followed as it grows: the guardian outlives an engine that was killed.

Its lines are JSON objects with time, `wall_s` and `what`; see `hil.guardian`. A line that a crash has cut is left out.
"""

from __future__ import annotations

import os
import stat
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from hil.alarms.alarm_list import LATEST_S, Change
from hil.alarms.definitions import GUARDIAN
from hil.files import parse_json, plain

NAME = "guardian.log"
LONGEST_S = 3700.0
"""Time after its begin at which an act of the guardian is over, s: it tries for an hour, and then logs that it ends."""
WAKES_WITHIN_S = 10.0
"""Time within which a guardian acts after its engine was killed, s: it looks ten times a second, on a laden machine."""
_BLOCK = 1 << 20
"""Bytes that are read at a time; a longer line is none of the guardian's."""
_LONGEST = 500


class GuardianLog:
    """Changes of the alarm on the guardian of the run in `folder`; `read` takes what is new.

    Parameters
    ----------
    folder
        Run folder.
    rig_time_s
        Function that returns the rig time, s, at a time of the wall clock, s since 1970.
    """

    def __init__(self, folder: Path, rig_time_s: Callable[[float], float]) -> None:
        self.changes: list[Change] = []
        self._path, self._rig_time_s = folder / NAME, rig_time_s
        self._place, self._rest = 0, b""
        self._reason, self._began_s = "", 0.0
        self._acts = self._watches = self._is_raised = False

    def read(self) -> None:
        """Read the lines that are new; a file that is none, or cannot be read, has none."""
        try:
            with open(os.open(self._path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "rb") as file:
                if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                    return
                file.seek(self._place)
                while data := file.read(_BLOCK):
                    self._place += len(data)
                    *lines, self._rest = (self._rest + data).split(b"\n")
                    self._rest = self._rest[: _BLOCK + 1]
                    for line in lines:
                        self._line(line)
        except OSError:
            return

    def is_at_work(self, cut_for_s: float | None) -> bool:
        """Return True while a guardian still acts, or will act soon: its run was cut `cut_for_s` s ago, or None.

        It ends after a while in any case: a guardian may have been killed, too.
        """
        if self._acts:
            return self._is_raised and time.time() < self._began_s + LONGEST_S
        return self._watches and cut_for_s is not None and cut_for_s < WAKES_WITHIN_S

    def _line(self, line: bytes) -> None:
        try:
            entry = parse_json(line) if len(line) <= _BLOCK else None
        except ValueError:
            return
        if not isinstance(entry, dict) or not 0.0 <= _number(entry.get("wall_s")) <= LATEST_S:
            return
        what, wall_s = entry.get("what"), _number(entry["wall_s"])
        problem = plain(str(entry.get("problem", "")), _LONGEST)
        after = f"after {max(0.0, _number(entry.get('after_s'))):.3g} s"
        if what == "watching":
            self._lower(wall_s, "a new guardian watches")
            self._watches, self._acts = True, False
        elif what == "acting":
            self._reason, self._began_s = plain(str(entry.get("reason", "")), _LONGEST), wall_s
            self._watches, self._acts = False, True
            self._raise(wall_s, "it begins to make the rig safe")
        elif what == "not safe" and self._acts:
            self._raise(wall_s, f"not safe: {problem}")
        elif what == "gave up" and self._acts:
            self._lower(wall_s, "")  # so that it asks once more whoever has acknowledged that it began
            self._raise(wall_s, f"it gave up {after}, not safe: {problem}")
            self._acts = False
        elif what == "safe" and self._acts:
            self._lower(wall_s, f"{self._reason}; safe {after}")
        elif what in ("done", "ended"):
            self._watches = self._acts = False

    def _raise(self, wall_s: float, said: str) -> None:
        """Raise the alarm, or give one that is raised another sentence."""
        text = f"{self._reason}; {said}"
        if self._is_raised:
            self.changes[-1] = replace(self.changes[-1], text=text)
        else:
            self._add(wall_s, True, text)

    def _lower(self, wall_s: float, text: str) -> None:
        if self._is_raised:
            self._add(wall_s, False, text)

    def _add(self, wall_s: float, active: bool, text: str) -> None:
        self._is_raised = active
        # It has no tick: the run need not go on meanwhile.
        self.changes.append(Change(-1, self._rig_time_s(wall_s), wall_s, GUARDIAN, active, text=text))


def _number(value: Any) -> float:
    """Return a number of a document, -1 for anything else."""
    try:
        return float(value) if isinstance(value, int | float) else -1.0
    except OverflowError:
        return -1.0
