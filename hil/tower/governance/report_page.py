"""Report of a calibration from its folder: outlet, deviations, gates, events and proposals, as a page of Markdown."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hil.files import parse_json, require_complete
from hil.record import RecordError
from hil.tower.calibration import TABLE, read_minutes, read_remarks
from hil.tower.governance.calibration_folder import check_chains
from hil.tower.governance.events_file import event_lines
from hil.tower.governance.records import NETWORK_RECORDS, QUEUE, RECORDS, drift_sentence
from hil.tower.network import NETWORK, NETWORK_TABLE, read_about
from hil.tower.station import misfit, read_object
from twin.tower import DEVIATIONS, condition_text
from twin.tower.calibration import NORMAL

REPORT = "report.md"
_NEEDED = ("t_out", "t_out_lo", "t_out_hi", "t_out_commissioned", *DEVIATIONS)
_PROPOSALS = {"proposals": [{"time": str, "cell": int}]}
_PROPOSAL = {
    "parameter": str,
    "value": float,
    "sd": float,
    "accepted": bool,
    "codes": [str],
    "condition": float,
    "combined": str,
    "calibrator?": str,
}
_HAPPENED = {"event": str, "size_K?": float, "indicators?": [str], "text?": str}


@dataclass(frozen=True)
class _Cell:
    """Figures of one cell."""

    cell: int
    calibrator: str
    minutes: int
    answered: float
    width: float
    correction: float
    first: dict[str, float]
    last: dict[str, float]


def report(out: Path) -> str:
    """Return the report of a calibration's folder.

    Raises
    ------
    RecordError
        The folder holds no calibration, or its records were changed, or a file of it is damaged.
    """
    require_complete(out, RecordError)
    if not (out / TABLE).is_file():
        raise RecordError(f"{out}: holds no {TABLE}; make it with hil tower calibrate")
    check_chains(out)
    cells, columns = _read(out / TABLE)
    found = [_of(columns, cells == c, int(c), "Gauss-Newton") for c in np.unique(cells)]
    network = out / NETWORK_TABLE
    asked = network.is_file()
    if asked:
        cells, answered = _read(network)
        found += [_of(answered, cells == c, int(c), "network") for c in np.unique(cells)]
    found.sort(key=lambda one: one.cell)
    text = ["# Calibration", "", _span(columns["time"]), "", *_outlet_table(found)]
    text += [f"\nCell {cell}: {one}." for cell, sentences in read_remarks(out / TABLE).items() for one in sentences]
    if asked:
        text += ["", read_about(network).sentence()]
    text += ["", *_flags(out / RECORDS)]
    if asked:
        text += ["", "## Records of the network", "", *_flags(out / NETWORK_RECORDS)]
    text += ["", *event_lines(out), "", *_proposals(out / QUEUE)]
    return "\n".join(text).rstrip() + "\n"


def _read(path: Path) -> tuple[Any, dict[str, Any]]:
    """Return the cell of each row of a table, and its other columns."""
    found = read_minutes(path, _NEEDED, "calibrate again")
    if not found:
        raise RecordError(f"{path}: has no minute; calibrate again")
    columns = {name: np.concatenate([one[name] for one in found.values()]) for name in ("time", "cell", *_NEEDED)}
    return columns.pop("cell"), columns


def _span(time: Any) -> str:
    return (
        f"From {str(time.min())[:16]} to {str(time.max())[:16]} UTC. Intervals are 90 %; a dash is a deviation "
        f"that the record hardly informs."
    )


def _of(columns: dict[str, Any], rows: Any, cell: int, calibrator: str) -> _Cell:
    there = np.isfinite(columns["t_out"][rows])
    width = columns["t_out_hi"][rows] - columns["t_out_lo"][rows]
    correction = columns["t_out"][rows] - columns["t_out_commissioned"][rows]
    ends: list[dict[str, float]] = [{}, {}]
    for name in DEVIATIONS:
        values = columns[name][rows]
        told = values[np.isfinite(values)]
        for end, at in zip(ends, (0, -1), strict=True):
            end[name] = float(told[at]) if len(told) else float("nan")
    return _Cell(
        cell,
        calibrator,
        int(rows.sum()),
        float(there.mean()),
        float(np.nanmean(width)) if there.any() else float("nan"),
        float(np.nanmean(np.abs(correction))) if there.any() else float("nan"),
        ends[0],
        ends[1],
    )


def _outlet_table(cells: list[_Cell]) -> list[str]:
    lines = [
        "| cell | calibrator | minutes | predicted | width K | correction K | fill | air | uniformity | bias K |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for c in cells:
        moved = " | ".join(
            "-" if not np.isfinite(c.last[name]) else f"{c.first[name]:.3f} to {c.last[name]:.3f}"
            for name in DEVIATIONS
        )
        lines.append(
            f"| {c.cell} | {c.calibrator} | {c.minutes} | {100 * c.answered:.1f} % | {c.width:.2f} | "
            f"{c.correction:.2f} | {moved} |"
        )
    return lines


def _flags(path: Path) -> list[str]:
    if not path.is_file():
        return ["No records."]
    count: Counter[str] = Counter()
    total = 0
    with path.open("rb") as handle:
        for text in handle:
            total += 1
            count.update(parse_json(text)["f"])
    lines = [
        f"{total} records of five minutes, in an unbroken chain. Reason codes:",
        "",
        "| code | share of all records |",
        "|---|---|",
    ]
    return lines + [f"| `{code}` | {100 * number / total:.1f} % |" for code, number in count.most_common()]


def _proposals(path: Path) -> list[str]:
    if not path.is_file():
        return ["The calibrator is in its shadow state; there is no review queue."]
    entries = read_object(path, _PROPOSALS, "calibrate again")["proposals"]
    lines = ["## Review queue", "", "Verdicts are those of the last window that ran, not of the shares above.", ""]
    for e in entries:
        shape = _PROPOSAL if "parameter" in e else _HAPPENED
        if fault := misfit(e, shape):
            raise RecordError(f"{path}: a proposal's {fault}; calibrate again")
        if "parameter" in e:
            by = ", network" if e.get("calibrator") == NETWORK else ""
            verdict = "all gates hold" if e["accepted"] else f"held back: {', '.join(e['codes'])}"
            if any(code.startswith("LOW_SENSITIVITY") for code in e["codes"]):
                verdict += f"; condition {condition_text(e['condition'])}, the combination shown least: {e['combined']}"
            value = f"{e['value']:.3f} ± {NORMAL * e['sd']:.3f}"
            lines.append(f"- {e['time']} cell {e['cell']}{by}: {e['parameter']} {value}; {verdict}")
        elif "text" in e:
            lines.append(f"- {e['time']} cell {e['cell']}: {e['text']}")
        else:
            further = f" of {e['size_K']:+.2f} K" if "size_K" in e else f": {drift_sentence(e.get('indicators', []))}"
            lines.append(f"- {e['time']} cell {e['cell']}: {e['event'].replace('_', ' ')}{further}")
    return lines
