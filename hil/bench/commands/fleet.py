"""Command `hil bench fleet`: many records on one worker and on two."""

from __future__ import annotations

from pathlib import Path

import click

from hil.bench.commands.output import JSON, OUT, QUICK, SEED, finish


@click.command("fleet")
@click.option("--records", type=click.IntRange(min=2), help="Number of records to diagnose.  [default: 200]")
@QUICK
@SEED
@OUT
@JSON
def fleet_command(records: int | None, quick: bool, seed: int, out: Path | None, as_json: bool) -> None:
    """Diagnose the same records with one worker and with two, and compare the times.

    \b
    Example:
      hil bench fleet --quick
    """
    from hil.bench import fleet
    from hil.run.session import ProgressBar

    with ProgressBar("diagnosing", 1.0, quiet=as_json) as steps:
        tables = fleet.measure(records or (fleet.QUICK if quick else fleet.FULL), seed, steps.update)
    finish("fleet", seed, tables, (), out, as_json)
