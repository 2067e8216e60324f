"""Tables for a person (terminal, Markdown) and a program (JSON), with their manifest."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table as RichTable

from hil.files import replacing
from hil.run.session import console

Cell = str | float | int | None
WIDTH = 100
"""Most columns of a printed table's width."""
LONG_FIGURE = 14
"""Length from which a cell is prose, aligned to the left."""


@dataclass(frozen=True, slots=True)
class ReportTable:
    """Table: `rows` hold numbers in the units that `columns` name, None without a figure."""

    key: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class BenchReport:
    """Report of a benchmark: its tables, and a plain line for everything left out."""

    name: str
    tables: tuple[ReportTable, ...]
    skipped: tuple[str, ...]
    manifest: dict[str, Any]


def number(value: Cell) -> str:
    """Format three significant digits, thousands as k and M; text unchanged, `-` for None."""
    if value is None:
        return "-"
    if isinstance(value, str):
        return value
    if isinstance(value, int):
        return str(value)
    if not math.isfinite(value):
        return "-" if math.isnan(value) else "inf"
    size = abs(value)
    if size == 0.0:
        return "0"
    if size >= 999.5e3:
        return f"{value / 1e6:.3g} M" if size < 999.5e6 else f"{value:.1e}"
    if size >= 9995.0:
        return f"{value / 1e3:.3g} k"
    if size >= 99.95:
        return f"{value:.0f}"
    if size >= 9.995:
        return f"{value:.1f}"
    if size >= 0.9995:
        return f"{value:.2f}"
    if size >= 0.00995:
        return f"{value:.3f}"
    if size >= 0.000995:
        return f"{value:.4f}"
    return f"{value:.0e}" if size >= 1e-12 else "0"


def show(report: BenchReport, to: Console | None = None) -> None:
    """Print every table, at most `WIDTH` columns wide."""
    out = to or console()
    for table in report.tables:
        drawn = RichTable(title=table.title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1), pad_edge=False)
        for position, column in enumerate(table.columns):
            prose = _is_prose(table, position)
            widest = None if prose else max((len(number(row[position])) for row in table.rows), default=1)
            drawn.add_column(
                column, justify="left" if prose else "right", no_wrap=position == 0, min_width=widest, overflow="fold"
            )
        for row in table.rows:
            drawn.add_row(*(number(cell) for cell in row))
        out.print(drawn, width=min(WIDTH, out.width), markup=False)
        for note in table.notes:
            out.print(f"  {note}", markup=False, width=min(WIDTH, out.width))
        out.print()
    for line in report.skipped:
        out.print(f"left out: {line}", markup=False, width=min(WIDTH, out.width))
    machine = report.manifest["machine"]
    out.print(f"{machine['cpu']}, {machine['cores']} cores; {report.manifest['date']}", markup=False)


def _is_prose(table: ReportTable, position: int) -> bool:
    """Return True if a column holds words; the first always does."""
    words = [row[position] for row in table.rows if isinstance(row[position], str)]
    return position == 0 or any(len(str(word)) > LONG_FIGURE for word in words)


def as_json(report: BenchReport) -> str:
    """Return all figures unrounded."""
    tables = {
        t.key: {
            "title": t.title,
            "columns": list(t.columns),
            "rows": [[_plain(c) for c in r] for r in t.rows],
            "notes": list(t.notes),
        }
        for t in report.tables
    }
    return json.dumps({"name": report.name, "tables": tables, "skipped": list(report.skipped)}, indent=1) + "\n"


def as_markdown(report: BenchReport) -> str:
    """Return the tables as Markdown, for `docs/results`."""
    machine, manifest = report.manifest["machine"], report.manifest
    lines = [f"# hil bench {report.name}", "", f"`{manifest['command']}`", ""]
    of = f", commit {manifest['commit']}" if manifest.get("commit") else ""
    lines += [f"{machine['cpu']}, {machine['cores']} cores, {manifest['date']}, seed {manifest['seed']}{of}.", ""]
    for table in report.tables:
        lines += [f"## {table.title}", "", "| " + " | ".join(table.columns) + " |"]
        lines += ["|" + "|".join("---" if _is_prose(table, k) else "---:" for k in range(len(table.columns))) + "|"]
        lines += ["| " + " | ".join(number(cell).replace("|", "\\|") for cell in row) + " |" for row in table.rows]
        lines += [""]
        lines += [f"- {note}" for note in table.notes]
        lines += [""] if table.notes else []
    lines += [f"- left out: {line}" for line in report.skipped]
    return "\n".join(lines).rstrip() + "\n"


def write(report: BenchReport, folder: Path) -> list[Path]:
    """Write `<name>.json`, `<name>.md` and `<name>.manifest.json` into `folder`, each atomically."""
    folder.mkdir(parents=True, exist_ok=True)
    texts = {
        f"{report.name}.json": as_json(report),
        f"{report.name}.md": as_markdown(report),
        f"{report.name}.manifest.json": json.dumps(report.manifest, indent=1) + "\n",
    }
    paths = []
    for name, text in texts.items():
        with replacing(folder / name) as temporary:
            temporary.write_text(text, encoding="utf-8")
        paths.append(folder / name)
    return paths


def _plain(cell: Cell) -> Cell:
    return None if isinstance(cell, float) and not math.isfinite(cell) else cell
