"""Importer of DBC files: every signal of every message becomes a point on a CAN bus."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

from drivers.can import DbcContents, DbcSignal, read_dbc
from drivers.importers.dbc_values import value_table
from drivers.importers.draft import Collector, Draft, DraftBus, ImportFileError
from drivers.signals import ConfigurationError


def import_dbc(path: Path, out: Path, bus: dict[str, Any], *, encoding: str | None = None) -> Draft:
    """Return the draft of a DBC file for a rig file at `out`, which names it by its relative path.

    Without `encoding` UTF-8 and cp1252 are tried. Raises ImportFileError.
    """
    try:
        contents = read_dbc(path, encoding)
    except ConfigurationError as error:
        found = re.fullmatch(r"(?:, line (\d+))?: (.*)", str(error).removeprefix(str(path)), re.DOTALL)
        line = None if found is None or found[1] is None else int(found[1])
        raise ImportFileError(path, line, str(error) if found is None else found[2]) from None
    relative = os.path.relpath(path, out.parent)
    keys = bus | {"dbc": Path(relative).as_posix()}
    if contents.encoding != "utf-8":
        keys["dbc_encoding"] = contents.encoding
    collector = Collector(path)
    draft = Draft(path, [DraftBus("can", keys)], collector.notes)
    _note(contents, collector, named=encoding is not None)
    for signal in contents.signals:
        with collector.item(signal.line, signal.name):
            _add(signal, collector, draft.buses[0])
    if not draft.buses[0].points:
        raise collector.nothing(None, "describes no signal that can be read; there is nothing to import")
    return draft


def _note(contents: DbcContents, collector: Collector, *, named: bool) -> None:
    """Note the encoding, the items left out, and the identification of J1939 messages."""
    if contents.encoding != "utf-8" and not named:
        collector.notes.append(f"it is no UTF-8 text and was read as {contents.encoding}; look at its names and units")
    for line, why in contents.left_out:
        name, _, what = why.partition(": ")
        with collector.item(line, name):
            raise ImportFileError(collector.path, line, what)
    for line, what in contents.notes:
        collector.note(line, what)
    for message, match in dict.fromkeys((s.message, s.match) for s in contents.signals if s.match.pgn is not None):
        who = "" if match.mask & 0xFF else "; where several send it, give [[bus.can.message]] name, pgn and source"
        collector.notes.append(f"{message} is read by its {match}, at any priority{who}")


def _add(signal: DbcSignal, collector: Collector, bus: DraftBus) -> None:
    line = signal.line
    if signal.multiplexed:
        collector.note(line, f"{signal.message}.{signal.name} is multiplexed: it comes in some of the frames only")
    point: dict[str, Any] = {"message": signal.message, "signal": signal.name, "unit": signal.unit}
    if signal.minimum is not None and signal.maximum is not None and signal.minimum < signal.maximum:
        point["plausible"] = [float(signal.minimum), float(signal.maximum)]
    named = value_table(signal)
    if named.labels is not None:
        point["labels"] = named.labels
        point["kind"] = "status"
        point.pop("plausible", None)
    if named.invalid:
        point["invalid"] = named.invalid
    if named.others:
        said = f"{signal.name}: the value table is of a measured signal: {', '.join(named.others)}"
        collector.note(line, f"{said}; a reading of it is taken as measured")
    if signal.cycle_s:
        point["stale_after_s"] = round(max(3.0 * signal.cycle_s, 0.1), 3)
    if signal.comment:
        point["doc"] = signal.comment
    if signal.unit:
        unit, _ = collector.unit(line, signal.unit)
        if unit == "1" and signal.unit.strip() not in ("1", "-"):
            # the receiver compares units with the DBC's, and cannot compare what it does not know
            collector.notes.pop()
            raise ImportFileError(
                collector.path, line, f"unit {signal.unit!r} is not known; correct its unit in the DBC"
            )
    guessed = {"stale_after_s": "three cycles of its message", "invalid": "by the names of its value table"}
    bus.points.append(collector.point("can", signal.name, line, point, guessed))
