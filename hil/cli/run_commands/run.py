"""Command `hil run`: replay a load profile on a rig while twins track it."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from hil.cli.options import CALIBRATORS, INPUT_FILE, NETWORK, NETWORK_MODE, RECORD_FILE, VIRTUAL_RIG, label_options

if TYPE_CHECKING:
    from hil.run.session import RunResult
    from hil.tracking import NetworkMode


@click.command()
@click.argument("profile", type=INPUT_FILE)
@click.option("--rig", "rig", type=INPUT_FILE, default=VIRTUAL_RIG, show_default=True, help="Rig file.")
@click.option("--twin", type=INPUT_FILE, help="Twin file; default: the twin that the rig file names.")
@click.option("--no-twin", is_flag=True, help="Run and record without a twin.")
@click.option(
    "--virtual",
    is_flag=True,
    help="Run on a virtual rig: the built-in one, or the devices of --rig as that file describes them.",
)
@click.option("--lockstep", is_flag=True, help="Run as fast as the machine can, reproducibly (virtual rig).")
@click.option("--speed", type=float, help="Factor to real time, up to 100 (virtual rig).")
@click.option("--control", help="host:port of a running `hil rig --mode lockstep`, which grants steps.")
@click.option("--rearm", is_flag=True, help="Acknowledge a trip that the rig has latched; find its cause before.")
@click.option(
    "--no-guardian",
    is_flag=True,
    help="Run without a guardian: nothing makes the rig safe if this process is killed or hangs.",
)
@click.option("--no-lock", is_flag=True, help="Run even if locks do not keep a second run off this rig.")
@click.option("--with", "effects", type=INPUT_FILE, help="Effects that the twin does not model (virtual rig).")
@CALIBRATORS
@NETWORK
@NETWORK_MODE
@click.option(
    "--seed",
    type=click.IntRange(0),
    default=0,
    show_default=True,
    help="Seed of the virtual rig and of the calibrators.",
)
@click.option("--runs", type=click.Path(path_type=Path), default=Path("runs"), show_default=True, help="Parent folder.")
@click.option("--viewer/--no-viewer", default=None, help="Open Rerun live; default: if there is a display.")
@click.option(
    "--diagnose",
    metavar="INTERVAL",
    help="Diagnose the whole run (end), and the record so far at an interval: hourly, 30min, 2h.",
)
@click.option("--healthy", type=RECORD_FILE, help="Healthy record of the rig, for --diagnose.")
@click.option("--adopt", is_flag=True, help="Save a confident finding of --diagnose as the twin's next revision.")
@click.option("--no-report", is_flag=True, help="Leave out review and report; `hil report` makes them afterwards.")
@label_options
@click.option("--check-only", is_flag=True, help="Validate everything, move nothing.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def command(
    profile: Path,
    rig: Path,
    twin: Path | None,
    no_twin: bool,
    virtual: bool,
    lockstep: bool,
    speed: float | None,
    control: str | None,
    rearm: bool,
    no_guardian: bool,
    no_lock: bool,
    effects: Path | None,
    calibrators: tuple[str, ...],
    card: Path | None,
    network_mode: NetworkMode,
    seed: int,
    runs: Path,
    viewer: bool | None,
    diagnose: str | None,
    healthy: Path | None,
    adopt: bool,
    no_report: bool,
    test_object: str,
    serial_number: str,
    operator: str,
    tags: tuple[str, ...],
    check_only: bool,
    as_json: bool,
) -> None:
    """Replay PROFILE on a rig while a static twin and tracked ones predict it.

    Ctrl-C ends the run with the heater at its safe value; a second Ctrl-C shortens the waits. `hil ctl` holds, pauses,
    resumes and aborts it from a second terminal.

    \b
    Example:
      hil run profiles/loads/battle_40h.csv --virtual --lockstep
      hil run my_load.csv --rig my_rig.toml --twin my_twin.toml
      hil run my_load.csv --virtual --lockstep --diagnose end
      hil run my_load.csv --virtual --lockstep --diagnose hourly --healthy runs/<a healthy run>/record.parquet
    """
    from hil.diagnosis import interval_of
    from hil.run.session import RunRequest, check_session, run_session
    from hil.run_folder import Labels

    mode = mode_of(virtual=virtual, lockstep=lockstep, speed=speed, control=control)
    if diagnose is None and (healthy is not None or adopt):
        raise click.UsageError("--healthy and --adopt belong to --diagnose; add --diagnose end, or hourly")
    request = RunRequest(
        profile=profile,
        rig=rig,
        twin=twin,
        use_twin=not no_twin,
        runs=runs,
        virtual=virtual,
        mode=mode,
        speed=1.0 if speed is None else speed,
        seed=seed,
        effects=effects,
        calibrators=calibrators or None,
        card=card,
        network_mode=network_mode,
        viewer=viewer,
        control=None if control is None else address(control),
        rearm=rearm,
        no_lock=no_lock,
        report=not no_report,
        diagnose_s=None if diagnose is None else interval_of(diagnose),
        healthy=healthy,
        adopt=adopt,
        guardian=not no_guardian,
        labels=Labels(test_object, serial_number, operator, tags),
    )
    if check_only:
        ready = check_session(request)
        click.echo(f"{profile}: {ready.profile.duration_s / 3600:.1f} h on {ready.rig.name}: ready to run")
        for note in ready.notes:
            click.echo(f"  {note}")
        return
    from hil.cli.options import owns_process
    from hil.run.engine import RunSignals
    from hil.run.session import RunProgress, session_result

    with RunSignals(until_exit=owns_process()) as signals:
        with RunProgress(quiet=as_json) as live:
            session = run_session(request, live.update, live.announce, signals)
            result = session_result(session, until_exit=owns_process())
        if as_json:
            click.echo(json.dumps(as_json_document(result), indent=1))
        else:
            live.show_result(result)
    if result.exit_code:
        sys.exit(result.exit_code)


def mode_of(
    *, virtual: bool, lockstep: bool, speed: float | None, control: str | None
) -> Literal["real", "scaled", "lockstep"]:
    """Return the mode that options ask for; raise click.UsageError if they exclude each other."""
    if lockstep and speed is not None:
        raise click.UsageError("--lockstep and --speed exclude each other; choose one")
    if control is not None and virtual:
        raise click.UsageError("--control and --virtual exclude each other; use the running rig or start a virtual one")
    return "lockstep" if lockstep or control is not None else "scaled" if speed is not None else "real"


def address(text: str) -> tuple[str, int]:
    """Return host and port of `host:port`; raise click.UsageError if it is none."""
    host, _, port = text.rpartition(":")
    if not host or not port.isdigit():
        raise click.UsageError(f"--control {text!r} is no host:port; give what `hil rig --mode lockstep` printed")
    return host, int(port)


def as_json_document(result: RunResult) -> dict[str, object]:
    """Return a finished run as plain data for scripts."""
    document: dict[str, object] = result.folder.read_manifest()
    document["folder"] = str(result.folder.path)
    return document
