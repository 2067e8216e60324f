"""Blind benchmarks on unseen rigs: calibrators and their intervals, the network and its ablations, the diagnosis."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from hil.bench.commands.output import JOBS, JSON, OUT, QUICK, SEED, data_folder, finish
from hil.cli.options import INPUT_FILE, on_workers, workers_of


@click.command("hiera")
@click.option(
    "--network", type=INPUT_FILE, help="Card (.json) of a trained ensemble; without it the network takes no part."
)
@click.option("--rig", "rigs", multiple=True, help="Rig: simulated, virtual or stranger; may be repeated.")
@click.option(
    "--calibrator", "calibrators", multiple=True, help="Calibrator of `hil track`; may be repeated; default: all."
)
@QUICK
@SEED
@OUT
@JSON
def hiera_command(
    network: Path | None,
    rigs: tuple[str, ...],
    calibrators: tuple[str, ...],
    quick: bool,
    seed: int,
    out: Path | None,
    as_json: bool,
) -> None:
    """Compare calibrators on rigs that no network was trained on: swarm, least squares, filter, network.

    \b
    Example:
      hil bench hiera --quick
      hil bench hiera --network profiles/trained/loop_small.json --out docs/results
    """
    from dataclasses import replace

    from hil.bench.hiera import RIGS as SCORED
    from hil.bench.hiera import trial as hiera
    from hil.run.session import ProgressBar
    from twin.calibrators import CALIBRATOR_NAMES

    for what, given, known in (("rig", rigs, SCORED), ("calibrator", calibrators, CALIBRATOR_NAMES)):
        unknown = [name for name in given if name not in known]
        if unknown:
            raise click.UsageError(f"no {what} {', '.join(unknown)}; there are {', '.join(known)}")
    size = hiera.QUICK if quick else hiera.FULL
    size = replace(size, rigs=rigs or size.rigs, trackers=calibrators or size.trackers)
    with ProgressBar("cases", 1.0, quiet=as_json) as steps:
        tables, skipped = hiera.measure(size, seed, data_folder(), steps.update, network)
    finish("hiera", seed, tables, skipped, out, as_json)


@click.command("posterior")
@QUICK
@SEED
@OUT
@JSON
def posterior_command(quick: bool, seed: int, out: Path | None, as_json: bool) -> None:
    """Compare the calibrators' 90 % intervals with a posterior by Markov chain Monte Carlo, on twenty windows.

    It needs numpyro, which is in the extra `bench`.

    \b
    Example:
      hil bench posterior --quick
    """
    from hil.bench.posterior import trial
    from hil.run.session import ProgressBar

    size = trial.QUICK if quick else trial.FULL
    with ProgressBar("windows", 1.0, quiet=as_json) as steps:
        tables, skipped = trial.measure(size, seed, steps.update)
    finish("posterior", seed, tables, skipped, out, as_json)


@click.command("ablations")
@click.option(
    "--data",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    default=Path("training/loop"),
    show_default=True,
    help="Folder of generated campaigns, as `hil train loop` leaves it.",
)
@click.option("--config", "name", type=click.Choice(["small", "full"]), default="small", show_default=True)
@click.option("--minutes", default=5.0, show_default=True, help="CPU time of each training.")
@SEED
@OUT
@JSON
def ablations_command(data: Path, name: str, minutes: float, seed: int, out: Path | None, as_json: bool) -> None:
    """Train the network without each of its parts, for the same CPU time, and compare on held-out windows.

    \b
    Example:
      hil bench ablations --minutes 5 --out docs/results
    """
    from hil.bench.hiera import ablations as hiera_ablations
    from hil.run.session import ProgressBar
    from hil.training import features_of, read
    from twin.calibrators.hiera_unet.weights.device import ready

    ready(threads=1)
    windows = read(data, features_of())
    with ProgressBar("trainings", 1.0, quiet=as_json) as steps:
        tables, skipped = hiera_ablations.measure(windows, name, seed, minutes, steps.update)
    finish("hiera_ablations", seed, tables, skipped, out, as_json)


@click.command("discovery")
@click.option("--blind", is_flag=True, help="Seal the truth and the answers before their comparison; always done.")
@click.option("--cases", default=40, show_default=True, help="Number of cases, a quarter of them healthy.")
@click.option("--case", "only", multiple=True, type=int, help="Run only this case; may be repeated.")
@click.option("--healthy", default=0, show_default=True, help="Number of further records without any effect.")
@click.option("--healthy-case", "only_healthy", multiple=True, type=int, help="Run only this healthy record.")
@click.option(
    "--doubles", default=0, show_default=True, help="Number of further records with two effects of the catalogue."
)
@click.option("--double-case", "only_doubles", multiple=True, type=int, help="Run only this record with two effects.")
@click.option("--hours", default=24.0, show_default=True, help="Length of each record.")
@click.option(
    "--direct/--wire",
    default=True,
    show_default=True,
    help="Step the virtual rig's parts here, or run the loop over Modbus and CAN.",
)
@click.option("--twin", default="loop", show_default=True, help="Twin of profiles/twins to commission.")
@click.option(
    "--records", is_flag=True, help="Grow incomplete twins on public records ($HIL_DATA), in place of the trial."
)
@click.option("--no-healthy", is_flag=True, help="Keep the healthy records from the diagnosis.")
@click.option("--no-ablations", is_flag=True, help="Skip the ablations of the method.")
@JOBS
@on_workers
@click.option(
    "--work",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("runs/bench/discovery"),
    show_default=True,
    help="Folder for finished cases.",
)
@QUICK
@SEED
@OUT
@JSON
def discovery_command(
    blind: bool,
    cases: int,
    only: tuple[int, ...],
    healthy: int,
    only_healthy: tuple[int, ...],
    doubles: int,
    only_doubles: tuple[int, ...],
    hours: float,
    direct: bool,
    twin: str,
    records: bool,
    no_healthy: bool,
    no_ablations: bool,
    jobs: int | None,
    place: dict[str, Any],
    work: Path,
    quick: bool,
    seed: int,
    out: Path | None,
    as_json: bool,
) -> None:
    """Run a blind trial: hidden effects in the virtual rig, answers sealed before the truth is opened, then scored.

    \b
    Example:
      hil bench discovery --blind --quick
      hil bench discovery --blind --case 17
      hil bench discovery --blind --cases 100 --healthy 300 --out docs/results
      hil bench discovery --blind --cases 0 --doubles 40 --jobs 2
      hil bench discovery --on tcp://10.0.0.5:8786
      hil bench discovery --records
    """
    if records:
        from hil.bench.discovery import public_records as discovery_records

        finish("discovery_records", seed, *discovery_records.measure(data_folder(), seed), out, as_json)
        return
    from hil.bench.discovery import tables
    from hil.bench.discovery import trial as discovery
    from hil.run.session import ProgressBar

    alone = bool(only or only_healthy or only_doubles)
    numbers = only if alone else tuple(range(12 if quick else cases))
    further = only_healthy if alone else tuple(range(healthy))
    pairs = only_doubles if alone else tuple(range(doubles))
    size = discovery.TrialSize(numbers, further, hours, direct, twin, not no_ablations, pairs, not no_healthy)
    with ProgressBar("diagnosing", 1.0, quiet=as_json) as steps:
        done = discovery.measure(size, seed, jobs, work, workers_of(jobs, place), steps.update)
    finish("discovery", seed, tables.tables(done, size), discovery.left_out(), out, as_json)


@click.command("again")
@click.option("--cases", default=24, show_default=True, help="Number of rigs.")
@click.option("--hours", default=24.0, show_default=True, help="Length of each record.")
@click.option(
    "--work",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("runs/bench/again"),
    show_default=True,
    help="Folder for finished cases.",
)
@SEED
@OUT
@JSON
def again_command(cases: int, hours: float, work: Path, seed: int, out: Path | None, as_json: bool) -> None:
    """Diagnose later records with a revised twin: without a new effect, and with a second effect.

    \b
    Example:
      hil bench again --cases 4
      hil bench again --seed 1821 --out docs/results
    """
    from hil.bench.discovery import repeated as discovery_again
    from hil.run.session import ProgressBar

    with ProgressBar("diagnosing", 1.0, quiet=as_json) as steps:
        done = discovery_again.measure(cases, hours, seed, work, steps.update)
    finish("discovery_again", seed, discovery_again.tables(done, hours), (), out, as_json)
