"""`hil bench`: speed, fits and the paper's experiments, beside other people's tools and figures."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hil.bench import BENCHMARKS, EXPERIMENTS, RIGS
from hil.commands.paths import INPUT_FILE, PROJECT
from hil.terminal import invocation

if TYPE_CHECKING:
    from hil.bench.report import Table

OUT = click.option(
    "--out", type=click.Path(file_okay=False, path_type=Path), help="Also write JSON, Markdown and manifest there."
)
QUICK = click.option("--quick", is_flag=True, help="Small sizes, for a look or for CI.")
SEED = click.option("--seed", default=0, show_default=True, help="Seed of everything random.")
JSON = click.option("--json", "as_json", is_flag=True, help="Print the tables as JSON.")


def _one_thread() -> None:
    """One thread for numpy's and scipy's linear algebra, or its idle threads count as CPU time. Before numpy loads."""
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(name, "1")


def _data_folder() -> Path:
    return Path(os.environ.get("HIL_DATA", PROJECT.parent / "shared" / "data"))


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


def _finish(
    name: str, seed: int, tables: tuple[Table, ...], skipped: tuple[str, ...], out: Path | None, as_json: bool
) -> None:
    """Print the report, and write it where that was asked for."""
    from hil.bench.machine import manifest
    from hil.bench.report import Report, show, write
    from hil.bench.report import as_json as json_of

    report = Report(name, tables, skipped, manifest(_typed(name), seed))
    if as_json:
        click.echo(json_of(report), nl=False)
    else:
        show(report)
    if out is not None:
        for path in write(report, out):
            click.echo(str(path), err=True)


def _typed(name: str) -> str:
    """The command as it was typed, without the folders that it writes to."""
    if Path(sys.argv[0]).name not in ("hil", "__main__.py"):
        return f"hil bench {name}"
    words = sys.argv[1:]
    places = ("--out", "--work")
    kept = [w for i, w in enumerate(words) if not w.startswith(places) and (i == 0 or words[i - 1] not in places)]
    return " ".join(["hil", *kept])


@command.command("twin")
@QUICK
@SEED
@OUT
@JSON
def twin_command(quick: bool, seed: int, out: Path | None, as_json: bool) -> None:
    """One ten-minute window of the coolant loop: our kernel against scipy, numpy, torch, jax and C.

    \b
    Example:
      hil bench twin --quick
    """
    from hil.bench import speed

    tables, skipped = speed.measure(speed.QUICK if quick else speed.FULL, seed)
    _finish("twin", seed, tables, skipped, out, as_json)


@command.command("fit")
@click.argument("record", required=False, type=click.Path(exists=True, path_type=Path))
@click.option("--twin", type=INPUT_FILE, help="Twin file for RECORD; default: the run folder's own.")
@QUICK
@SEED
@OUT
@JSON
def fit_command(
    record: Path | None, twin: Path | None, quick: bool, seed: int, out: Path | None, as_json: bool
) -> None:
    """The same ten-minute windows fitted by our calibrators and by other people's optimisers.

    With RECORD, a record or the folder of a run, windows of that are fitted too.

    \b
    Example:
      hil bench fit --quick
      hil bench fit runs/<a run>
    """
    from hil.bench import fit
    from twin.twinfile import load

    source = None
    if record is not None:
        path = record / "record.parquet" if record.is_dir() else record
        file = twin or record / "twin.toml"
        if not file.is_file():
            raise click.UsageError(f"{record} brings no twin.toml; name a twin with --twin")
        source = fit.Record(path, load(file))
    tables, skipped = fit.measure(fit.QUICK if quick else fit.FULL, seed, source)
    _finish("fit", seed, tables, skipped, out, as_json)


@command.command("paper")
@click.option("--only", multiple=True, type=click.Choice(EXPERIMENTS), help="Experiment; may be repeated.")
@click.option("--rig", "rigs", multiple=True, type=click.Choice(RIGS), help="Rig; may be repeated.")
@click.option("--calibrator", "calibrators", multiple=True, help="May be repeated; default: all.")
@click.option(
    "--cache", type=click.Path(file_okay=False, path_type=Path), default=Path("runs/bench"), show_default=True,
    help="Records of the virtual rig are kept here.",
)  # fmt: skip
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
    """The experiments of Energies 2026, 19, 2452, beside its figures.

    Rigs: `virtual`, whose equations are not the twin's; `stranger`, recordings of another maker's in $HIL_DATA;
    `inverse`, synthesised by the twin itself, as in the paper.

    \b
    Example:
      hil bench paper --only modules_heat --rig virtual
    """
    from dataclasses import replace

    from hil.bench import paper
    from twin.calibrators import NAMES

    unknown = [name for name in calibrators if name not in NAMES]
    if unknown:
        raise click.UsageError(f"no calibrator {', '.join(unknown)}; there are {', '.join(NAMES)}")
    size = paper.QUICK if quick else paper.FULL
    size = replace(
        size,
        experiments=only or size.experiments,
        rigs=rigs or size.rigs,
        calibrators=calibrators or size.calibrators,
    )
    tables, skipped = paper.measure(size, seed, cache, _data_folder())
    _finish("paper", seed, tables, skipped, out, as_json)


@command.command("records")
@SEED
@OUT
@JSON
def records_command(seed: int, out: Path | None, as_json: bool) -> None:
    """Public records of other rigs ($HIL_DATA), beside the published figures.

    \b
    Example:
      hil bench records
    """
    from hil.bench.public import measure

    tables, skipped = measure(_data_folder(), seed)
    _finish("records", seed, tables, skipped, out, as_json)


@command.command("hiera")
@click.option("--network", type=INPUT_FILE, help="Card (.json) of a trained ensemble; without, it takes no part.")
@click.option("--rig", "rigs", multiple=True, help="simulated, virtual or stranger; may be repeated.")
@click.option("--calibrator", "calibrators", multiple=True, help="Of `hil track`; may be repeated; default: all.")
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
    """Who keeps a twin true on rigs that no network was trained on: swarm, least squares, filter, network.

    \b
    Example:
      hil bench hiera --quick
      hil bench hiera --network profiles/trained/loop_small.json --out docs/results
    """
    from dataclasses import replace

    from hil.bench import hiera
    from hil.bench.hiera_cases import RIGS as SCORED
    from hil.terminal import Steps
    from twin.calibrators import NAMES

    for what, given, known in (("rig", rigs, SCORED), ("calibrator", calibrators, NAMES)):
        unknown = [name for name in given if name not in known]
        if unknown:
            raise click.UsageError(f"no {what} {', '.join(unknown)}; there are {', '.join(known)}")
    size = hiera.QUICK if quick else hiera.FULL
    size = replace(size, rigs=rigs or size.rigs, trackers=calibrators or size.trackers)
    with Steps("cases", 1.0, quiet=as_json) as steps:
        tables, skipped = hiera.measure(size, seed, _data_folder(), steps.update, network)
    _finish("hiera", seed, tables, skipped, out, as_json)


@command.command("ablations")
@click.option(
    "--data", type=click.Path(exists=True, file_okay=False, path_type=Path), default=Path("training/loop"),
    show_default=True, help="Folder of generated campaigns, as `hil train loop` leaves it.",
)  # fmt: skip
@click.option("--config", "name", type=click.Choice(["small", "full"]), default="small", show_default=True)
@click.option("--minutes", default=5.0, show_default=True, help="CPU time of each training.")
@SEED
@OUT
@JSON
def ablations_command(data: Path, name: str, minutes: float, seed: int, out: Path | None, as_json: bool) -> None:
    """Train the network without each of its pieces, for the same CPU time, and compare on unseen windows.

    \b
    Example:
      hil bench ablations --minutes 5 --out docs/results
    """
    from hil.bench import hiera_ablations
    from hil.terminal import Steps
    from hil.training.data import read
    from hil.training.generate import features_of
    from twin.calibrators.hiera_unet.device import ready

    ready(threads=1)
    windows = read(data, features_of())
    with Steps("trainings", 1.0, quiet=as_json) as steps:
        tables, skipped = hiera_ablations.measure(windows, name, seed, minutes, steps.update)
    _finish("hiera_ablations", seed, tables, skipped, out, as_json)


@command.command("discovery")
@click.option("--blind", is_flag=True, help="Seal the truth and the answers before comparing them; always done.")
@click.option("--cases", default=40, show_default=True, help="Number of cases, a quarter of them healthy.")
@click.option("--case", "only", multiple=True, type=int, help="This case alone; may be repeated.")
@click.option("--healthy", default=0, show_default=True, help="Further records without any effect.")
@click.option("--healthy-case", "only_healthy", multiple=True, type=int, help="This healthy record alone.")
@click.option("--hours", default=24.0, show_default=True, help="Length of each record.")
@click.option(
    "--direct/--wire", default=True, show_default=True,
    help="Step the virtual rig's parts here, or run the loop over Modbus and CAN.",
)  # fmt: skip
@click.option("--twin", default="loop", show_default=True, help="Twin of profiles/twins to commission.")
@click.option(
    "--records", is_flag=True, help="Public records ($HIL_DATA) from twins that lack most, in place of the trial."
)
@click.option("--no-ablations", is_flag=True, help="Leave out the comparison with parts of the method left out.")
@click.option(
    "--work", type=click.Path(file_okay=False, path_type=Path), default=Path("runs/bench/discovery"),
    show_default=True, help="Finished cases are kept here.",
)  # fmt: skip
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
    hours: float,
    direct: bool,
    twin: str,
    records: bool,
    no_ablations: bool,
    work: Path,
    quick: bool,
    seed: int,
    out: Path | None,
    as_json: bool,
) -> None:
    """Blind trial: hidden effects in the virtual rig, answers sealed before the truth is opened, then scored.

    \b
    Example:
      hil bench discovery --blind --quick
      hil bench discovery --blind --case 17
      hil bench discovery --blind --cases 100 --healthy 300 --out docs/results
      hil bench discovery --records
    """
    if records:
        from hil.bench import discovery_records

        _finish("discovery_records", seed, *discovery_records.measure(_data_folder(), seed), out, as_json)
        return
    from hil.bench import discovery
    from hil.bench.discovery_tables import tables
    from hil.terminal import Steps

    numbers = only or (() if only_healthy else tuple(range(12 if quick else cases)))
    further = only_healthy or tuple(range(0 if only else healthy))
    size = discovery.Size(numbers, further, hours, direct, twin, not no_ablations)
    with Steps("diagnosing", 1.0, quiet=as_json) as steps:
        done = discovery.measure(size, seed, work, steps.update)
    _finish("discovery", seed, tables(done, size), discovery.left_out(), out, as_json)


@command.command("structure")
@SEED
@OUT
@JSON
def structure_command(seed: int, out: Path | None, as_json: bool) -> None:
    """How true commissioned twins of four and of ten volumes stay over forty healthy hours of other rigs ($HIL_DATA).

    \b
    Example:
      hil bench structure
    """
    from hil.bench.structure import measure

    tables, skipped = measure(_data_folder(), seed)
    _finish("structure", seed, tables, skipped, out, as_json)


@command.command("faults")
@click.option("--runs", default=200, show_default=True, type=click.IntRange(1), help="Number of faults, of all kinds.")
@click.option("--pairs", type=click.IntRange(1), help="Instead: so many pairs of faults, the second while one lasts.")
@click.option("--kind", "kinds", multiple=True, help="This kind alone; may be repeated.")
@click.option("--jobs", default=2, show_default=True, type=click.IntRange(1), help="Cases at a time, a rig each.")
@click.option(
    "--work", type=click.Path(file_okay=False, path_type=Path), default=Path("runs/bench/faults"), show_default=True,
    help="Finished cases are kept here.",
)  # fmt: skip
@SEED
@OUT
@JSON
def faults_command(
    runs: int,
    pairs: int | None,
    kinds: tuple[str, ...],
    jobs: int,
    work: Path,
    seed: int,
    out: Path | None,
    as_json: bool,
) -> None:
    """Faults of wires, rig and harness at random instants: is the heater off in time, is anything lost or wrong?

    Real time: some 15 s a fault. Exit code 1 where a must was broken.

    \b
    Example:
      hil bench faults --runs 32
      hil bench faults --kind "rig reboot" --runs 5
      hil bench faults --pairs 40
    """
    from hil.bench import faults
    from hil.bench.faults_kinds import KINDS
    from hil.terminal import Steps

    unknown = [kind for kind in kinds if kind not in KINDS]
    if unknown:
        raise click.UsageError(f"no kind {unknown[0]!r}; there are {', '.join(map(repr, KINDS))}")
    with Steps("faults", 1.0, quiet=as_json) as steps:
        two, count = pairs is not None, pairs or runs
        tables, skipped, kept = faults.measure(count, seed, work, steps.update, kinds=kinds, jobs=jobs, two=two)
    _finish("faults_pairs" if two else "faults", seed, tables, skipped, out, as_json)
    if not kept:
        sys.exit(1)


@command.command("loop")
@click.option(
    "--work", type=click.Path(file_okay=False, path_type=Path), default=Path("runs/bench/loop"),
    show_default=True, help="Its runs are kept here.",
)  # fmt: skip
@QUICK
@SEED
@OUT
@JSON
def loop_command(work: Path, quick: bool, seed: int, out: Path | None, as_json: bool) -> None:
    """The loop in real time at 10 Hz; its memory over 40 hours in lockstep; the same run killed and resumed.

    \b
    Example:
      hil bench loop --quick
      hil bench loop --out docs/results
    """
    from hil.bench import loop
    from hil.terminal import Steps

    with Steps("running", 1.0, quiet=as_json) as steps:
        tables, skipped = loop.measure(loop.QUICK if quick else loop.FULL, seed, work, steps.update)
    _finish("loop", seed, tables, skipped, out, as_json)


@command.command("bus")
@QUICK
@SEED
@OUT
@JSON
def bus_command(quick: bool, seed: int, out: Path | None, as_json: bool) -> None:
    """Round trips and latency of our Modbus client against raw sockets, pyModbusTCP, pymodbus and libmodbus.

    \b
    Example:
      hil bench bus --quick
    """
    from hil.bench import bus
    from hil.terminal import Steps

    with Steps("round trips", 1.0, quiet=as_json) as steps:
        tables, skipped = bus.measure(bus.QUICK if quick else bus.FULL, seed, steps.update)
    _finish("bus", seed, tables, skipped, out, as_json)


@command.command("wire")
@click.option("--count", type=click.IntRange(min=1), help="Mutations of each kind of wire.  [default: 100000]")
@QUICK
@SEED
@OUT
@JSON
def wire_command(count: int | None, quick: bool, seed: int, out: Path | None, as_json: bool) -> None:
    """Mutated Modbus replies and CAN frames, in memory: is a wrong value ever taken for a good one?

    \b
    Example:
      hil bench wire --quick
    """
    from hil.bench import wire
    from hil.terminal import Steps

    with Steps("mutations", 1.0, quiet=as_json) as steps:
        tables, skipped, kept = wire.measure(count or (wire.QUICK if quick else wire.FULL), seed, steps.update)
    _finish("wire", seed, tables, skipped, out, as_json)
    if not kept:
        sys.exit(1)
