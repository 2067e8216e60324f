"""`hil resume`: go on with a run that was cut."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hil.cli.options.paths import INPUT_FILE
from hil.cli.run import address, as_json_document

if TYPE_CHECKING:
    from hil.run.session.request import RunRequest


@click.command()
@click.argument("run", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--band", "band_K", type=click.FloatRange(0.0, min_open=True), default=1.0, show_default=True,
              help="So near, K, every temperature must come to where it was.")  # fmt: skip
@click.option("--timeout", "timeout_s", type=click.FloatRange(0.0), default=7200.0, show_default=True,
              help="Within so many seconds of rig time.")  # fmt: skip
@click.option("--rig", type=INPUT_FILE, help="Where the rig file lies now, if it was moved.")
@click.option("--profile", type=INPUT_FILE, help="Where the profile lies now.")
@click.option("--twin", type=INPUT_FILE, help="Where the twin lies now.")
@click.option("--with", "effects", type=INPUT_FILE, help="Where the effects of the virtual rig lie now.")
@click.option("--healthy", type=INPUT_FILE, help="Where the healthy record lies now.")
@click.option("--network", "card", type=INPUT_FILE, help="Where the card of the run's trained network lies now.")
@click.option("--control", help="host:port of a `hil rig --mode lockstep` that runs already, if it is another now.")
@click.option("--gap", help="How long the run has been down, such as 12min, where this machine's clock is wrong.")
@click.option("--rearm", is_flag=True, help="Acknowledge a trip of the rig's own; find its cause before.")
@click.option("--no-guardian", is_flag=True, help="Nobody makes the rig safe if this process is killed or hangs.")
@click.option("--no-lock", is_flag=True, help="Run even if locks do not keep a second run off this rig.")
@click.option("--viewer/--no-viewer", default=None, help="Open Rerun live; default: where there is a display.")
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
    """Go on with RUN, a folder of runs/, that a crash, a power cut, a fault or an abort stopped, when that is over.

    Rig file, profile and twin must be what they were. The calibrators are brought back from the journal. The rig is
    made safe, then heated and cooled until every temperature has stood within --band of where it was for a minute.
    Only then does the profile go on, in the same folder. Where that takes longer than --timeout the rig is left safe,
    and the run can be resumed again.

    \b
    Example:
      hil resume runs/20260520T120000Z-battle_40h
      hil resume runs/20260520T120000Z-battle_40h --gap 2.5h
      hil resume runs/20260520T120000Z-battle_40h --band 2 --timeout 14400
    """
    from hil.cli.options.own_process import owns_process
    from hil.run.engine.signals import RunSignals
    from hil.run.restore.gap_evidence import duration_s
    from hil.run.restore.thermal_restore import SoakRule
    from hil.run.session.event_loop import finished
    from hil.run.session.interrupted_run import named, request_of
    from hil.run.session.session import resume_session
    from hil.run.session.terminal import LiveRun
    from hil.run_folder.folder import RunFolder

    folder = RunFolder(run)
    moved = {
        "rig": rig, "profile": profile, "twin": twin, "effects": effects, "healthy": healthy, "network": card,
    }  # fmt: skip
    gap_s = None if gap is None else duration_s(gap)
    where = None if control is None else address(control)

    def request(manifest: dict[str, Any]) -> RunRequest:
        return request_of(
            folder, manifest, moved, control=where, rearm=rearm, no_lock=no_lock, viewer=viewer,
            guardian=not no_guardian,
        )  # fmt: skip

    def name_rig(asked: RunRequest) -> None:
        for sentence in named(asked):
            click.echo(sentence, err=True)  # with --json too

    with RunSignals(until_exit=owns_process()) as signals:
        with LiveRun(quiet=as_json) as live:
            rule = SoakRule(band_K, timeout_s)
            session = resume_session(
                folder, request, rule, live.update, live.announce, gap_s, name_rig, signals=signals
            )
            result = finished(session, until_exit=owns_process())
        if as_json:
            click.echo(json.dumps(as_json_document(result), indent=1))
        else:
            live.show_result(result)
    if result.exit_code:
        sys.exit(result.exit_code)
