"""Command `hil test`: a test plan on a live or a recorded run, and the matrix of requirements."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hil.cli.options import CALIBRATORS, INPUT_FILE, INPUT_PATH, VIRTUAL_RIG, label_options
from hil.cli.run_commands.run import address, as_json_document, mode_of

if TYPE_CHECKING:
    from hil.run.session import RunRequest
    from hil.testing import Plan


@click.command()
@click.argument("paths", metavar="PLAN | RUN...", nargs=-1, required=True, type=INPUT_PATH)
@click.option(
    "--on", "run", type=click.Path(exists=True, file_okay=False, path_type=Path), help="Judge a recorded run."
)
@click.option("--matrix", is_flag=True, help="Print requirements against the runs RUN..., which were judged before.")
@click.option("--rig", type=INPUT_FILE, help="Rig file; default: that of the plan, else the virtual rig's.")
@click.option("--twin", type=INPUT_FILE, help="Twin file; default: that of the plan, else of the rig file.")
@click.option("--no-twin", is_flag=True, help="Run without a twin; no limit may name one.")
@click.option(
    "--virtual",
    is_flag=True,
    help="Run on a virtual rig: the built-in one, or the devices of --rig as that file describes them.",
)
@click.option("--lockstep", is_flag=True, help="Run as fast as the machine can, reproducibly (virtual rig).")
@click.option("--speed", type=float, help="Factor to real time, up to 100 (virtual rig).")
@click.option("--control", help="host:port of a running `hil rig --mode lockstep`, which grants steps.")
@click.option("--with", "effects", type=INPUT_FILE, help="Effects that the twin does not model (virtual rig).")
@CALIBRATORS
@click.option(
    "--seed",
    type=click.IntRange(0),
    default=0,
    show_default=True,
    help="Seed of the virtual rig and of the calibrators.",
)
@click.option("--runs", type=click.Path(path_type=Path), default=Path("runs"), show_default=True, help="Parent folder.")
@click.option("--viewer/--no-viewer", default=None, help="Open Rerun live; default: if there is a display.")
@click.option("--rearm", is_flag=True, help="Acknowledge a trip that the rig has latched; find its cause before.")
@label_options
@click.option("--check-only", is_flag=True, help="Validate plan, rig, profile and limits, move nothing.")
@click.option("--json", "as_json", is_flag=True, help="Print verdict.json, or the matrix, as JSON.")
def command(
    paths: tuple[Path, ...],
    run: Path | None,
    matrix: bool,
    rig: Path | None,
    twin: Path | None,
    no_twin: bool,
    virtual: bool,
    lockstep: bool,
    speed: float | None,
    control: str | None,
    effects: Path | None,
    calibrators: tuple[str, ...],
    seed: int,
    runs: Path,
    viewer: bool | None,
    rearm: bool,
    test_object: str,
    serial_number: str,
    operator: str,
    tags: tuple[str, ...],
    check_only: bool,
    as_json: bool,
) -> None:
    """Run PLAN, a test plan, on a rig and judge its limits; with --on judge a recorded run.

    Exit code 0 means that every limit passed. The run folder gets verdict.json, junit.xml for other programs, and the
    verdict as the first section of report.html.

    \b
    Example:
      hil test profiles/tests/cooling_steps.toml --virtual --lockstep
      hil test profiles/tests/cooling_steps.toml --on runs/20260520T120000Z-cooling_steps
      hil test --matrix runs/*
    """
    if matrix:
        _show_matrix(paths, as_json)
    if len(paths) != 1:
        raise click.UsageError("give one test plan; further runs belong to --matrix")
    (plan,) = paths
    if run is not None:
        if virtual or lockstep or control is not None or effects is not None:
            raise click.UsageError("--on judges a recorded run, and moves no rig; take --virtual and the like out")
        _judge(plan, run, check_only, as_json)
    mode = mode_of(virtual=virtual, lockstep=lockstep, speed=speed, control=control)
    from hil.run.session import RunRequest
    from hil.run_folder import Labels
    from hil.testing import read_plan

    read = read_plan(plan)
    request = RunRequest(
        profile=_profile(read),
        rig=rig or read.rig or INPUT_FILE.convert(VIRTUAL_RIG, None, None),
        twin=twin or read.twin,
        use_twin=not no_twin,
        runs=runs,
        virtual=virtual,
        mode=mode,
        speed=1.0 if speed is None else speed,
        seed=seed,
        effects=effects,
        calibrators=calibrators or None,
        viewer=viewer,
        control=None if control is None else address(control),
        rearm=rearm,
        test=plan,
        labels=Labels(test_object, serial_number, operator, tags),
    )
    if check_only:
        _check(request)
    _run(replace(request, diagnose_s=math.inf) if read.needs_diagnosis else request, as_json)


def _profile(plan: Plan) -> Path:
    from hil.testing import TestPlanError

    if plan.profile is None:
        raise TestPlanError(
            f'{plan.path}: the plan names no profile to replay; add profile = "...", or judge a run with --on'
        )
    return plan.profile


def _check(request: RunRequest) -> None:
    from hil.run.session import check_session

    ready = check_session(request)
    assert ready.test is not None
    count = len(ready.test.limits)
    click.echo(f"{request.test}: {count} limits on {ready.rig.name} over {ready.profile.duration_s:g} s: ready to run")
    for note in ready.notes:
        click.echo(f"  {note}")
    sys.exit(0)


def _run(request: RunRequest, as_json: bool) -> None:
    """Run the test live, print its verdict, and end with the exit code."""
    from hil.cli.options import owns_process
    from hil.run.engine import RunSignals
    from hil.run.session import RunProgress, run_session, session_result
    from hil.run_folder import read_verdict
    from hil.testing import document_lines

    with RunSignals(until_exit=owns_process()) as signals:
        with RunProgress(quiet=as_json) as live:
            session = run_session(request, live.update, live.announce, signals)
            result = session_result(session, until_exit=owns_process())
        document = read_verdict(result.folder)
        if as_json:
            click.echo(json.dumps(document | {"run": as_json_document(result)}, indent=1))
        else:
            live.show_result(result)
            for line in document_lines(document):
                click.echo(line)
    sys.exit(result.exit_code_of_test(document))


def _judge(plan: Path, run: Path, check_only: bool, as_json: bool) -> None:
    """Judge a recorded run, print the verdict, and end with the exit code."""
    from hil.run.session import judge_recorded
    from hil.run_folder import RunFolder, read_verdict
    from hil.testing import document_lines, read_plan

    folder, read = RunFolder(run), read_plan(plan)
    if check_only:
        raise click.UsageError("--check-only is for a live run; leave it out")
    result = judge_recorded(read, folder)
    document = read_verdict(folder)
    if as_json:
        click.echo(json.dumps(document, indent=1))
    else:
        for line in document_lines(document, plan_id=read.id):
            click.echo(line)
        click.echo(f"report: {folder.report}")
    sys.exit(int(result.verdict != "pass"))


def _show_matrix(paths: tuple[Path, ...], as_json: bool) -> None:
    """Print the matrix of requirements against runs, and end with exit code 0 where all passed."""
    from hil.run_folder import RunFolder
    from hil.testing import requirement_matrix

    made = requirement_matrix([RunFolder(path) for path in paths])
    if as_json:
        click.echo(json.dumps(made.document(), indent=1))
    else:
        from rich.table import Table

        from hil.run.session import console

        table = Table(title="Requirements against runs", title_justify="left")
        for heading in ("requirement", "limits", *made.runs):
            table.add_column(heading, overflow="fold")
        for requirement, row in made.rows.items():
            table.add_row(
                made.heading(requirement), ", ".join(made.limits[requirement]), *(verdict or "-" for verdict in row)
            )
        console().print(table, markup=False)
    sys.exit(int(made.verdict != "pass"))
