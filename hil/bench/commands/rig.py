"""Benchmarks of the rig interface: faults, the loop's timing, the buses."""

from __future__ import annotations

import sys
from collections.abc import Collection, Iterable
from pathlib import Path

import click

from hil.bench.commands.output import JSON, OUT, QUICK, SEED, finish


@click.command("faults")
@click.option("--runs", default=200, show_default=True, type=click.IntRange(1), help="Number of faults, of all kinds.")
@click.option(
    "--pairs", type=click.IntRange(1), help="Number of pairs of faults instead, the second while the first lasts."
)
@click.option("--chaos", is_flag=True, help="Run attacks instead, alone and in pairs, half without the rig's watchdog.")
@click.option("--kind", "kinds", multiple=True, help="Run only this kind; may be repeated.")
@click.option(
    "--jobs",
    default=2,
    show_default=True,
    type=click.IntRange(1),
    help="Number of parallel cases, each with its own rig.",
)
@click.option(
    "--work",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("runs/bench/faults"),
    show_default=True,
    help="Folder for finished cases.",
)
@SEED
@OUT
@JSON
def faults_command(
    runs: int,
    pairs: int | None,
    chaos: bool,
    kinds: tuple[str, ...],
    jobs: int,
    work: Path,
    seed: int,
    out: Path | None,
    as_json: bool,
) -> None:
    """Inject faults of wires, rig and harness at random instants; measure time to safe, lost samples and wrong values.

    Each fault takes some 15 s of real time. The exit code is 1 if a requirement was broken.

    \b
    Example:
      hil bench faults --runs 32
      hil bench faults --kind "rig reboot" --runs 5
      hil bench faults --pairs 40
      hil bench faults --chaos --runs 500 --jobs 2
    """
    from hil.bench.faults import KINDS
    from hil.bench.faults import campaign as faults
    from hil.run.session import ProgressBar

    if chaos and pairs is not None:
        raise click.UsageError("--chaos and --pairs exclude each other: half of the chaos runs are pairs anyway")
    if chaos:
        _chaos(runs, kinds, jobs, work, seed, out, as_json)
        return
    _require_known(kinds, KINDS)
    with ProgressBar("faults", 1.0, quiet=as_json) as steps:
        two, count = pairs is not None, pairs or runs
        tables, skipped, kept = faults.measure(count, seed, work, steps.update, kinds=kinds, jobs=jobs, two=two)
    finish("faults_pairs" if two else "faults", seed, tables, skipped, out, as_json)
    if not kept:
        sys.exit(1)


def _chaos(
    runs: int, kinds: tuple[str, ...], jobs: int, work: Path, seed: int, out: Path | None, as_json: bool
) -> None:
    """Run the chaos campaign, and exit with 1 if a requirement was broken."""
    from hil.bench.chaos import CHAOS_KINDS
    from hil.bench.chaos import campaign as chaos
    from hil.run.session import ProgressBar

    _require_known(kinds, CHAOS_KINDS)
    with ProgressBar("chaos", 1.0, quiet=as_json) as steps:
        tables, skipped, kept = chaos.measure(runs, seed, work, steps.update, kinds=kinds, jobs=jobs)
    finish("chaos", seed, tables, skipped, out, as_json)
    if not kept:
        sys.exit(1)


def _require_known(kinds: Iterable[str], known: Collection[str]) -> None:
    """Raise UsageError for an unknown kind."""
    unknown = [kind for kind in kinds if kind not in known]
    if unknown:
        raise click.UsageError(f"no kind {unknown[0]!r}; there are {', '.join(map(repr, known))}")


@click.command("loop")
@click.option(
    "--work",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("runs/bench/loop"),
    show_default=True,
    help="Folder for its runs.",
)
@QUICK
@SEED
@OUT
@JSON
def loop_command(work: Path, quick: bool, seed: int, out: Path | None, as_json: bool) -> None:
    """Measure the loop in real time at 10 Hz, its memory over 40 hours in lockstep, and a killed and resumed run.

    \b
    Example:
      hil bench loop --quick
      hil bench loop --out docs/results
    """
    from hil.bench.loop import timing as loop
    from hil.run.session import ProgressBar

    with ProgressBar("running", 1.0, quiet=as_json) as steps:
        tables, skipped = loop.measure(loop.QUICK if quick else loop.FULL, seed, work, steps.update)
    finish("loop", seed, tables, skipped, out, as_json)


@click.command("bus")
@QUICK
@SEED
@OUT
@JSON
def bus_command(quick: bool, seed: int, out: Path | None, as_json: bool) -> None:
    """Measure round trips and latency of our Modbus client, raw sockets, pyModbusTCP, pymodbus and libmodbus.

    \b
    Example:
      hil bench bus --quick
    """
    from hil.bench.loop import bus
    from hil.run.session import ProgressBar

    with ProgressBar("round trips", 1.0, quiet=as_json) as steps:
        tables, skipped = bus.measure(bus.QUICK if quick else bus.FULL, seed, steps.update)
    finish("bus", seed, tables, skipped, out, as_json)


@click.command("wire")
@click.option(
    "--count", type=click.IntRange(min=1), help="Number of mutations of each kind of wire.  [default: 100000]"
)
@QUICK
@SEED
@OUT
@JSON
def wire_command(count: int | None, quick: bool, seed: int, out: Path | None, as_json: bool) -> None:
    """Read mutated Modbus replies and CAN frames, in memory, and count wrong values accepted as good.

    \b
    Example:
      hil bench wire --quick
    """
    from hil.bench.fuzz import wire
    from hil.run.session import ProgressBar

    with ProgressBar("mutations", 1.0, quiet=as_json) as steps:
        tables, skipped, kept = wire.measure(count or (wire.QUICK if quick else wire.FULL), seed, steps.update)
    finish("wire", seed, tables, skipped, out, as_json)
    if not kept:
        sys.exit(1)


@click.command("files")
@click.option("--count", type=click.IntRange(min=1), help="Number of mutations of each kind of file.  [default: 20000]")
@QUICK
@SEED
@OUT
@JSON
def files_command(count: int | None, quick: bool, seed: int, out: Path | None, as_json: bool) -> None:
    """Read mutated rig files, twins, tables, configurations, DBCs, cards and journals, and count unclear refusals.

    \b
    Example:
      hil bench files --quick
    """
    from hil.bench.fuzz import tables as files
    from hil.run.session import ProgressBar

    with ProgressBar("mutations", 1.0, quiet=as_json) as steps:
        tables, skipped, kept = files.measure(count or (files.QUICK if quick else files.FULL), seed, steps.update)
    finish("files", seed, tables, skipped, out, as_json)
    if not kept:
        sys.exit(1)
