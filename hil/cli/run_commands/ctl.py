"""Command `hil ctl`: operator commands for a live run, from a second terminal."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import Any

import click

VERBS = ("status", "hold", "pause", "resume", "abort", "ack")


@click.command()
@click.argument("verb", type=click.Choice(VERBS))
@click.argument("run", required=False, type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--runs", type=click.Path(path_type=Path), default=Path("runs"), show_default=True, help="Parent folder.")
@click.option("--reason", default="", help="Reason, for the journal.")
@click.option("--json", "as_json", is_flag=True, help="Print the answer as JSON.")
def command(verb: str, run: Path | None, runs: Path, reason: str, as_json: bool) -> None:
    """Steer the live run in the folder RUN; without RUN, the only one under --runs.

    \b
    status   where the run is, temperatures, set-points, what has tripped
    hold     keep the outputs, stop the profile's clock
    pause    outputs to their safe values, stop the profile's clock
    resume   go on, back to the profile within the slew rates
    abort    end the run, outputs to their safe values
    ack      acknowledge what has tripped; refused while its cause lasts

    \b
    Example, in a second terminal:
      hil ctl status
      hil ctl pause --reason "topping up the tank"
      hil ctl resume
      hil ctl status runs/20260520T120000Z-battle_40h --json
    """
    from hil.run.engine import ask

    folder = _only_one(runs) if run is None else run
    answer = ask(folder / "control.sock", verb, f"{reason} (hil ctl)" if reason else "")
    if as_json:
        click.echo(json.dumps(answer | {"folder": str(folder)}, indent=1))
    elif verb == "status" and answer["ok"]:
        _show(folder, answer["status"])
    else:
        click.echo(answer["text"], err=not answer["ok"])
    if not answer["ok"]:
        sys.exit(1)


def _only_one(runs: Path) -> Path:
    from hil.run.engine import live_runs

    found = live_runs(runs)
    if len(found) == 1:
        return found[0]
    if not found:
        raise click.UsageError(f"no run is live under {runs}; name its folder, or its parent with --runs")
    raise click.UsageError(f"several runs are live; name one: {', '.join(map(str, found))}")


def _show(folder: Path, status: dict[str, Any]) -> None:
    from hil.run.session import hours

    click.echo(f"{status['state']}: {status['reason']}")
    if status["not_safe"]:
        click.echo(f"NOT SAFE: {status['not_safe']}")
    for level in ("trips", "warnings"):
        for sentence in status[level]:
            click.echo(f"{level.removesuffix('s')}: {sentence}")
    profile_s, duration_s, time_s = (hours(status[key]) for key in ("profile_s", "duration_s", "time_s"))
    click.echo(f"{profile_s} of {duration_s} of the profile, {time_s} since the start, in {folder}")
    units = status["units"]
    for title, key in (("set", "setpoints"), ("measured", "values")):
        cells = [_cell(name, value, units[name]) for name, value in status[key].items() if name in units]
        click.echo(_columns(title, cells))


def _cell(name: str, value: float | None, unit: str) -> str:
    said = "not known" if value is None else f"{value:.1f} {'°C' if unit == 'degC' else '' if unit == '1' else unit}"
    return f"{name} {said}".rstrip()


def _columns(title: str, cells: list[str]) -> str:
    """Format `title` and cells in as many columns as the terminal has room for."""
    width = max(map(len, cells), default=0) + 3
    count = max((shutil.get_terminal_size((100, 24)).columns - 11) // width, 1)
    lines = ("".join(cell.ljust(width) for cell in cells[k : k + count]) for k in range(0, len(cells), count))
    return "\n".join(f"{'' if k else title:<11}{line}".rstrip() for k, line in enumerate(lines))
