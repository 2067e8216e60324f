"""Acts of operators on alarms: lines of JSON in `alarms.jsonl` beside the journal, which are only ever appended.

A run that goes on is not disturbed, and what an operator has done outlives a crash and a resumption.
"""

from __future__ import annotations

import math
from typing import Literal

from pydantic import Field

from hil.alarms.alarm_list import LATEST_S, LONGEST_SHELVING_S, Act
from hil.alarms.errors import AlarmError
from hil.files import plain
from hil.run_folder import DocumentShape, RunFolder, append_json_line, read_json_lines

LONGEST_REASON = 500
"""Most characters of a reason, and of the name of an operator."""


class _Line(DocumentShape):
    act: Literal["acknowledge", "shelve", "unshelve"]
    id: str
    tick: int
    wall_s: float = Field(ge=0, le=LATEST_S)
    by: str = ""
    reason: str = ""
    until_s: float | None = Field(default=None, ge=0, le=LATEST_S)
    seen: int = Field(default=-1, ge=-1)


def append_act(folder: RunFolder, act: Act) -> None:
    """Append an act, and have it on the disk before this returns.

    Raises
    ------
    AlarmError
        The file cannot be written.
    """
    line = {"act": act.name, "id": act.id, "tick": act.tick, "wall_s": act.wall_s, "by": plain(act.by, LONGEST_REASON)}
    line |= {
        "reason": plain(act.reason, LONGEST_REASON),
        "until_s": act.until_s if math.isfinite(act.until_s) else None,
        "seen": act.seen,
    }
    append_json_line(folder.alarms, line, AlarmError)


def read_acts(folder: RunFolder) -> list[Act]:
    """Return the acts on the alarms of a run in order; a last line that a crash cut is left out.

    Raises
    ------
    AlarmError
        A line is damaged; the message names it.
    """
    found = []
    for place, read in read_json_lines(folder.alarms, _Line, "no act on an alarm", AlarmError):
        until_s = math.nan if read.until_s is None else read.until_s
        if read.act == "shelve" and read.until_s is None:
            raise AlarmError(f"{place} shelves an alarm without an end; take the line out")
        if until_s - read.wall_s > LONGEST_SHELVING_S + 1e-3:  # both are rounded
            days = LONGEST_SHELVING_S / 86400
            raise AlarmError(f"{place} shelves an alarm for more than {days:g} days; take the line out")
        found.append(Act(read.act, read.id, read.tick, read.wall_s, read.by, read.reason, until_s, read.seen))
    return found
