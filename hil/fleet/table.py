"""Results of a fleet as one table: Parquet, CSV, terminal."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from hil.files import on_terminal, replacing
from hil.fleet.folder import TABLE, TABLE_CSV, FleetFolder, unwritable
from hil.fleet.jobs import Job

if TYPE_CHECKING:
    from rich.console import Console

COMMON = ("job", "kind", "rig", "record", "seed", "status", "attempts", "worker", "host", "seconds", "cpu_s")
LAST = ("answer", "error")
SHOWN = 40
"""Rows that the terminal shows; those that failed are shown first."""
LEFT = "left"
"""Status of a job without a result."""


def rows_of(jobs: Sequence[Job], results: dict[str, dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one row for each job: what it is, how it ended, and what it found."""
    rows = []
    for job in jobs:
        result = results.get(job.id, {})
        row = {"job": job.id, "kind": job.kind, "rig": job.rig, "record": job.record, "seed": job.seed}
        row |= {"status": LEFT} | {key: result.get(key) for key in (*COMMON[5:], *LAST) if key in result}
        rows.append(row | result.get("row", {}))
    return rows


def columns_of(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Return the columns of rows: the common ones, those of the kinds, and the words last."""
    own = dict.fromkeys(key for row in rows for key in row if key not in COMMON and key not in LAST)
    return [*COMMON, *own, *LAST]


def write_table(folder: FleetFolder, jobs: Sequence[Job], results: dict[str, dict[str, Any]]) -> None:
    """Write `results.parquet` and `results.csv`; raises FleetFolderError."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows = rows_of(jobs, results)
    columns = columns_of(rows)
    table = pa.table({name: pa.array([row.get(name) for row in rows]) for name in columns})
    for name in (TABLE, TABLE_CSV):
        path = folder.path / name
        try:
            with replacing(path) as unfinished:
                if name == TABLE:
                    pq.write_table(table, unfinished)
                else:
                    with unfinished.open("w", encoding="utf-8", newline="", errors="replace") as file:
                        writer = csv.DictWriter(file, columns, lineterminator="\n")
                        writer.writeheader()
                        writer.writerows(rows)
        except OSError as error:
            raise unwritable(path, error) from None


def show_table(to: Console, jobs: Sequence[Job], results: dict[str, dict[str, Any]], title: str) -> None:
    """Print the counts and at most `SHOWN` rows, failed ones first."""
    from rich.table import Table

    rows = sorted(rows_of(jobs, results), key=lambda row: row["status"] != "failed")
    table = Table(title=title, title_justify="left")
    for heading in ("kind", "rig", "record", "seed", "status", "attempts", "s", "answer"):
        table.add_column(heading, justify="right" if heading in ("seed", "attempts", "s") else "left")
    for row in rows[:SHOWN]:
        seconds = row.get("seconds")
        cells = (row["kind"], row["rig"], row["record"], row["seed"], row["status"], row.get("attempts"))
        words = row.get("error") or row.get("answer") or ""
        shown = [*("" if cell is None else str(cell) for cell in cells), "" if seconds is None else f"{seconds:.1f}"]
        table.add_row(*(on_terminal(cell) for cell in (*shown, words)))
    to.print(table, markup=False)
    if len(rows) > SHOWN:
        to.print(f"{len(rows) - SHOWN} more rows are in {TABLE_CSV}")
    counts = Counter(row["status"] for row in rows)
    said = ", ".join(f"{counts[status]} {status}" for status in ("done", "failed", LEFT) if counts[status])
    verdicts = Counter(row["verdict"] for row in rows if row.get("verdict"))
    told = "; verdicts: " + ", ".join(f"{count} {name}" for name, count in verdicts.most_common()) if verdicts else ""
    to.print(f"jobs: {said}{told}", markup=False, soft_wrap=True)
