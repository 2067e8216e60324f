"""Command `hil resume`: continue an interrupted run."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hil.cli.options import INPUT_CARD, INPUT_FILE, RECORD_FILE
from hil.cli.run_commands.run import address, as_json_document

if TYPE_CHECKING:
    from hil.run.session import RunRequest


@click.command()
@click.argument("run", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option(
    "--band",
    "band_K",
    type=click.FloatRange(0.0, min_open=True),
    default=1.0,
    show_default=True,
    help="Largest distance, K, of every temperature from its value at the interruption.",
)
@click.option(
    "--timeout",
    "timeout_s",
    type=click.FloatRange(0.0),
    default=7200.0,
    show_default=True,
    help="Time-out of the thermal restore, s of rig time.",
)
@click.option("--rig", type=INPUT_FILE, help="Path of the rig file, if it was moved.")
@click.option("--profile", type=INPUT_FILE, help="Path of the profile, if it was moved.")
@click.option("--twin", type=INPUT_FILE, help="Path of the twin, if it was moved.")
@click.option("--with", "effects", type=INPUT_FILE, help="Path of the effects of the virtual rig, if they were moved.")
@click.option("--healthy", type=RECORD_FILE, help="Path of the healthy record, if it was moved.")
@click.option(
    "--network", "card", type=INPUT_CARD, help="Path of the card of the run's trained network, if it was moved."
)
@click.option("--control", help="host:port of a running `hil rig --mode lockstep`, if it has changed.")
@click.option("--gap", help="Duration of the interruption, such as 12min, if this machine's clock is wrong.")
@click.option("--rearm", is_flag=True, help="Acknowledge a trip of the rig's own; find its cause before.")
@click.option(
    "--no-guardian",
    is_flag=True,
    help="Run without a guardian: nothing makes the rig safe if this process is killed or hangs.",
)
@click.option("--no-lock", is_flag=True, help="Run even if locks do not keep a second run off this rig.")
@click.option("--viewer/--no-viewer", default=None, help="Open Rerun live; default: if there is a display.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def command(
    run: Path,
    band_K: float,
    timeout_s: float,
    rig: Path | None,
    profile: Path | None,
    twin: Path | None,
    effects: Path | None,
    healthy: Path | None,
    card: Path | None,
    control: str | None,
    gap: str | None,
    rearm: bool,
    no_guardian: bool,
    no_lock: bool,
    viewer: bool | None,
    as_json: bool,
) -> None:
    """Continue RUN, a run folder, after a crash, a power cut, a fault or an abort.

    Rig file, profile and twin must be unchanged. The calibrators are restored from the journal. The rig is made safe,
    then heated and cooled until every temperature has stayed within --band of its value at the interruption for a
    minute (thermal restore). Only then does the profile continue, in the same folder. After --timeout the rig is left
    safe, and the run can be resumed again. The run of a test ends with its verdict, and with exit code 1 unless every
    limit passed.

    \b
    Example:
      hil resume runs/20260520T120000Z-battle_40h
      hil resume runs/20260520T120000Z-battle_40h --gap 2.5h
      hil resume runs/20260520T120000Z-battle_40h --band 2 --timeout 14400
    """
    from hil.cli.options import owns_process
    from hil.run.engine import RunSignals
    from hil.run.restore import RestoreRule, duration_s
    from hil.run.session import RunProgress, request_of, resume_notices, resume_session, session_result
    from hil.run_folder import RunFolder, read_verdict
    from hil.testing import document_lines

    folder = RunFolder(run)
    moved = {
        "rig": rig,
        "profile": profile,
        "twin": twin,
        "effects": effects,
        "healthy": healthy,
        "network": card,
    }
    gap_s = None if gap is None else duration_s(gap)
    where = None if control is None else address(control)

    def request(manifest: dict[str, Any]) -> RunRequest:
        return request_of(
            folder,
            manifest,
            moved,
            control=where,
            rearm=rearm,
            no_lock=no_lock,
            viewer=viewer,
            guardian=not no_guardian,
        )

    def name_rig(asked: RunRequest) -> None:
        for sentence in resume_notices(asked):
            click.echo(sentence, err=True)  # With --json, too.

    with RunSignals(until_exit=owns_process()) as signals:
        with RunProgress(quiet=as_json) as live:
            rule = RestoreRule(band_K, timeout_s)
            session = resume_session(
                folder, request, rule, live.update, live.announce, gap_s, name_rig, signals=signals
            )
            result = session_result(session, until_exit=owns_process())
        manifest = as_json_document(result)
        is_test = "test" in result.folder.read_manifest()["files"]
        judged = read_verdict(result.folder) if is_test else {"verdict": "pass", "tests": []}
        if as_json:
            click.echo(json.dumps(manifest | ({"tests": judged["tests"]} if is_test else {}), indent=1))
        else:
            live.show_result(result)
            for line in document_lines(judged):
                click.echo(line)
    if code := result.exit_code_of_test(judged):
        sys.exit(code)
