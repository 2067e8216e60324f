"""`hil tower`: cooling towers, from a plant historian to a calibrated twin.

Verbs are loaded when they are asked for.
"""

from __future__ import annotations

import importlib

import click

VERBS = {
    "simulate": "Simulate stations of cooling towers with a historian",
    "serve": "Serve a station as a Modbus/TCP device",
    "collect": "Poll a rig's points into a historian",
    "align": "Make an aligned one-minute record of a historian's tags",
    "commission": "Fit the clean cell to its test points and write its twin file",
    "calibrate": "Calibrate cells on a record: deviations, intervals, gates, proposals",
    "report": "Print or write the report of a calibration",
    "plan": "Propose the next step test of a cell: the one that makes its deviations identifiable",
}
"""Verb and its summary; its command is in `hil.cli.tower_commands.<verb>`."""


class _TowerVerbs(click.Group):
    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(VERBS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in VERBS:
            return None
        command: click.Command = importlib.import_module(f"hil.cli.tower_commands.{name}").command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(VERBS.items()))


@click.group(cls=_TowerVerbs)
def command() -> None:
    """Cooling towers: from a plant historian to a calibrated twin.

    \b
    Example:
      hil tower align STORE --tags tags.csv --datasheet datasheet.json --out record
      hil tower commission record --cell 1 --datasheet datasheet.json --points commissioning.csv --out cell1.toml
      hil tower calibrate record --twin cell1.toml --out out
      hil tower report out
    """
