"""Command `hil twin`: history of a twin, differences between revisions, and revert."""

from __future__ import annotations

import dataclasses
import datetime
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hil.cli.options import INPUT_FILE
from hil.errors import FOUND

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from twin import ChainEntry, ElementDiff, TwinDiff

DATES_FROM_S = 1e8
"""Times above three years are no hours of a run: they count from 1970."""
JSON = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")


@click.group()
def command() -> None:
    """Show the history of a twin, compare revisions, and revert one.

    \b
    Example:
      hil twin log my_twin.r3.toml
      hil twin diff my_twin.r3.toml
      hil twin revert my_twin.r3.toml
    """


@command.command("log")
@click.argument("twin", type=INPUT_FILE)
@JSON
def log_command(twin: Path, as_json: bool) -> None:
    """List TWIN and its ancestors.

    Newest first, with the evidence of each revision. Exit code 1 if a file was edited after it was saved, so that its
    evidence no longer belongs to it.

    \b
    Example:
      hil twin log my_twin.r3.toml
    """
    from twin import chain

    entries = chain(twin)
    if as_json:
        click.echo(json.dumps([_entry(entry) for entry in entries], indent=1))
    else:
        _show_log(entries)
    if any(entry.faults for entry in entries):
        sys.exit(FOUND)


@command.command("diff")
@click.argument("a", type=INPUT_FILE)
@click.argument("b", type=INPUT_FILE, required=False)
@JSON
def diff_command(a: Path, b: Path | None, as_json: bool) -> None:
    """Report the changes from twin A to twin B.

    With A alone, from its parent to A. A difference is no fault: the exit code is 0.

    \b
    Example:
      hil twin diff my_twin.r3.toml
      hil twin diff my_twin.toml my_twin.r3.toml --json
    """
    from twin import TwinFileError, diff, load, parent_of

    if b is None:
        try:
            a, b = parent_of(a), a
        except TwinFileError as error:
            raise click.UsageError(f"{error}, or give the second file") from error
    found = diff(load(a), load(b))
    if as_json:
        document = {"from": str(a), "to": str(b), "same": found.empty, **dataclasses.asdict(found)}
        click.echo(json.dumps(document, indent=1))
    else:
        _show_diff(found, a, b)


@command.command("revert")
@click.argument("twin", type=INPUT_FILE)
def revert_command(twin: Path) -> None:
    """Undo revision TWIN by a new one.

    The new one has the content of the parent of TWIN; no file is changed or removed.

    \b
    Example:
      hil twin revert my_twin.r3.toml
    """
    from hil.run.session import console
    from twin import load, revert

    path = revert(twin, made_by="hil twin revert")
    out = console()
    for note in load(path).revision.notes:
        out.print(note, markup=False)
    out.print(f"written: {path}", soft_wrap=True, markup=False)


def _entry(entry: ChainEntry) -> dict[str, Any]:
    revision = entry.network.revision
    fields = {name: getattr(revision, name) for name in revision.__dataclass_fields__ if name != "checksum"}
    plain = {name: dict(value) if isinstance(value, Mapping) else value for name, value in fields.items()}
    return {
        "file": str(entry.path),
        "sha256": entry.network.digest,
        **plain,
        "remarks": entry.remarks,
        "faults": entry.faults,
    }


def _show_log(entries: tuple[ChainEntry, ...]) -> None:
    from hil.run.session import console

    out = console()
    title = "Revisions, newest first; RMSE in K of the worst sensor"
    headings = ("no.", "file", "made by", "sensor", "before", "after")
    table = _table(title, headings, numbers=("no.", "before", "after"))
    for entry in entries:
        revision = entry.network.revision
        errors = revision.error_before_K or revision.error_after_K
        worst = max(errors, key=lambda sensor: errors[sensor], default="")
        cells = (_kelvin(revision.error_before_K.get(worst)), _kelvin(revision.error_after_K.get(worst)))
        _row(table, str(revision.number), entry.path.name, revision.made_by, worst, *cells)
    out.print(table)
    for entry in entries:
        lines = _sentences(entry)
        if lines or entry.faults:
            out.print(entry.path.name, style="bold", markup=False)
        for line in lines:
            _indented(out, line, "")
        for line in entry.faults:
            _indented(out, line, "red")


def _sentences(entry: ChainEntry) -> list[str]:
    revision = entry.network.revision
    from twin import law_equations

    lines = [f"effect: {effect}" for effect in revision.effects]
    lines += [f"law {name}: {equation}" for name, equation in law_equations(entry.network).items()]
    lines += [f"evidence: {revision.evidence}"] if revision.evidence else []
    for what, span in (("fitted", revision.window_s), ("errors", revision.held_out_s)):
        if span is not None:
            lines.append(f"{what} over {_span(*span)}")
    if revision.record_file:
        lines.append(f"stored record: {revision.record_file}")
    return [*lines, *revision.notes, *entry.remarks]


def _span(start_s: float, end_s: float) -> str:
    """Return a segment of a record as hours from its start, or as dates where its times are seconds since 1970."""
    if start_s < DATES_FROM_S:
        return f"{start_s / 3600:.2f} to {end_s / 3600:.2f} h of the record"
    first, last = (f"{datetime.datetime.fromtimestamp(t, datetime.UTC):%Y-%m-%d %H:%M}" for t in (start_s, end_s))
    return f"{first} to {last} UTC"


def _show_diff(found: TwinDiff, a: Path, b: Path) -> None:
    from hil.run.session import console

    out = console()
    if found.empty:
        out.print(f"{a} and {b} describe the same twin", markup=False, soft_wrap=True)
        return
    out.print(f"from {a} to {b}", markup=False, soft_wrap=True)
    for what, pieces in (("added", found.added), ("removed", found.removed)):
        if pieces:
            out.print(_pieces(f"Elements {what}", pieces))
        for piece in pieces:
            if piece.equation:
                _indented(out, f"{piece.name}: {piece.equation}", "")
    if found.moved:
        numbers = ("before", "after", "change")
        table = _table("Parameters moved", ("parameter", *numbers, "unit"), numbers)
        for move in found.moved:
            change = "" if move.relative is None else f"{100.0 * move.relative:+.1f} %"
            _row(table, move.parameter, f"{move.before:.5g}", f"{move.after:.5g}", change, move.unit)
        out.print(table)
    if found.changed:
        table = _table("Everything else", ("key in the file", "before", "after"))
        for changed in found.changed:
            _row(table, changed.key.removeprefix("elements."), changed.before, changed.after)
        out.print(table)


def _pieces(title: str, pieces: tuple[ElementDiff, ...]) -> Table:
    table = _table(title, ("element", "kind", "where", "parameters"))
    for piece in pieces:
        where = "\n".join(f"{key} {value}" for key, value in piece.places.items())
        own = "\n".join(f"{p.name} {p.value:.5g} {p.unit}, {p.status}" for p in piece.parameters)
        _row(table, piece.name, piece.kind, where, own)
    return table


def _kelvin(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"


def _table(title: str, headings: tuple[str, ...], numbers: tuple[str, ...] = ()) -> Table:
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for heading in headings:
        table.add_column(heading, justify="right" if heading in numbers else "left", overflow="fold")
    return table


def _row(table: Table, *cells: str) -> None:
    from rich.text import Text

    table.add_row(*(Text(cell) for cell in cells))  # Brackets of a file name are no markup.


def _indented(out: Console, line: str, style: str) -> None:
    from rich.padding import Padding
    from rich.text import Text

    out.print(Padding(Text(line, style=style), (0, 0, 0, 2)))
