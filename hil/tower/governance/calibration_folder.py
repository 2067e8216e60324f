"""Folder of a calibration: which calibration it belongs to, and the ends of its chains of records.

`calibration.json` says of what the folder is: mode, labels, events, network, and for each cell the hashes of twin,
healthy record and aligned record with its span. A calibration of something else is refused there, so that no two are
ever mixed. A record that goes on beyond the old one continues its calibration: the chains get the new times alone.

The same file holds the number of lines and the last hash of each chain, so that a chain that was cut at its end is
found as well. It is replaced together with the other files.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil.record import RecordError
from hil.tower.calibration import TABLE, load_all, path_beside
from hil.tower.governance.events_file import EVENTS
from hil.tower.governance.records import NETWORK_RECORDS, QUEUE, RECORDS, ChainEnd, chain_end, check_records
from hil.tower.network import NETWORK_TABLE
from hil.tower.station import iso, read_object, span_of

ABOUT = "calibration.json"
FORMAT = 1
CHAINS = (RECORDS, NETWORK_RECORDS)
DERIVED = ("report.md", "review.rrd")
"""Files that other commands make of a calibration; they go with it."""
_FILES = frozenset((TABLE, NETWORK_TABLE, *CHAINS, QUEUE, EVENTS, ABOUT, *DERIVED))
_CELL = {"twin": str, "twin_file": str, "healthy": str, "record": str, "from": str, "to": str}
_SHAPE = {
    "format": int,
    "mode": str,
    "network_mode": str,
    "labels": str,
    "events": str,
    "network": str,
    "cells": {},
    "chains": {},
}
_WORDS = {"labels": "labels", "events": "events", "network": "network ensemble", "healthy": "healthy record"}


@dataclass(frozen=True)
class CalibrationSources:
    """Inputs that a calibration is made of, by their hashes.

    Attributes
    ----------
    mode, network_mode
        Use of the proposals of Gauss-Newton and of the network.
    labels, events, network
        SHA-256 of the file that was given, "" for none.
    cells
        By number: SHA-256 of the twin, of its healthy record and of the record, the span of the record, and the name
        of the twin file.
    """

    mode: str
    network_mode: str
    labels: str
    events: str
    network: str
    cells: dict[str, dict[str, str]]

    def others(self, new: CalibrationSources) -> list[str]:
        """Return in which a new calibration differs from this one, a phrase each."""
        found = []
        for name, word in (("mode", "mode"), ("network_mode", "network mode")):
            old, now = getattr(self, name), getattr(new, name)
            if old != now:
                found.append(f"its {word} is {old}, not {now}")
        found += [
            _other(word, getattr(self, name), getattr(new, name))
            for name, word in _WORDS.items()
            if name != "healthy" and getattr(self, name) != getattr(new, name)
        ]
        if self.cells.keys() != new.cells.keys():
            return [*found, f"its cells are {', '.join(self.cells)}, not {', '.join(new.cells)}"]
        for cell, old in self.cells.items():
            now = new.cells[cell]
            if old["twin"] != now["twin"]:
                found.append(f"its twin of cell {cell} is another one, {old['twin_file']}")
            if old["healthy"] != now["healthy"]:
                found.append(f"cell {cell}: {_other(_WORDS['healthy'], old['healthy'], now['healthy'])}")
            if old["record"] != now["record"] and not (old["from"] == now["from"] and old["to"] < now["to"]):
                found.append(f"its record of cell {cell} is another one, from {old['from']} to {old['to']}")
        return found


def _other(word: str, old: str, new: str) -> str:
    if not old or not new:
        return f"it has {'no ' if not old else ''}{word}"
    return f"its {word} are other ones" if word.endswith("s") else f"its {word} is another one"


def sources_of(
    record: Path,
    twins: Sequence[Path],
    *,
    labels: Path | None,
    events: Path | None,
    card: Path | None,
    modes: tuple[str, str],
) -> CalibrationSources:
    """Return what a calibration will be made of.

    Parameters
    ----------
    record, twins
        Aligned record, and twins of its cells.
    labels, events, card
        Further files, or None.
    modes
        Use of the proposals of Gauss-Newton and of the network.

    Raises
    ------
    RecordError, TwinFileError
        A file cannot be used.
    """
    cells = {}
    for cell, (path, network) in sorted(load_all(twins, record).items()):
        start, end, digest = span_of(record, cell)
        healthy = path_beside(path, network)
        cells[str(cell)] = {
            "twin": _sha(path),
            "twin_file": path.name,
            "healthy": _sha(healthy if healthy.exists() else None),
            "record": digest,
            "from": iso(start),
            "to": iso(end),
        }
    return CalibrationSources(*modes, _sha(labels), _sha(events), _sha(card), cells)


def is_of_calibration(name: str) -> bool:
    """Return True for the name of a file of a calibration."""
    return name in _FILES


def require_same(out: Path, new: CalibrationSources) -> bool:
    """Check that a folder holds no other calibration, and that its chains are whole; return whether it holds this one.

    Raises
    ------
    RecordError
        The folder holds another calibration, or its records were changed.
    """
    if not out.is_dir() or not any(is_of_calibration(path.name) for path in out.iterdir()):
        return False
    old = read_sources(out)
    if others := old.others(new):
        raise RecordError(
            f"{out}: holds another calibration: {'; '.join(others)}; give another --out, or --replace to remove it"
        )
    check_chains(out)
    return True


def read_sources(out: Path) -> CalibrationSources:
    """Return what the calibration of a folder was made of.

    Raises
    ------
    RecordError
        The folder does not tell.
    """
    found = _about(out)
    return CalibrationSources(
        found["mode"], found["network_mode"], found["labels"], found["events"], found["network"], found["cells"]
    )


def check_chains(out: Path) -> None:
    """Check the chains of records of a folder, up to their ends.

    Raises
    ------
    RecordError
        A line was changed, added or removed, or a file is missing.
    """
    told = _about(out)["chains"]
    for name in CHAINS:
        end = told.get(name)
        check_records(out / name, None if end is None else ChainEnd(end["lines"], end["last"]))


def continue_chains(out: Path, part: Path) -> None:
    """Copy the chains of a calibration to where it is continued; raises OSError."""
    for name in CHAINS:
        if (out / name).is_file():
            shutil.copyfile(out / name, part / name)


def write_about(part: Path, sources: CalibrationSources) -> None:
    """Write `calibration.json` beside finished chains; raises OSError."""
    chains = {name: chain_end(part / name) for name in CHAINS if (part / name).is_file()}
    document: dict[str, Any] = {
        "format": FORMAT,
        "mode": sources.mode,
        "network_mode": sources.network_mode,
        "labels": sources.labels,
        "events": sources.events,
        "network": sources.network,
        "cells": sources.cells,
        "chains": {name: {"lines": end.lines, "last": end.last} for name, end in chains.items()},
    }
    (part / ABOUT).write_text(json.dumps(document, indent=1) + "\n")


def _about(out: Path) -> dict[str, Any]:
    path = out / ABOUT
    remedy = "restore it, or calibrate into another folder, or anew with --replace"
    if not path.is_file():
        raise RecordError(f"{path}: is missing, so that nothing tells of what the folder is; {remedy}")
    shape = _SHAPE | {"chains": {f"{name}?": {"lines": int, "last": str} for name in CHAINS}}
    found = read_object(path, shape, remedy)
    return read_object(path, shape | {"cells": dict.fromkeys(found["cells"], _CELL)}, remedy)


def _sha(path: Path | None) -> str:
    if path is None:
        return ""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise RecordError(f"{path}: cannot be read ({error.strerror}); give another file") from error
