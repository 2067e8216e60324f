"""Governance of a calibration: append-only records, review queue, states, drift alarm.

`records.jsonl` has a line for every five minutes of a cell, some 300 bytes, so 32 MB a year. A line holds the hash of
the line before, so a line that was changed or removed later is found; `calibration.json` holds the end of the chain.
Its keys:

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

from hil.files import parse_json, replacing
from hil.record import RecordError
from hil.tower.governance.gates import Verdict
from hil.tower.station import iso, misfit, seconds
from twin.tower import Array, TargetWindow

RECORDS, QUEUE = "records.jsonl", "review_queue.json"
NETWORK_RECORDS = "network_records.jsonl"
EVERY_S = 300.0
HASH = 12
"""Hex digits of a hash: 48 bits identify a line among some 1e5 with a chance of 1e-5 that two agree."""
_LINE = {"t": str, "c": int, "f": [str], "p": str}
_REMEDY = "restore the file, or calibrate into another folder"
DRIFT_HOURS = 24
DRIFT_LIMITS = {"residual_mean": 0.25, "coverage": 0.80, "withheld": 0.5, "missing": 0.25, "distance": 1.0}
"""K; shares; novelty of the operating point. Two of them beyond their limits for a day raise the alarm."""
_BEYOND = {
    "residual_mean": f"the mean error was above {DRIFT_LIMITS['residual_mean']:g} K",
    "coverage": f"less than {100 * DRIFT_LIMITS['coverage']:g} % of the readings lay in the interval",
    "withheld": "gates held the proposals back",
    "missing": f"more than {100 * DRIFT_LIMITS['missing']:g} % of the required channels were hidden",
    "distance": "the operating point was far from those before",
}


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


def drift_sentence(names: Sequence[str]) -> str:
    """Return the indicators of a drift alarm in words."""
    return f"for a day {' and '.join(_BEYOND.get(name, name) for name in names)}"


def _running(rows: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return how many hours running each row has been true."""
    index = np.arange(len(rows))
    return index - np.maximum.accumulate(np.where(rows, -1, index))


@dataclass(frozen=True)
class ChainEnd:
    """End of a chain of records: number of its lines, and hash of the last one, "" for none."""

    lines: int
    last: str


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
    again. The file is a copy that replaces the other one when all is written, so an error leaves nothing half written.

    Raises
    ------
    RecordError
        A line of the file was changed.
    OSError
        The file cannot be written.
    """
    end, until = _checked(path)
    last, count = end.last, 0
    with path.open("a", encoding="utf-8") as handle:
        for cell in cells:
            for line in _lines(cell, state, until.get(cell.cell, -np.inf)):
                line["p"] = last
                text = json.dumps(line, separators=(",", ":"), allow_nan=False)
                last = _hash(text.encode())
                handle.write(text + "\n")
                count += 1
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


def check_records(path: Path, end: ChainEnd | None) -> None:
    """Check a chain of records up to its end.

    Parameters
    ----------
    path
        The file.
    end
        End of the chain as `calibration.json` tells it; None where no such chain was written.

    Raises
    ------
    RecordError
        A line is damaged, does not follow from the one before, or the chain ends elsewhere.
    """
    if not path.is_file():
        if end is not None:
            raise RecordError(f"{path}: is missing, and {end.lines} records were written; {_REMEDY}")
        return
    found, _ = _checked(path)
    if end is None:
        raise RecordError(f"{path}: is no file of this calibration, which wrote no such records; take it away")
    if found.lines != end.lines:
        what = "removed from" if found.lines < end.lines else "added to"
        raise RecordError(
            f"{path}: has {found.lines} records and {end.lines} were written: lines were {what} its end; {_REMEDY}"
        )
    if found.last != end.last:
        raise RecordError(f"{path}:{found.lines}: is not the last line that was written: it was changed; {_REMEDY}")


def _checked(path: Path) -> tuple[ChainEnd, dict[int, float]]:
    """Return the end of a chain whose lines follow from one another, and the last time of each cell, s."""
    until: dict[int, float] = {}
    last, number = "", 0
    if not path.is_file():
        return ChainEnd(0, ""), {}
    try:
        with path.open("rb") as handle:
            for number, text in enumerate(handle, 1):
                until.update([_checked_line(path, number, text, last)])
                last = _hash(text.rstrip(b"\n"))
    except OSError as error:
        raise RecordError(f"{path}: cannot be read ({error.strerror}); {_REMEDY}") from error
    return ChainEnd(number, last), until


def _checked_line(path: Path, number: int, text: bytes, before: str) -> tuple[int, float]:
    """Return cell and time of a line that follows from the hash of the one before."""
    try:
        line = parse_json(text)
        fault = misfit(line, _LINE)
        time_s = 0.0 if fault else seconds(line["t"])
    except ValueError as error:
        fault, time_s = str(error), 0.0
    if fault:
        raise RecordError(f"{path}:{number}: is no record of a calibration ({fault}); {_REMEDY}")
    if line["p"] != before or not text.endswith(b"\n"):
        raise RecordError(
            f"{path}:{number}: does not follow from the line before: a line was changed or removed; {_REMEDY}"
        )
    return line["c"], time_s


def chain_end(path: Path) -> ChainEnd:
    """Return the end of a chain that was just written; raises OSError."""
    lines = path.read_bytes().splitlines()
    return ChainEnd(len(lines), _hash(lines[-1]) if lines else "")


def _hash(text: bytes) -> str:
    return hashlib.sha256(text).hexdigest()[:HASH]


def write_queue(path: Path, entries: Sequence[dict[str, Any]]) -> None:
    """Write the review queue: proposals that wait for an engineer, with reason codes, newest first."""
    ordered = sorted(entries, key=lambda entry: str(entry["time"]), reverse=True)
    with replacing(path) as unfinished:
        unfinished.write_text(json.dumps({"format": 1, "proposals": ordered}, indent=1) + "\n")
