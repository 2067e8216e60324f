"""Benches of what a trained network draws on, of its rivals, and of the acceptance rows of the tower paper."""

from __future__ import annotations

import math
from pathlib import Path

import click

from hil.bench.commands.output import JSON, OUT, QUICK, SEED, data_folder, finish
from hil.cli.options import INPUT_FILE, PROJECT

TRAINED, RESULTS = PROJECT / "profiles" / "trained", PROJECT / "docs" / "results"


@click.command("audit")
@click.option("--loop", "loop_card", type=INPUT_FILE, help="Card of the loop's ensemble.  [default: the shipped one]")
@click.option(
    "--tower", "tower_card", type=INPUT_FILE, help="Card of the tower's ensemble.  [default: the shipped one]"
)
@click.option("--subject", type=click.Choice(["loop", "tower"]), help="Audit this subject alone.  [default: both]")
@QUICK
@SEED
@OUT
@JSON
def audit_command(
    loop_card: Path | None,
    tower_card: Path | None,
    subject: str | None,
    quick: bool,
    seed: int,
    out: Path | None,
    as_json: bool,
) -> None:
    """Measure the known causes of a network's blindness: what its answers draw on, its losses, labels and corrections.

    Nothing is trained. The windows are of simulated plants; the tower's training stations are simulated anew.

    \b
    Example:
      hil bench audit --quick
      hil bench audit --out docs/results
    """
    from hil.bench import audit
    from hil.run.session import ProgressBar

    cards = {"loop": loop_card or TRAINED / "loop_small.json", "tower": tower_card or TRAINED / "tower_small.json"}
    loop, tower = (card if subject in (None, name) else None for name, card in cards.items())
    size = audit.QUICK if quick else audit.FULL
    with ProgressBar("subjects", 1.0, quiet=as_json) as steps:
        tables, skipped = audit.measure(size, seed, loop, tower, steps.update)
    finish("audit", seed, tables, skipped, out, as_json)


@click.command("tower-rivals")
@click.option(
    "--work",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("runs/bench/tower_rivals"),
    show_default=True,
    help="Folder for stations and finished trainings.",
)
@click.option("--seconds", type=click.FloatRange(0.1), help="Processor seconds of each training.  [default: 20]")
@click.option("--seeds", type=click.IntRange(1), help="Trainings of each contestant.  [default: 3]")
@click.option("--no-ablations", is_flag=True, help="Skip the Hiera-UNet without each of its parts.")
@click.option("--minutes", type=click.FloatRange(0.0), help="Processor minutes after which no training begins.")
@QUICK
@SEED
@OUT
@JSON
def tower_rivals_command(
    work: Path,
    seconds: float | None,
    seeds: int | None,
    no_ablations: bool,
    minutes: float | None,
    quick: bool,
    seed: int,
    out: Path | None,
    as_json: bool,
) -> None:
    """Train TCN, BiLSTM, temporal U-Net, flat transformer and Hiera-UNet alike; compare on stations that none saw.

    Each corrects the outlet of Gauss-Newton for the same processor time. An interrupted trial continues in --work.

    \b
    Example:
      hil bench tower-rivals --quick
      hil bench tower-rivals --out docs/results
    """
    from dataclasses import replace

    from hil.bench import rivals
    from hil.run.session import ProgressBar

    try:
        size = rivals.QUICK if quick else rivals.FULL
    except ImportError as error:
        raise click.ClickException("torch is not installed; install the extra ml") from error
    limits = rivals.Limits(not no_ablations, math.inf if minutes is None else minutes)
    size = replace(size, seconds=seconds or size.seconds, seeds=seeds or size.seeds)
    with ProgressBar("trainings", 1.0, quiet=as_json) as steps:
        tables, skipped = rivals.measure(size, seed, work, steps.update, limits)
    finish("tower_rivals", seed, tables, skipped, out, as_json)


@click.command("tower-rows")
@click.option(
    "--results",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    default=RESULTS,
    show_default="docs/results",
    help="Folder of published results (.json).",
)
@click.option("--no-measure", is_flag=True, help="Assemble published results alone, and measure nothing here.")
@SEED
@OUT
@JSON
def tower_rows_command(results: Path, no_measure: bool, seed: int, out: Path | None, as_json: bool) -> None:
    """List the acceptance rows A1 to A28 of the tower paper: its figure, our gate, our figure, reached or not.

    Figures come from published results. A few that cost minutes are measured here.

    \b
    Example:
      hil bench tower-rows --no-measure
      hil bench tower-rows --out docs/results
    """
    from hil.bench import acceptance
    from hil.run.session import ProgressBar

    with ProgressBar("measures", 1.0, quiet=as_json) as steps:
        say = None if no_measure else steps.update
        try:
            tables, skipped = acceptance.assemble(results, data_folder(), seed, say)
        except ValueError as error:
            raise click.ClickException(str(error)) from error
    finish("tower_rows", seed, tables, skipped, out, as_json)
