"""Benchmarks of the twin: speed, fits, the paper's experiments, structure, public records."""

from __future__ import annotations

from pathlib import Path

import click

from hil.bench import EXPERIMENTS, RIGS
from hil.bench.commands.output import JSON, OUT, QUICK, SEED, data_folder, finish
from hil.cli.options import INPUT_FILE


@click.command("twin")
@QUICK
@SEED
@OUT
@JSON
def twin_command(quick: bool, seed: int, out: Path | None, as_json: bool) -> None:
    """Simulate a ten-minute window of the coolant loop with our kernel, scipy, numpy, torch, jax and C.

    \b
    Example:
      hil bench twin --quick
    """
    from hil.bench.kernel import speed

    tables, skipped = speed.measure(speed.QUICK if quick else speed.FULL, seed)
    finish("twin", seed, tables, skipped, out, as_json)


@click.command("fit")
@click.argument("record", required=False, type=click.Path(exists=True, path_type=Path))
@click.option("--twin", type=INPUT_FILE, help="Twin file for RECORD; default: the run folder's own.")
@QUICK
@SEED
@OUT
@JSON
def fit_command(
    record: Path | None, twin: Path | None, quick: bool, seed: int, out: Path | None, as_json: bool
) -> None:
    """Fit the same ten-minute windows with our calibrators and with other optimisers.

    With RECORD, a record or the folder of a run, windows of that are fitted too.

    \b
    Example:
      hil bench fit --quick
      hil bench fit runs/<a run>
    """
    from hil.bench.kernel import fit
    from hil.cli.options import subject_of
    from twin import load

    source = None
    if record is not None:
        subject = subject_of(record, twin)
        source = fit.MeasuredRecord(subject.record, load(subject.twin))
    tables, skipped = fit.measure(fit.QUICK if quick else fit.FULL, seed, source)
    finish("fit", seed, tables, skipped, out, as_json)


@click.command("paper")
@click.option("--only", multiple=True, type=click.Choice(EXPERIMENTS), help="Experiment; may be repeated.")
@click.option("--rig", "rigs", multiple=True, type=click.Choice(RIGS), help="Rig; may be repeated.")
@click.option("--calibrator", "calibrators", multiple=True, help="Calibrator; may be repeated; default: all.")
@click.option(
    "--cache",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("runs/bench"),
    show_default=True,
    help="Folder for records of the virtual rig.",
)
@QUICK
@SEED
@OUT
@JSON
def paper_command(
    only: tuple[str, ...],
    rigs: tuple[str, ...],
    calibrators: tuple[str, ...],
    cache: Path,
    quick: bool,
    seed: int,
    out: Path | None,
    as_json: bool,
) -> None:
    """Repeat the experiments of Energies 2026, 19, 2452, with its figures.

    Rigs: `virtual`, whose equations are not the twin's; `stranger`, recordings of another maker's in $HIL_DATA;
    `inverse`, synthesised by the twin itself, as in the paper.

    \b
    Example:
      hil bench paper --only modules_heat --rig virtual
    """
    from dataclasses import replace

    from hil.bench.experiments import paper
    from twin.calibrators import CALIBRATOR_NAMES

    unknown = [name for name in calibrators if name not in CALIBRATOR_NAMES]
    if unknown:
        raise click.UsageError(f"no calibrator {', '.join(unknown)}; there are {', '.join(CALIBRATOR_NAMES)}")
    size = paper.QUICK if quick else paper.FULL
    size = replace(
        size,
        experiments=only or size.experiments,
        rigs=rigs or size.rigs,
        calibrators=calibrators or size.calibrators,
    )
    tables, skipped = paper.measure(size, seed, cache, data_folder())
    finish("paper", seed, tables, skipped, out, as_json)


@click.command("structure")
@SEED
@OUT
@JSON
def structure_command(seed: int, out: Path | None, as_json: bool) -> None:
    """Measure the error of commissioned twins of four and ten volumes on healthy records of other rigs ($HIL_DATA).

    \b
    Example:
      hil bench structure
    """
    from hil.bench.experiments.structure import measure

    tables, skipped = measure(data_folder(), seed)
    finish("structure", seed, tables, skipped, out, as_json)


@click.command("records")
@SEED
@OUT
@JSON
def records_command(seed: int, out: Path | None, as_json: bool) -> None:
    """Fit public records of other rigs ($HIL_DATA), and compare with the published figures.

    \b
    Example:
      hil bench records
    """
    from hil.bench.experiments.public_tables import measure

    tables, skipped = measure(data_folder(), seed)
    finish("records", seed, tables, skipped, out, as_json)
