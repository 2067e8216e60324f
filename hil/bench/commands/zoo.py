"""Command `hil bench zoo`: the diagnosis on random plants."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from hil.bench.commands.output import JOBS, JSON, OUT, QUICK, SEED, finish
from hil.cli.options import on_workers, workers_of

QUICK_CASES = (6, 2)
"""Cases with an effect and healthy ones of a trial run: one of each family for development."""


@click.command("zoo")
@click.option(
    "--families", type=click.Choice(["dev", "sealed"]), default="dev", show_default=True, help="Half of the families."
)
@click.option("--open-sealed", is_flag=True, help="Confirm that the sealed families are opened; the ledger notes it.")
@click.option("--cases", default=40, show_default=True, help="Number of records with a hidden effect.")
@click.option("--healthy", default=10, show_default=True, help="Number of records without one.")
@JOBS
@on_workers
@click.option(
    "--work",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("runs/bench/zoo"),
    show_default=True,
    help="Folder for finished cases.",
)
@QUICK
@SEED
@OUT
@JSON
def zoo_command(
    families: str,
    open_sealed: bool,
    cases: int,
    healthy: int,
    jobs: int | None,
    place: dict[str, Any],
    work: Path,
    quick: bool,
    seed: int,
    out: Path | None,
    as_json: bool,
) -> None:
    """Diagnose random plants, unlike any twin, with hidden effects and sealed answers.

    \b
    Example:
      hil bench zoo --quick
      hil bench zoo --families dev --cases 40 --healthy 10 --jobs 2 --out docs/results
      hil bench zoo --on tcp://10.0.0.5:8786
    """
    if families == "sealed" and not open_sealed:
        raise click.UsageError(
            "the sealed families are kept for one published figure; add --open-sealed to open them for it"
        )
    from hil.bench.zoo import tables, trial
    from hil.run.session import ProgressBar

    if quick:
        cases, healthy = QUICK_CASES
    with ProgressBar("diagnosing", 1.0, quiet=as_json) as steps:
        done = trial.measure(
            trial.TrialSize(families, cases, healthy, seed), jobs, work, workers_of(jobs, place), steps.update
        )
    finish("zoo_dev" if families == "dev" else "zoo", seed, tables.tables(done, families), (), out, as_json)
