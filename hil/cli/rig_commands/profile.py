"""Command `hil profile`: build load profiles from scenarios of ship systems."""

from __future__ import annotations

from pathlib import Path

import click

from hil.cli.options import INPUT_FILE


@click.group()
def command() -> None:
    """Build and draw load profiles.

    \b
    Example:
      hil profile build profiles/loads/battle.toml
    """


@command.command()
@click.argument("scenario", type=INPUT_FILE)
def build(scenario: Path) -> None:
    """Build the profiles and the figure that SCENARIO declares, in its folder.

    \b
    Example:
      hil profile build profiles/loads/battle.toml
    """
    from hil.profile import write_scenario

    for path in write_scenario(scenario):
        click.echo(str(path))
