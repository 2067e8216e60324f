"""Options of the commands that run twins with a rig or a record."""

from __future__ import annotations

import click

from hil.cli.options.paths import INPUT_CARD

CALIBRATORS = click.option(
    "--calibrator",
    "calibrators",
    multiple=True,
    help="Calibrator; may be repeated; default: pso, least_squares and, if one is trained for the twin, hiera_unet.",
)
NETWORK = click.option(
    "--network",
    "card",
    type=INPUT_CARD,
    metavar="CARD",
    help="Card (.json) of the ensemble of hiera_unet and hiera_ls, as `hil train` writes it; default: the shipped one.",
)
NETWORK_MODE = click.option(
    "--network-mode",
    type=click.Choice(("shadow", "advisory", "controlled")),
    default="shadow",
    show_default=True,
    help="Use of parameters that the network's gates accept: none, a line on the change, or "
    "the twin's next revision at the end.",
)
