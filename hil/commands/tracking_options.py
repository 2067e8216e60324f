"""Options of the verbs that run twins beside a rig or a record."""

from __future__ import annotations

import click

CALIBRATORS = click.option(
    "--calibrator",
    "calibrators",
    multiple=True,
    help="May be repeated; default: pso, least_squares and, where there is one for the twin, the network hiera_unet.",
)
NETWORK_MODE = click.option(
    "--network-mode",
    type=click.Choice(("shadow", "advisory", "controlled")),
    default="shadow",
    show_default=True,
    help="What becomes of parameters that the network's gates let through: nothing, a line on what would change, or "
    "the twin's next revision at the end.",
)
