"""Command `hil bench`: speed, fits and the paper's experiments, with other tools and published figures."""

from __future__ import annotations

import os

import click

from hil.bench import BENCHMARKS
from hil.bench.commands.blind import (
    ablations_command,
    again_command,
    discovery_command,
    hiera_command,
    posterior_command,
)
from hil.bench.commands.effects import effects_command
from hil.bench.commands.fleet import fleet_command
from hil.bench.commands.governance import tower_governance_command
from hil.bench.commands.network import audit_command, tower_rivals_command, tower_rows_command
from hil.bench.commands.rig import bus_command, faults_command, files_command, loop_command, wire_command
from hil.bench.commands.sinks import sinks_command
from hil.bench.commands.tower import tower_command
from hil.bench.commands.twin import fit_command, paper_command, records_command, structure_command, twin_command
from hil.bench.commands.zoo import zoo_command
from hil.run.session import invocation


def _one_thread() -> None:
    """Limit numpy's and scipy's linear algebra to one thread, since idle threads count as CPU time. Call it before
    numpy loads.
    """
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(name, "1")


@click.group(invoke_without_command=True)
@click.pass_context
def command(context: click.Context) -> None:
    """Measure, and compare with other people's tools and published figures.

    \b
    Example:
      hil bench twin --quick
      hil bench paper --rig virtual --out results
    """
    _one_thread()
    if context.invoked_subcommand is None:
        for name, about in BENCHMARKS.items():
            click.echo(f"{invocation()} bench {name:<10} {about}")


for _bench in (
    twin_command,
    fit_command,
    paper_command,
    records_command,
    posterior_command,
    hiera_command,
    ablations_command,
    audit_command,
    discovery_command,
    again_command,
    zoo_command,
    effects_command,
    structure_command,
    tower_command,
    tower_governance_command,
    tower_rivals_command,
    tower_rows_command,
    faults_command,
    loop_command,
    bus_command,
    wire_command,
    files_command,
    fleet_command,
    sinks_command,
):
    command.add_command(_bench)
