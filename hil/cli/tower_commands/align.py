"""`hil tower align`: raw tags of a historian to an aligned one-minute record, and a report of their defects."""

from __future__ import annotations

import zoneinfo
from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hil.cli.options import INPUT_FILE, reading_tables

if TYPE_CHECKING:
    from hil.record import ReadingOptions
    from hil.tower import Aligned
    from twin.historian import Defect

SHOWN = 40
"""Rows of the table on the terminal, one for each kind and tag; the file has every defect."""


@click.command()
@click.argument("store")
@click.option("--tags", type=INPUT_FILE, help="Tag dictionary; default: tags.csv in STORE.")
@click.option("--out", required=True, type=click.Path(path_type=Path, file_okay=False), help="Folder of the record.")
@click.option("--datasheet", type=INPUT_FILE, help="Datasheet of the station; default: datasheet.json in STORE.")
@click.option("--events", type=INPUT_FILE, help="Events of the station; default: events.csv in STORE.")
@click.option("--stamps", metavar="ZONE", help="Zone of the time stamps in STORE, such as Europe/Madrid; default: UTC.")
@reading_tables
def command(
    store: str,
    tags: Path | None,
    out: Path,
    datasheet: Path | None,
    events: Path | None,
    stamps: str | None,
    choice: ReadingOptions,
) -> None:
    """Make an aligned one-minute record of the tags in STORE.

    STORE is a folder of Parquet or CSV files, a DuckDB file, or the URL of a PostgreSQL database. Writes
    OUT/cell<N>.parquet, OUT/alignment.json with the defects that were found, and OUT/station.json.

    \b
    Example:
      hil tower align station --out record
      hil tower align export.csv --tags tags.csv --stamps America/New_York --out record
      hil tower align postgresql://reader@historian/plant --tags tags.csv --out record
    """
    from hil.tower import align_station, open_samples, read_station

    if stamps is not None and stamps not in zoneinfo.available_timezones():
        raise click.UsageError(
            f"--stamps {stamps!r} is no time zone; give one of the IANA names, such as Europe/Madrid"
        )
    folder = Path(store)
    tags = tags or _beside(folder, "tags.csv")
    if tags is None:
        raise click.UsageError(f"{store} has no tags.csv; name the tag dictionary with --tags")
    datasheet, events = datasheet or _beside(folder, "datasheet.json"), events or _beside(folder, "events.csv")
    station = read_station(tags, datasheet, events)
    from hil.run.session import console

    terminal = console(stderr=True)
    others = [path for path in (tags, events) if path is not None]

    def say(text: str) -> None:
        terminal.print(text, markup=False, soft_wrap=True)

    with open_samples(store, others, say=say, choice=choice) as opened:
        result = align_station(opened, station, out, stamps)
    _show(result, out)


def _by_tags(defects: list[Defect]) -> list[list[Defect]]:
    """Return the defects of one kind by tags, those of each in the order of time; single ones first."""
    found: dict[tuple[str, ...], list[Defect]] = defaultdict(list)
    for one in defects:
        found[one.tags].append(one)
    return sorted(found.values(), key=len)


def _beside(folder: Path, name: str) -> Path | None:
    path = (folder if folder.is_dir() else folder.parent) / name
    return path if "://" not in str(folder) and path.is_file() else None


def _show(result: Aligned, out: Path) -> None:
    from rich.table import Table
    from rich.text import Text

    from hil.run.session import console
    from hil.tower import iso

    terminal = console()
    table = Table(title="Defects of the store", title_justify="left")
    for heading in ("defect", "from (UTC)", "to (UTC)", "finding", "repair"):
        table.add_column(heading, overflow="fold")
    groups: dict[str, list[Defect]] = defaultdict(list)
    for one in result.defects:
        groups[one.kind].append(one)
    groups = {kind: groups[kind] for kind in sorted(groups, key=lambda kind: len(groups[kind]))}
    rows = [row for kind in groups for row in _by_tags(groups[kind])]
    for row in rows[:SHOWN]:
        first, last = row[0], max(row, key=lambda one: one.end_s)
        further = f" ({len(row) - 1} more of {', '.join(first.tags[:2])})" if len(row) > 1 else ""
        table.add_row(
            first.kind, iso(first.start_s)[:16], iso(last.end_s)[:16], Text(first.says + further), first.repair
        )
    terminal.print(table) if rows else terminal.print("no defect was found")
    hidden = sum(len(row) for row in rows[SHOWN:])
    if hidden or any(len(row) > 1 for row in rows):
        more = f"{hidden} more, and each one" if hidden else "each one"
        terminal.print(f"{more} with its own times in {out / 'alignment.json'}", markup=False)
    for remark in result.remarks:
        terminal.print(remark, markup=False)
    for path, (cell, share) in zip(result.files, result.complete.items(), strict=True):
        terminal.print(
            f"cell {cell}: {100 * share:.1f} % of {result.minutes} minutes complete, {path}",
            markup=False,
            soft_wrap=True,
        )
