"""Command `hil note`: notes on a run and its labels, also while it goes on."""

from __future__ import annotations

import getpass
from pathlib import Path

import click

from hil.cli.options import label_options


@click.command()
@click.argument("run", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.argument("text", default="")
@click.option("--by", default="", help="Name of the author; default: the user of this session.")
@label_options
def command(
    run: Path, text: str, by: str, test_object: str, serial_number: str, operator: str, tags: tuple[str, ...]
) -> None:
    """Add the note TEXT to RUN, a run folder, live or ended, or correct its labels.

    Notes are kept in order with time and author; none is changed later. `hil report RUN` shows them.

    \b
    Example:
      hil note runs/20260520T120000Z-battle_40h "coolant topped up, 0.2 L"
      hil note runs/20260520T120000Z-battle_40h --object "Pump unit B" --serial 0042 --tag endurance
    """
    from hil.run_folder import Labels, RunFolder, add_note

    labels = Labels(test_object, serial_number, operator, tags)
    note = add_note(RunFolder(run), text, by or _user(), labels)
    click.echo(f"{note.time} {note.by}: {note.text or 'labels: ' + ', '.join(note.labels)}")


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a user without an entry, as in a container
        return "unknown"
