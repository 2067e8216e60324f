"""Options of the verbs that run twins beside a rig or a record."""

from __future__ import annotations

import click

from hil.cli.options.paths import INPUT_FILE

CALIBRATORS = click.option(
    "--calibrator",
    "calibrators",
    multiple=True,
    help="May be repeated; default: pso, least_squares and, where there is one for the twin, the network hiera_unet.",
)
NETWORK = click.option(
    "--network",
    "card",
    type=INPUT_FILE,
    metavar="CARD",
    help="Card (.json) of the ensemble that hiera_unet and hiera_ls ask, as `hil train` writes it; default: the "
    "shipped one.",
)
NETWORK_MODE = click.option(
    "--network-mode",
    type=click.Choice(("shadow", "advisory", "controlled")),
    default="shadow",
    show_default=True,
    help="What becomes of parameters that the network's gates let through: nothing, a line on what would change, or "
    "the twin's next revision at the end.",
)
