"""Command `hil fleet`: jobs over many rigs, records and seeds."""

from __future__ import annotations

import json
import os
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hil.cli.options import INPUT_FILE, on_workers
from hil.errors import FOUND

if TYPE_CHECKING:
    from hil.fleet import Fleet, FleetFolder, Job

INTERRUPTED = 130


@click.command()
@click.argument("file", type=INPUT_FILE, metavar="FLEET")
@on_workers
@click.option(
    "--workers",
    type=click.IntRange(1, 1024),
    help="Worker processes of --on local.  [default: the processors of this machine]",
)
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder for results, logs and the table.  [default: fleet-ID in the working directory]",
)
@click.option("--retry", is_flag=True, help="Run the jobs again that failed.")
@click.option("--status", is_flag=True, help="Only print the table of the results so far.")
@click.option("--cancel", is_flag=True, help="Only ask the command that works on the folder to stop.")
@click.option("--json", "as_json", is_flag=True, help="Print the table as JSON.")
def command(
    file: Path,
    place: dict[str, Any],
    workers: int | None,
    out: Path | None,
    retry: bool,
    status: bool,
    cancel: bool,
    as_json: bool,
) -> None:
    """Diagnose, track, train or bench over the rigs, records and seeds of FLEET, a TOML file.

    Each rig, record and seed is a job with one result. Finished jobs are not run again: after Ctrl-C, a crash or an
    edit of FLEET, the same command does what is left. The exit code is 1 if a job failed.

    Workers elsewhere are plain `dask worker` processes of the same version of hil. They need no file of this machine.

    \b
    Example:
      hil fleet night.toml
      hil fleet night.toml --on tcp://10.0.0.5:8786
      hil fleet night.toml --status
      hil fleet night.toml --retry
    """
    from hil.executor import LOCAL, ExecutorOptions, check_options
    from hil.fleet import FleetFolder, FleetRequest, jobs_of, read_fleet, run_fleet
    from hil.run.session import ProgressBar

    if status and cancel:
        raise click.UsageError("--status and --cancel exclude each other; give one of them")
    if workers is not None and place["on"] != LOCAL:
        raise click.UsageError(f"--workers is for --on local; the workers of {place['on']} are started there")
    fleet = read_fleet(file)
    folder = FleetFolder(out or Path(f"fleet-{fleet.id}"))
    if cancel:
        _cancel(folder)
        return
    if status:
        _status(fleet, folder, as_json)
        return
    options = ExecutorOptions(workers=workers or len(os.sched_getaffinity(0)), **place)
    check_options(options)
    jobs = jobs_of(fleet)
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)  # as a batch system ends a job
    try:
        with ProgressBar(fleet.id, float(len(jobs)), quiet=as_json) as bar:
            found = run_fleet(FleetRequest(fleet, jobs, folder.path, options, retry), bar.update, bar.print_line)
            bar.cut = found.cancelled
    finally:
        signal.signal(signal.SIGTERM, before)
    _show(fleet, folder, jobs, found.results, as_json)
    if found.cancelled:
        click.echo("cancelled; the same command does what is left", err=True)
        sys.exit(INTERRUPTED)
    if found.failed:
        sys.exit(FOUND)


def _show(
    fleet: Fleet, folder: FleetFolder, jobs: tuple[Job, ...], results: dict[str, dict[str, Any]], as_json: bool
) -> None:
    from hil.fleet import rows_of, show_table
    from hil.run.session import console

    if as_json:
        click.echo(json.dumps(rows_of(jobs, results), indent=1))
        return
    show_table(console(), jobs, results, fleet.title)
    console().print(f"results, logs and files: {folder.path}", markup=False, soft_wrap=True)


def _status(fleet: Fleet, folder: FleetFolder, as_json: bool) -> None:
    from hil.fleet import FleetError, jobs_of, known_results

    if folder.about() is None:
        raise FleetError(f"{folder.path} is no folder of a fleet; run the fleet first, or name its folder with --out")
    jobs = jobs_of(fleet)
    _show(fleet, folder, jobs, known_results(folder, jobs), as_json)


def _cancel(folder: FleetFolder) -> None:
    from hil.fleet import FleetError

    if folder.about() is None or not folder.is_held():
        raise FleetError(f"no command works on {folder.path}; there is nothing to cancel")
    folder.ask_to_cancel()
    click.echo(f"asked to stop: {folder.path}")
