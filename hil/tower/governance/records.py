"""Governance of a calibration: append-only records, review queue, states, drift alarm.

`records.jsonl` has a line for every five minutes of a cell, some 300 bytes, so 32 MB a year. A line holds the hash of
the line before, so a line that was changed or removed later is found. Its keys:

| key | content |
|---|---|
| `t`, `c`, `m` | effective time (UTC), cell, state of the calibrator: shadow, advisory or controlled |
| `d`, `s` | deviations fill, air, uniformity (of 1), bias K, and their standard deviations |
| `y`, `w` | correction of the outlet against the commissioned cell, K, and half width of its 90 % interval, K |
| `r`, `k`, `h` | regime, condition number of the last day, share of hidden channels |
| `f` | reason codes of the gates that did not hold, and of constraints that are switched off |
| `src`, `tw`, `p` | hashes of the record and window, of the twin file, and of the line before |
| `n` | hash of the network's card, in `network_records.jsonl` alone |

`network_records.jsonl` has the same lines of a network that was asked, in a chain of its own.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.files import replacing
from hil.record import RecordError
from hil.tower.governance.gates import Verdict
from hil.tower.station import iso
from twin.tower import Array, TargetWindow

RECORDS, QUEUE = "records.jsonl", "review_queue.json"
NETWORK_RECORDS = "network_records.jsonl"
STATES = ("shadow", "advisory", "controlled")
"""Shadow writes records; advisory fills the review queue too; controlled saves accepted proposals as revisions of the
twin."""
EVERY_S = 300.0
HASH = 12
"""Hex digits of a hash: 48 bits identify a line among some 1e5 with a chance of 1e-5 that two agree."""
DRIFT_HOURS = 24
DRIFT_LIMITS = {"residual_mean": 0.25, "coverage": 0.80, "withheld": 0.5, "missing": 0.25, "distance": 4.0}
"""K; shares; standard deviations of the operating points. Two of them beyond their limits for a day raise the alarm."""


@dataclass(frozen=True)
class Indicators:
    """Indicators of drift by hour (n,): mean residual K, coverage, shares withheld and missing, distance; NaN is
    unknown."""

    time_s: Array
    residual_mean: Array
    coverage: Array
    withheld: Array
    missing: Array
    distance: Array


def drift_alarms(found: Indicators) -> list[tuple[float, tuple[str, ...]]]:
    """Return the time of each drift alarm, s, with the indicators that have been beyond their limits for a day.

    The alarm is raised when two or more have been beyond for `DRIFT_HOURS` hours running; it is raised anew after it
    has ended.
    """
    beyond = {
        "residual_mean": np.abs(found.residual_mean) > DRIFT_LIMITS["residual_mean"],
        "coverage": found.coverage < DRIFT_LIMITS["coverage"],
        "withheld": found.withheld > DRIFT_LIMITS["withheld"],
        "missing": found.missing > DRIFT_LIMITS["missing"],
        "distance": found.distance > DRIFT_LIMITS["distance"],
    }
    lasting = {name: _running(np.asarray(rows)) >= DRIFT_HOURS for name, rows in beyond.items()}
    count = np.sum(list(lasting.values()), axis=0)
    raised = (count >= 2) & ~np.r_[False, count[:-1] >= 2]
    return [
        (float(found.time_s[i]), tuple(n for n, rows in lasting.items() if rows[i])) for i in np.flatnonzero(raised)
    ]


def _running(rows: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return how many hours running each row has been true."""
    index = np.arange(len(rows))
    return index - np.maximum.accumulate(np.where(rows, -1, index))


@dataclass(frozen=True)
class CellLines:
    """Content of a cell's records, by line (n,): times, deviations and standard deviations (n, 4), and the rest."""

    cell: int
    time_s: Array
    deviations: Array
    sd: Array
    correction: Array
    half: Array
    regime: NDArray[np.uint8]
    window: NDArray[np.intp]
    windows: Sequence[TargetWindow]
    verdicts: Sequence[Verdict]
    source: str
    twin: str
    network: str = ""


def append_records(path: Path, cells: Sequence[CellLines], state: str) -> int:
    """Append the records of the cells to the file and return their number; times that it has already are not written
    again.

    Raises
    ------
    RecordError
        The file ends in the middle of a line or a line of it was changed.
    OSError
        The file cannot be written.
    """
    last, until = check_records(path)
    count, size = 0, path.stat().st_size if path.is_file() else 0
    try:
        with path.open("a", encoding="utf-8") as handle:
            for cell in cells:
                for line in _lines(cell, state, until.get(cell.cell, -np.inf)):
                    line["p"] = last
                    text = json.dumps(line, separators=(",", ":"), allow_nan=False)
                    last = hashlib.sha256(text.encode()).hexdigest()[:HASH]
                    handle.write(text + "\n")
                    count += 1
    except OSError:
        # Nothing is left half written, as on a disk that is full.
        if path.is_file():
            with path.open("r+b") as handle_b:
                handle_b.truncate(size)
        raise
    return count


def _lines(cell: CellLines, state: str, after_s: float) -> Iterator[dict[str, Any]]:
    sources = [hashlib.sha256(f"{cell.source}:{w.end_s:.0f}".encode()).hexdigest()[:HASH] for w in cell.windows]
    flags = [_flags(verdict) for verdict in cell.verdicts]
    for i, time_s in enumerate(cell.time_s.tolist()):
        if time_s <= after_s:
            continue
        k = int(cell.window[i])
        line = {
            "t": iso(time_s),
            "c": cell.cell,
            "m": state,
            "d": _rounded(cell.deviations[i], 4),
            "s": _rounded(cell.sd[i], 4),
            "y": _number(cell.correction[i], 3),
            "w": _number(cell.half[i], 3),
            "r": int(cell.regime[i]),
            "k": _number(min(cell.windows[k].told.condition, 9999.0), 1),
            "h": _number(cell.windows[k].told.hidden, 3),
            "f": flags[k],
            "src": sources[k],
            "tw": cell.twin[:HASH],
        }
        yield line | ({"n": cell.network[:HASH]} if cell.network else {})


def _flags(verdict: Verdict) -> list[str]:
    each = sorted({code for codes in verdict.of.values() for code in codes})
    return [*verdict.codes, *each, *verdict.notes]


def _number(value: float, digits: int) -> float | None:
    return round(float(value), digits) if np.isfinite(value) else None


def _rounded(values: Array, digits: int) -> list[float | None]:
    return [_number(v, digits) for v in values]


def check_records(path: Path) -> tuple[str, dict[int, float]]:
    """Return the hash of the last line, and the last time of each cell s; "" and nothing of a file that is not there.

    Raises
    ------
    RecordError
        A line is damaged, or does not follow from the one before.
    """
    if not path.is_file():
        return "", {}
    last, until = "", {}
    with path.open(encoding="utf-8") as handle:
        for number, text in enumerate(handle, 1):
            try:
                line = json.loads(text)
                follows = line["p"] == last and text.endswith("\n")
                until[int(line["c"])] = _epoch(line["t"])
            except (ValueError, KeyError, TypeError) as error:
                raise RecordError(
                    f"{path}:{number}: is no record of a calibration; restore the file or give another folder"
                ) from error
            if not follows:
                raise RecordError(
                    f"{path}:{number}: does not follow from the line before: a line was changed or removed; restore "
                    f"the file or "
                    "give another folder"
                )
            last = hashlib.sha256(text.rstrip("\n").encode()).hexdigest()[:HASH]
    return last, until


def _epoch(text: str) -> float:
    return float(np.datetime64(text.rstrip("Z"), "s").astype(np.int64))


def write_queue(path: Path, entries: Sequence[dict[str, Any]]) -> None:
    """Write the review queue: proposals that wait for an engineer, with reason codes, newest first."""
    ordered = sorted(entries, key=lambda entry: str(entry["time"]), reverse=True)
    with replacing(path) as unfinished:
        unfinished.write_text(json.dumps({"format": 1, "proposals": ordered}, indent=1) + "\n")
