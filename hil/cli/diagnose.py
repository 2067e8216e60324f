"""`hil diagnose`: why the twin was wrong, and the effect that it lacks."""

from __future__ import annotations

import json
import shlex
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hil.cli.options.paths import INPUT_FILE, INPUT_PATH
from hil.cli.options.reading import reading
from hil.errors import FOUND

if TYPE_CHECKING:
    from rich.console import Console

    from hil.diagnosis.session import Prepared, Written
    from hil.record.reader import Reading
    from twin.discovery.diagnosis import Diagnosis
    from twin.discovery.healthy.basis import Columns
    from twin.network import Network

STEPS = 6.0


@click.command()
@click.argument("target", type=INPUT_PATH, metavar="RUN|RECORD")
@click.option("--twin", type=INPUT_FILE, help="Twin file; of a run, the one that it ran with.")
@click.option(
    "--healthy", type=INPUT_FILE, help="Record of the rig in good order; by default the one that the twin kept."
)
@click.option("--no-healthy", is_flag=True, help="Take the noise floor from RECORD alone.")
@click.option("--with", "more", type=INPUT_FILE, multiple=True, help="A later record of the rig; may be repeated.")
@click.option(
    "--at-rest",
    is_flag=True,
    help="Each row of RECORD is a steady state, its time counts for nothing; every fourth is held out of every fit.",
)
@click.option("--rig", type=INPUT_FILE, help="Rig file whose limits a next experiment keeps; of a run, its own.")
@click.option("--clock", help="Time of day at 0 s of the record, like 08:00, where the record does not tell.")
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), help="Folder for the results.")
@click.option("--dry", is_flag=True, help="Propose only: no revision of the twin, no files.")
@click.option("--empirical", is_flag=True, help="Where nothing explains RECORD: adopt the curve that is offered.")
@click.option("--review", is_flag=True, help="Also write diagnosis.rrd, and open it where there is a display.")
@click.option("--forecast", is_flag=True, help="Only say what RECORD, or a load profile in its place, could show.")
@click.option(
    "--bootstrap",
    type=click.IntRange(min=10),
    metavar="DRAWS",
    help="First commission and diagnose so many healthy records drawn from the twin: thresholds by the whole pipeline.",
)
@reading
@click.option("--json", "as_json", is_flag=True, help="Print the diagnosis as JSON.")
def command(
    target: Path,
    twin: Path | None,
    healthy: Path | None,
    no_healthy: bool,
    more: tuple[Path, ...],
    at_rest: bool,
    rig: Path | None,
    clock: str | None,
    out: Path | None,
    dry: bool,
    empirical: bool,
    review: bool,
    forecast: bool,
    bootstrap: int | None,
    as_json: bool,
    choice: Reading,
) -> None:
    """Find the residual of RUN or RECORD, trace it to an effect that the twin lacks, and add that effect.

    Writes diagnosis.json, a page with pictures, and a new revision of the twin beside the old one. Exit code 0 where
    the twin is adequate, 1 where something was found.

    What is usual is told by the healthy record that `hil commission` kept beside the twin, or by --healthy; without
    either a commissioned twin is held against what its file says of its commissioning. A twin that never was
    commissioned is grown instead, on records of up to 4000 samples and on steady states (--at-rest): effects that are
    there from the beginning are added, in sets, in the order in which the record asks for them.

    \b
    Example:
      hil diagnose runs/<a run>
      hil diagnose campaign.parquet --twin my_twin.toml --healthy runs/<a healthy run>/record.parquet
      hil diagnose campaign.parquet --twin my_twin.toml --with experiment.parquet
      hil diagnose short_test.csv --twin first_guess.toml --with another_test.csv
      hil diagnose operating_points.csv --at-rest --twin first_guess.toml
      hil diagnose my_load.csv --forecast --twin my_twin.toml
      hil diagnose campaign.parquet --twin my_twin.toml --bootstrap 40
    """
    from hil.cli.options.subject import subject_of
    from hil.diagnosis.experiment_file import rig_of
    from hil.diagnosis.forecast import show_forecast
    from hil.diagnosis.session import DiagnosisRequest, described, diagnose_files, prepare, write_results
    from hil.run.session.terminal import console
    from twin.network import TwinFileError

    if at_rest and (healthy or more or forecast):
        raise click.UsageError("--at-rest goes without --healthy, --with and --forecast; put all states into one file")
    if healthy and no_healthy:
        raise click.UsageError("--no-healthy goes without --healthy: there is one or there is none")
    began = time.monotonic()
    subject = subject_of(target, twin)
    allowed = rig or (rig_of(target) if target.is_dir() else None)
    request = DiagnosisRequest(
        subject.record,
        subject.twin,
        healthy,
        use_healthy=not no_healthy,
        more=more,
        at_rest=at_rest,
        rig=allowed,
        clock=clock,
        choice=choice,
    )
    if bootstrap and (at_rest or no_healthy):
        raise click.UsageError("--bootstrap draws records like the healthy one: give it with --healthy")
    ready = prepare(request)
    if bootstrap and ready.healthy is None:
        raise click.UsageError("--bootstrap draws records like the healthy one: give it with --healthy")
    if forecast:
        show_forecast(console(), ready.network, subject.record, ready.healthy, ready.hour, as_json=as_json)
        return
    if bootstrap and ready.healthy is not None:
        _bootstrap(ready.network, ready.healthy, ready.healthy_file, bootstrap, quiet=as_json)
    found = _diagnosed(ready, diagnose_files, quiet=as_json)
    if empirical and found.verdict == "unexplained" and found.empirical is None:
        raise TwinFileError(f"{subject.record}: no curve of any column predicts what is unexplained; none to adopt")
    curve = empirical and found.empirical is not None
    folder = out or _folder(subject.run, target)
    written, extra = None, described(ready, None, began)
    if not dry:
        written, extra = write_results(ready, found, folder, empirical=curve, began=began)
    if as_json:
        click.echo(json.dumps({**found.document(), **extra}, indent=1))
    else:
        _report(console(), ready, found, written, target)
        console().print(f"{time.monotonic() - began:.1f} s")
    if review and not dry:
        _review(folder, quiet=as_json)
    if found.verdict != "adequate":
        sys.exit(FOUND)


def _folder(run: Path | None, target: Path) -> Path:
    """Return the folder for the results: that of the run, else one beside the working directory's files."""
    return run / "diagnosis" if run else Path(f"diagnosis-{target.absolute().parent.name}-{target.stem}")


def _diagnosed(ready: Prepared, diagnose: Callable[..., Diagnosis], *, quiet: bool) -> Diagnosis:
    """Diagnose, with a line for each stage."""
    from hil.run.session.terminal import Steps

    stages = 0
    with Steps("diagnosing", STEPS, quiet=quiet) as steps:

        def say(what: str) -> None:
            nonlocal stages
            stages += 1
            steps.update(min(float(stages), STEPS), what)

        return diagnose(ready, say, steps.say)


def _report(to: Console, ready: Prepared, found: Diagnosis, written: Written | None, target: Path) -> None:
    """Print the diagnosis, its files and the commands that follow."""
    from hil.diagnosis.terminal_report import print_diagnosis
    from hil.run.session.terminal import invocation

    print_diagnosis(to, found)
    request, revision = ready.request, written.revision if written else None
    if written and written.experiment:
        to.print(f"run it: {invocation()} run {written.experiment}", soft_wrap=True)
        healthy = f" --healthy {request.healthy}" if request.healthy else ""
        again = f"{invocation()} diagnose {target} --twin {request.twin}{healthy}"
        before = "".join(f" --with {path}" for path in request.more)
        to.print(f"then:   {again}{before} --with <the new run>/record.parquet", soft_wrap=True)
    if found.empirical is not None:
        to.print(f"offered, {'and adopted' if revision else 'not adopted'}: {found.empirical.says}", soft_wrap=True)
        if written and written.proposal and not revision:
            to.print(f"look at {written.proposal}; the same again with --empirical adopts it", soft_wrap=True)
    if ready.kept.path is not None:
        to.print(f"healthy reference: the record that the twin was commissioned on, {ready.kept.path}", soft_wrap=True)
    if revision:
        to.print(f"revision of the twin: {shlex.quote(str(revision))}", soft_wrap=True, markup=False)
    if written:
        to.print(f"page with pictures: {written.page}", soft_wrap=True)


def _bootstrap(network: Network, healthy: Columns, named: Path | None, draws: int, *, quiet: bool) -> None:
    """Draw, commission and diagnose healthy records, and keep what came of them for this and later diagnoses."""
    from hil.run.session.terminal import Steps
    from twin.discovery.bootstrap import bootstrap
    from twin.discovery.healthy.health import NotHealthyError
    from twin.discovery.healthy.widening import keep
    from twin.network import TwinFileError

    with Steps("drawing healthy records", float(draws), quiet=quiet) as steps:
        try:
            found = bootstrap(
                network,
                healthy,
                draws,
                done=lambda n: steps.update(float(n), f"{n} of {draws} commissioned, diagnosed"),
            )
        except NotHealthyError as error:
            raise TwinFileError(f"{named}: {error}") from None
    keep(found, network, healthy.time_s, healthy.inputs, healthy.measured)


def _review(folder: Path, *, quiet: bool) -> None:
    from hil.diagnosis.store import REVIEW
    from hil.review import has_display, show_review, write_findings_review
    from hil.run.session.terminal import console

    write_findings_review(folder, folder / REVIEW)
    if has_display():
        show_review(folder / REVIEW)
    else:
        console(quiet=quiet).print(f"for Rerun: {folder / REVIEW}", soft_wrap=True)
