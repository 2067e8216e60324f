"""Command `hil ls`: the runs of a folder, a line each."""

from __future__ import annotations

import json
from pathlib import Path

import click


@click.command()
@click.argument("runs", type=click.Path(path_type=Path), default=Path("runs"))
@click.option("--tag", help="Show runs with this tag only.")
@click.option(
    "--verdict", type=click.Choice(("pass", "fail", "inconclusive")), help="Show runs with this verdict only."
)
@click.option("--json", "as_json", is_flag=True, help="Print the list as JSON.")
def command(runs: Path, tag: str | None, verdict: str | None, as_json: bool) -> None:
    """List the runs in the folder RUNS, oldest first: verdict, end, rig, duration, test object, tags.

    \b
    Example:
      hil ls
      hil ls /data/runs --tag endurance --verdict fail
    """
    from hil.comparison import run_summaries

    found = [
        summary
        for summary in run_summaries(runs)
        if (tag is None or tag in summary.tags) and (verdict is None or verdict == summary.verdict)
    ]
    if as_json:
        click.echo(json.dumps([summary.document() for summary in found], indent=1))
        return
    if not found:
        click.echo(_none(runs, tag, verdict), err=True)
        return
    from rich.table import Table

    from hil.run.session import console, hours

    table = Table(box=None, pad_edge=False)
    for heading in ("run", "verdict", "ended", "rig", "duration", "object", "serial", "tags", "notes"):
        table.add_column(heading, overflow="fold")
    for item in found:
        if item.problem:
            table.add_row(Path(item.folder).name, "-", "damaged")
            continue
        duration = "-" if item.duration_s is None else hours(item.duration_s)
        cells = (Path(item.folder).name, item.verdict or "-", item.exit_status, item.rig, duration)
        labels = (item.test_object, item.serial_number, ", ".join(item.tags), str(item.notes or ""))
        table.add_row(*cells, *labels)
    console().print(table)
    for item in found:
        if item.problem:
            click.echo(item.problem, err=True)


def _none(runs: Path, tag: str | None, verdict: str | None) -> str:
    """Return why there is nothing to list, with the remedy."""
    from hil.files import on_terminal

    place = on_terminal(str(runs))
    if (runs / "run.json").exists():
        return f"{place} is a run itself; give its parent, {on_terminal(str(runs.absolute().parent))}"
    if tag is not None or verdict is not None:
        return f"no run in {place} has this tag or verdict; leave --tag and --verdict out to list all"
    return f"{place} holds no run folder; give the parent of the runs"
