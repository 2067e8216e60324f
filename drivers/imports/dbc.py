"""A DBC file: every signal of every message becomes a point on a CAN bus."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from drivers.dbc import describe_dbc
from drivers.imports.draft import Collector, Draft, DraftBus, ImportFileError
from drivers.points import ConfigurationError


def import_dbc(path: Path, out: Path, bus: dict[str, Any], *, encoding: str = "utf-8") -> Draft:
    """The draft of a DBC file for a rig file at `out`, which names it by its relative path; raises ImportFileError."""
    try:
        signals = describe_dbc(path, encoding)
    except ConfigurationError as error:
        raise ImportFileError(path, None, str(error).removeprefix(f"{path}: ")) from None
    relative = os.path.relpath(path, out.parent)
    keys = bus | {"dbc": Path(relative).as_posix()} | ({"dbc_encoding": encoding} if encoding != "utf-8" else {})
    collector = Collector(path)
    draft = Draft(path, [DraftBus("can", keys)], collector.notes)
    lines = _lines(path, encoding)
    for message, match in dict.fromkeys((s.message, s.match) for s in signals if s.match.pgn is not None):
        who = "" if match.mask & 0xFF else "; where several send it, give [[bus.can.message]] name, pgn and source"
        collector.notes.append(f"{message} is read by its {match}, at any priority{who}")
    for signal in signals:
        line = lines.get((signal.frame_id, signal.name), 1)
        if signal.multiplexed:
            collector.notes.append(
                f"{signal.message}.{signal.name} is multiplexed: it comes in some of the frames only"
            )
        point: dict[str, Any] = {"message": signal.message, "signal": signal.name, "unit": signal.unit}
        if signal.minimum is not None and signal.maximum is not None and signal.minimum < signal.maximum:
            point["plausible"] = [float(signal.minimum), float(signal.maximum)]
        if signal.choices:
            point["labels"] = {str(key): text for key, text in signal.choices.items()}
            point["kind"] = "status"
            point.pop("plausible", None)
        if signal.cycle_s:
            point["stale_after_s"] = round(max(3.0 * signal.cycle_s, 0.1), 3)
        if signal.comment:
            point["doc"] = signal.comment
        unit, _ = collector.unit(line, signal.unit) if signal.unit else ("1", "")
        if signal.unit and unit == "1":
            # the receiver compares units with the DBC's, and cannot compare what it does not know
            collector.notes.append(f"{signal.message}.{signal.name} is left out: correct its unit in the DBC")
            continue
        draft.buses[0].points.append(collector.point("can", signal.name, line, point))
    if not draft.buses[0].points:
        raise ImportFileError(path, None, "describes no signal that can be read; there is nothing to import")
    return draft


def _lines(path: Path, encoding: str) -> dict[tuple[int, str], int]:
    """Line of each signal's SG_, by the number of its message."""
    found: dict[tuple[int, str], int] = {}
    frame = 0
    for line, text in enumerate(path.read_text(encoding=encoding, errors="replace").splitlines(), 1):
        words = text.split()
        if len(words) > 1 and words[0] == "BO_" and words[1].isdigit():
            frame = int(words[1]) & 0x1FFFFFFF
        elif len(words) > 1 and words[0] == "SG_":
            found[(frame, words[1].rstrip(":"))] = line
    return found
