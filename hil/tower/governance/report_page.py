"""Report of a calibration from its folder: outlet, deviations, gates and proposals, as a page of Markdown."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq

from hil.record import RecordError
from hil.tower.calibration import TABLE
from hil.tower.governance.records import NETWORK_RECORDS, QUEUE, RECORDS, check_records
from hil.tower.network import NETWORK, NETWORK_TABLE, read_about
from twin.tower import DEVIATIONS

REPORT = "report.md"


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
        The folder holds no calibration, or its records were changed.
    """
    if not (out / TABLE).is_file():
        raise RecordError(f"{out}: holds no {TABLE}; make it with hil tower calibrate")
    check_records(out / RECORDS)
    check_records(out / NETWORK_RECORDS)
    cells, columns = _read(out / TABLE)
    found = [_of(columns, cells == c, int(c), "Gauss-Newton") for c in np.unique(cells)]
    network = out / NETWORK_TABLE
    asked = network.is_file()
    if asked:
        cells, answered = _read(network)
        found += [_of(answered, cells == c, int(c), "network") for c in np.unique(cells)]
    found.sort(key=lambda one: one.cell)
    text = ["# Calibration", "", _span(columns["time"]), "", *_outlet_table(found)]
    if asked:
        text += ["", read_about(network).sentence()]
    text += ["", *_flags(out / RECORDS)]
    if asked:
        text += ["", "## Records of the network", "", *_flags(out / NETWORK_RECORDS)]
    text += ["", *_proposals(out / QUEUE)]
    return "\n".join(text).rstrip() + "\n"


def _read(path: Path) -> tuple[Any, dict[str, Any]]:
    """Return the cell of each row of a table, and its other columns."""
    try:
        table = pq.read_table(path)
        return table["cell"].to_numpy(), {n: table[n].to_numpy() for n in table.schema.names if n != "cell"}
    except (OSError, ValueError, KeyError) as error:
        raise RecordError(f"{path}: cannot be read ({error}); calibrate again") from error


def _span(time: Any) -> str:
    return f"From {str(time.min())[:16]} to {str(time.max())[:16]} UTC. Intervals are 90 %; a dash is a withheld value."


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
    with path.open(encoding="utf-8") as handle:
        for text in handle:
            line = json.loads(text)
            total += 1
            count.update(line["f"])
    lines = [
        f"{total} records of five minutes, in an unbroken chain. Reason codes:",
        "",
        "| code | share of records |",
        "|---|---|",
    ]
    return lines + [f"| `{code}` | {100 * number / total:.1f} % |" for code, number in count.most_common()]


def _proposals(path: Path) -> list[str]:
    if not path.is_file():
        return ["The calibrator is in its shadow state; there is no review queue."]
    entries = json.loads(path.read_text()).get("proposals", [])
    lines = ["## Review queue", ""]
    for e in entries:
        if "parameter" in e:
            by = ", network" if e.get("calibrator") == NETWORK else ""
            verdict = "all gates hold" if e["accepted"] else f"held back: {', '.join(e['codes'])}"
            if any(code.startswith("LOW_SENSITIVITY") for code in e["codes"]):
                verdict += f"; condition {e['condition']:g}, known least: {e['combined']}"
            lines.append(
                f"- {e['time']} cell {e['cell']}{by}: {e['parameter']} {e['value']:.3f} ± {e['sd']:.3f}; {verdict}"
            )
        else:
            further = f" of {e['size_K']:+.2f} K" if "size_K" in e else f" by {', '.join(e.get('indicators', []))}"
            lines.append(f"- {e['time']} cell {e['cell']}: {e['event'].replace('_', ' ')}{further}")
    return lines
