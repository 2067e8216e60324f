"""`hil tower align`: raw tags of a historian to an aligned one-minute record, and a report of their defects."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hil.cli.options import INPUT_FILE

if TYPE_CHECKING:
    from hil.tower import Aligned
    from twin.historian import Defect

SHOWN = 40
"""Rows of the table on the terminal; the file has all."""


@click.command()
@click.argument("store")
@click.option("--tags", type=INPUT_FILE, help="Tag dictionary; default: tags.csv in STORE.")
@click.option("--out", required=True, type=click.Path(path_type=Path, file_okay=False), help="Folder of the record.")
@click.option("--datasheet", type=INPUT_FILE, help="Datasheet of the station; default: datasheet.json in STORE.")
@click.option("--events", type=INPUT_FILE, help="Events of the station; default: events.csv in STORE.")
def command(store: str, tags: Path | None, out: Path, datasheet: Path | None, events: Path | None) -> None:
    """Make an aligned one-minute record of the tags in STORE.

    STORE is a folder of Parquet files, a DuckDB file, or the URL of a PostgreSQL database. Writes OUT/cell<N>.parquet,
    OUT/alignment.json with the defects that were found, and OUT/station.json.

    \b
    Example:
      hil tower align station --out record
      hil tower align postgresql://reader@historian/plant --tags tags.csv --out record
    """
    from drivers.historian import open_store
    from hil.tower import align_station, read_station

    folder = Path(store)
    tags = tags or _beside(folder, "tags.csv")
    if tags is None:
        raise click.UsageError(f"{store} has no tags.csv; name the tag dictionary with --tags")
    datasheet, events = datasheet or _beside(folder, "datasheet.json"), events or _beside(folder, "events.csv")
    station = read_station(tags, datasheet, events)
    with open_store(store) as opened:
        result = align_station(opened, station, out)
    _show(result, out)


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
    rows = [one for kind in sorted(groups, key=lambda kind: len(groups[kind])) for one in groups[kind]]
    for one in rows[:SHOWN]:
        table.add_row(one.kind, iso(one.start_s)[:16], iso(one.end_s)[:16], Text(one.says), one.repair)
    terminal.print(table) if rows else terminal.print("no defect was found")
    if len(rows) > SHOWN:
        terminal.print(f"and {len(rows) - SHOWN} more in {out / 'alignment.json'}", markup=False)
    for remark in result.remarks:
        terminal.print(remark, markup=False)
    for path, (cell, share) in zip(result.files, result.complete.items(), strict=True):
        terminal.print(
            f"cell {cell}: {100 * share:.1f} % of {result.minutes} minutes complete, {path}",
            markup=False,
            soft_wrap=True,
        )
