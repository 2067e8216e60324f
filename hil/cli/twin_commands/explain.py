"""Command `hil explain`: settle an ambiguous diagnosis by experiments on the rig."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hil.cli.options import INPUT_FILE, INPUT_PATH, PROJECT, RECORD_FILE, VIRTUAL_RIG, reading
from hil.errors import FOUND

if TYPE_CHECKING:
    from hil.diagnosis import PreparedDiagnosis, Written
    from hil.explain import Experiment, RigChoice, Round
    from hil.record import ReadingOptions
    from hil.run.session import RunRequest, RunResult
    from twin.discovery import Diagnosis

STEPS = 6.0


@click.command()
@click.argument("target", type=INPUT_PATH, metavar="RUN|RECORD")
@click.option("--rig", type=INPUT_FILE, help="Rig file of the rig to run the experiments on; without it none is run.")
@click.option("--virtual", is_flag=True, help="Run the experiments on a virtual rig; default rig file: that of RUN.")
@click.option("--lockstep", is_flag=True, help="Run them as fast as the machine can, reproducibly (virtual rig).")
@click.option("--speed", type=float, help="Factor to real time, up to 100 (virtual rig).")
@click.option("--effects", type=INPUT_FILE, help="Effects of the virtual rig; default: those of RUN.")
@click.option("--seed", type=click.IntRange(0), help="Seed of the virtual rig; default: that of RUN.")
@click.option(
    "--rounds", type=click.IntRange(min=1), default=3, show_default=True, help="Most experiments in one folder."
)
@click.option("--yes", is_flag=True, help="Run each experiment without asking.")
@click.option("--twin", type=INPUT_FILE, help="Twin file; default for a run: the twin that it ran with.")
@click.option("--healthy", type=RECORD_FILE, help="Healthy record of the rig; default: the one stored with the twin.")
@click.option("--no-healthy", is_flag=True, help="Estimate the noise floor from RECORD alone.")
@click.option("--with", "more", type=INPUT_PATH, multiple=True, help="Later run or record of the rig; may be repeated.")
@click.option("--clock", help="Time of day at 0 s of the record, like 08:00, if the record does not state it.")
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), help="Folder for the results.")
@click.option(
    "--runs",
    type=click.Path(path_type=Path),
    default=Path("runs"),
    show_default=True,
    help="Parent folder of the runs.",
)
@click.option("--rearm", is_flag=True, help="Acknowledge a trip that the rig has latched; find its cause before.")
@click.option(
    "--no-guardian",
    is_flag=True,
    help="Run without a guardian: nothing makes the rig safe if this process is killed or hangs.",
)
@click.option("--no-lock", is_flag=True, help="Run even if locks do not keep a second run off this rig.")
@click.option("--viewer/--no-viewer", default=None, help="Open Rerun live; default: if there is a display.")
@reading
@click.option("--json", "as_json", is_flag=True, help="Print the explanation as JSON; needs --yes to run anything.")
def command(
    target: Path,
    rig: Path | None,
    virtual: bool,
    lockstep: bool,
    speed: float | None,
    effects: Path | None,
    seed: int | None,
    rounds: int,
    yes: bool,
    twin: Path | None,
    healthy: Path | None,
    no_healthy: bool,
    more: tuple[Path, ...],
    clock: str | None,
    out: Path | None,
    runs: Path,
    rearm: bool,
    no_guardian: bool,
    no_lock: bool,
    viewer: bool | None,
    as_json: bool,
    choice: ReadingOptions,
) -> None:
    """Diagnose RUN or RECORD; if the cause is ambiguous, run experiments on the rig until it is settled.

    Each round designs an experiment within the limits of the rig, shows it and asks. It then runs as with `hil run`,
    and the diagnosis is repeated with its record. The exit codes are those of `hil diagnose`.

    The same command again continues after the last finished round. Ctrl-C ends an experiment with the heater at its
    safe value. Without --rig the experiment is only designed; --with adds its record.

    A virtual rig has the effects of RUN, and its time continues from the end of RUN.

    \b
    Example:
      hil explain runs/<a run> --rig my_rig.toml
      hil explain runs/<a virtual run> --virtual --lockstep --yes
      hil explain runs/<a run>
      hil explain runs/<a run> --with runs/<the run of the experiment>
    """
    from hil.cli.options import owns_process, record_of, subject_of
    from hil.cli.tower_commands import is_tower
    from hil.diagnosis import DiagnosisRequest, rig_of
    from hil.explain import ExplainRequest, explain, print_explanation
    from hil.run.session import console, invocation

    if is_tower(target):
        raise click.UsageError(f"{target} is a record of a tower, on which no experiment can be run: hil diagnose it")
    if lockstep and speed is not None:
        raise click.UsageError("--lockstep and --speed exclude each other; choose one")
    if not virtual and (lockstep or speed is not None or effects is not None or seed is not None):
        raise click.UsageError("--lockstep, --speed, --effects and --seed are for the virtual rig; add --virtual")
    if healthy and no_healthy:
        raise click.UsageError("--no-healthy and --healthy exclude each other; give one of them")
    if as_json and (rig or virtual) and not yes:
        raise click.UsageError("with --json nobody is asked before an experiment; add --yes, or leave the rig out")
    subject = subject_of(target, twin)
    later = tuple(record_of(path) for path in more)
    own_rig = rig_of(target) if target.is_dir() else None
    driven = None
    if rig is not None or virtual:
        options = {
            "runs": runs,
            "virtual": virtual,
            "mode": "lockstep" if lockstep else "scaled" if speed is not None else "real",
            "speed": 1.0 if speed is None else speed,
            "seed": seed,
            "rearm": rearm,
            "guardian": not no_guardian,
            "no_lock": no_lock,
            "viewer": viewer,
        }
        driven = _rig(target, subject.record, rig or own_rig, effects, options, choice)
    folder = out or (target if target.is_dir() else Path()) / _folder_name(target)
    request = ExplainRequest(
        DiagnosisRequest(
            subject.record,
            subject.twin,
            healthy,
            use_healthy=not no_healthy,
            more=later,
            rig=driven.rig if driven else own_rig,
            clock=clock,
            choice=choice,
        ),
        folder,
        rounds,
        driven,
    )
    given = sys.argv[2:] if owns_process() else [str(target)]
    again = f"{invocation()} {shlex.join(['explain', *given])}"
    try:
        found = explain(request, _OperatorTerminal(as_json, yes))
    except KeyboardInterrupt:
        click.echo(f"interrupted; finished rounds are kept in {folder}. To go on: {again}", err=True)
        sys.exit(FOUND)
    if as_json:
        click.echo(json.dumps(found.model_dump(mode="json"), indent=1))
    else:
        print_explanation(console(), found, folder, again, _rig_options(target, own_rig))
    if found.last.verdict != "adequate":
        sys.exit(FOUND)


def _rig_options(target: Path, own: Path | None) -> str:
    """Return the options that name the rig of RUN; a virtual rig must be as old as RUN left it."""
    if _is_virtual(target):
        return "--virtual --lockstep"
    return f"--rig {shlex.quote(str(own)) if own else '<its rig file>'}"


def _is_virtual(target: Path) -> bool:
    from hil.run_folder import RunFolder

    # A folder with a record alone is a record, as for `hil diagnose`.
    if not (target / "run.json").is_file():
        return False
    return bool(RunFolder(target).read_manifest()["settings"].get("virtual", False))


def _folder_name(target: Path) -> str:
    return "explanation" if target.is_dir() else f"explanation-{target.absolute().parent.name}-{target.stem}"


def _rig(
    target: Path, record: Path, rig: Path | None, effects: Path | None, options: dict[str, Any], choice: ReadingOptions
) -> RigChoice:
    """Return the rig of the experiments; a virtual one as RUN left it: with its effects, seed and age.

    Raises
    ------
    click.UsageError
        RUN was made on a rig, and a virtual one was asked for, or the other way round.
    """
    from drivers.rig_file import file_sha256
    from hil.explain import ExplanationError, RigChoice
    from hil.record import read_record
    from hil.run_folder import RunFolder

    virtual, seed = options["virtual"], options.pop("seed")
    manifest = RunFolder(target).read_manifest() if (target / "run.json").is_file() else None
    settings = manifest["settings"] if manifest else {}
    if manifest is not None and virtual != _is_virtual(target):
        if virtual:
            raise click.UsageError(
                f"{target} was not made on a virtual rig, which has no fault of that rig; leave --virtual out, and "
                "name the rig with --rig"
            )
        raise click.UsageError(f"{target} was made on a virtual rig, whose effects no rig has; add --virtual")
    if not virtual:
        assert rig is not None
        if manifest is not None and manifest["files"].get("rig", {}).get("sha256") not in (None, file_sha256(rig)):
            click.echo(
                f"{rig} is not the rig file that {target} ran with: the experiment must be on the same rig", err=True
            )
        return RigChoice(rig, **options)
    if manifest is None and effects is None:
        click.echo(f"{target} states no effects: the virtual rig has none; --effects names them", err=True)
    if effects is None and manifest is not None and (hidden := manifest["files"].get("effects")) is not None:
        effects = _unchanged(Path(hidden["path"]), str(hidden["sha256"]), ExplanationError, target)
    time_s = read_record(record, choice=choice).time_s
    age_s = float(settings.get("start_s", 0.0)) + float(time_s[-1] - time_s[0])
    seed = int(settings.get("seed", 0)) if seed is None else seed
    return RigChoice(rig or PROJECT / VIRTUAL_RIG, effects=effects, seed=seed, age_s=age_s, **options)


def _unchanged(path: Path, digest: str, failure: type[Exception], run: Path) -> Path:
    """Return the effects file of a run; raise `failure` if it is not the one with which the run began."""
    from drivers.rig_file import file_sha256

    if not path.is_file():
        raise failure(f"{path}, the effects of {run}, is not there; give its place with --effects")
    if file_sha256(path) != digest:
        raise failure(f"{path} is not what it was when {run} began; put it back, or name the effects with --effects")
    return path


class _OperatorTerminal:
    """Operator at the terminal; with `quiet`, progress and reports are left out."""

    def __init__(self, quiet: bool, yes: bool) -> None:
        self._quiet = quiet
        self._yes = yes

    def diagnose(self, ready: PreparedDiagnosis, number: int) -> Diagnosis:
        """Diagnose, with a line for each stage."""
        from hil.diagnosis import diagnose_files
        from hil.run.session import ProgressBar

        stages = 0
        with ProgressBar(f"round {number}: diagnosing", STEPS, quiet=self._quiet) as steps:

            def say(what: str) -> None:
                nonlocal stages
                stages += 1
                steps.update(min(float(stages), STEPS), what)

            return diagnose_files(ready, say, steps.print_line)

    def show(self, ready: PreparedDiagnosis, found: Diagnosis, written: Written, one: Round) -> None:
        """Print verdict and summary of a round; its page has the rest."""
        self.note(f"round {one.number}: {one.verdict}: {one.summary}")
        for warning in found.warnings:
            self.note(f"warning: {warning}")
        self.note(f"page with pictures: {written.page}")

    def approve(self, experiment: Experiment, run: RunRequest, notes: Sequence[str]) -> bool:
        """Show the experiment and ask, unless --yes was given; the end of input is a no."""
        where = "a virtual rig" if run.virtual else f"the rig of {run.rig}"
        self.note(f"experiment {experiment.sentence}")
        self.note(experiment.why)
        self.note(f"as a load profile: {experiment.profile}")
        if self._yes:
            return True
        for note in notes:
            self.note(note)
        try:
            return click.confirm(f"Run it on {where} now?", default=False, err=True)
        except (click.Abort, OSError, RuntimeError):  # Ctrl-C, the end of the input, or no input at all
            click.echo("", err=True)
            self.note("no answer; --yes runs experiments without asking")
            return False

    def run(self, request: RunRequest) -> RunResult:
        """Carry the run out, with its progress and its result."""
        from hil.run.engine import RunSignals
        from hil.run.session import RunProgress, run_session, session_result

        # A diagnosis follows, which Ctrl-C must be able to end: signals are not held until the process exits.
        with RunSignals() as signals, RunProgress(quiet=self._quiet) as live:
            result = session_result(run_session(request, live.update, live.announce, signals))
        if not self._quiet:
            live.show_result(result)
        return result

    def note(self, text: str) -> None:
        """Print one line on standard error."""
        from hil.run.session import console

        console(stderr=True, quiet=self._quiet).print(text, soft_wrap=True, markup=False)
