"""Command `hil diagnose`: find the effect that a twin lacks."""

from __future__ import annotations

import json
import shlex
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hil.cli.options import INPUT_FILE, INPUT_PATH, RECORD_FILE, reading
from hil.errors import FOUND

if TYPE_CHECKING:
    from rich.console import Console

    from hil.diagnosis import PreparedDiagnosis, Written
    from hil.record import ReadingOptions
    from twin import Network
    from twin.discovery import Columns, Diagnosis

STEPS = 6.0


@click.command()
@click.argument("target", type=INPUT_PATH, metavar="RUN|RECORD")
@click.option(
    "--twin",
    "twins",
    type=INPUT_FILE,
    multiple=True,
    help="Twin file; default for a run: the twin that it ran with. Repeat it for the cells of a tower record.",
)
@click.option("--labels", type=INPUT_FILE, help="Inspections and certificates of a tower record's cells, CSV.")
@click.option("--healthy", type=RECORD_FILE, help="Healthy record of the rig; default: the one stored with the twin.")
@click.option("--no-healthy", is_flag=True, help="Estimate the noise floor from RECORD alone.")
@click.option("--with", "more", type=RECORD_FILE, multiple=True, help="Later record of the rig; may be repeated.")
@click.option(
    "--at-rest",
    is_flag=True,
    help="Take each row of RECORD as a steady state and ignore its time; every fourth is held out of every fit.",
)
@click.option(
    "--rig", type=INPUT_FILE, help="Rig file whose limits the next experiment keeps; default for a run: its own."
)
@click.option("--clock", help="Time of day at 0 s of the record, like 08:00, if the record does not state it.")
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), help="Folder for the results.")
@click.option("--units-checked", is_flag=True, help="Take the units of RECORD as right, whatever is asked about them.")
@click.option("--dry", is_flag=True, help="Propose only: write no revision of the twin and no files.")
@click.option(
    "--empirical", is_flag=True, help="If no effect explains RECORD: adopt the empirical curve that is offered."
)
@click.option("--review", is_flag=True, help="Also write diagnosis.rrd, and open it if there is a display.")
@click.option(
    "--forecast",
    is_flag=True,
    help="Only report the detectability of effects in RECORD, or in a load profile given in its place.",
)
@click.option(
    "--bootstrap",
    type=click.IntRange(min=10),
    metavar="DRAWS",
    help="First draw N healthy records from the twin, commission and diagnose each: the odds that a claim needs.",
)
@reading
@click.option("--json", "as_json", is_flag=True, help="Print the diagnosis as JSON.")
def command(
    target: Path,
    twins: tuple[Path, ...],
    labels: Path | None,
    healthy: Path | None,
    no_healthy: bool,
    more: tuple[Path, ...],
    at_rest: bool,
    rig: Path | None,
    clock: str | None,
    out: Path | None,
    units_checked: bool,
    dry: bool,
    empirical: bool,
    review: bool,
    forecast: bool,
    bootstrap: int | None,
    as_json: bool,
    choice: ReadingOptions,
) -> None:
    """Find the residual of RUN or RECORD, trace it to an effect that the twin lacks, and add that effect.

    Writes diagnosis.json, a page with figures, and a new revision of the twin in its folder. The exit code is 0 if
    the twin is adequate, 1 if an effect was found.

    The healthy reference is the record that `hil commission` stored beside the twin, or --healthy. Without either, a
    commissioned twin is compared with the commissioning statistics in its file. A twin that was never commissioned is
    grown instead, on records of up to 4000 samples and on steady states (--at-rest): effects that are present from the
    beginning are added, in sets, strongest evidence first.

    On an aligned record of a tower, a folder, effects that its cells' twins lack are named by mechanism and driver,
    with the outlet's error on held-out weeks before and after. It writes diagnosis.json and revisions, and no page.

    \b
    Example:
      hil diagnose runs/<a run>
      hil diagnose campaign.parquet --twin my_twin.toml --healthy runs/<a healthy run>/record.parquet
      hil diagnose campaign.parquet --twin my_twin.toml --with experiment.parquet
      hil diagnose short_test.csv --twin first_guess.toml --with another_test.csv
      hil diagnose operating_points.csv --at-rest --twin first_guess.toml
      hil diagnose my_load.csv --forecast --twin my_twin.toml
      hil diagnose campaign.parquet --twin my_twin.toml --bootstrap 40
      hil diagnose record --twin cell1.toml --twin cell2.toml --out diagnosis
    """
    from hil.cli.options import subject_of
    from hil.cli.tower_commands import diagnose_tower, is_tower

    if is_tower(target):
        others = {
            "--healthy": healthy,
            "--no-healthy": no_healthy,
            "--with": more,
            "--at-rest": at_rest,
            "--rig": rig,
            "--clock": clock,
            "--units-checked": units_checked,
            "--empirical": empirical,
            "--review": review,
            "--forecast": forecast,
            "--bootstrap": bootstrap,
        }
        diagnose_tower(target, twins, labels, out, dry, as_json, [name for name, value in others.items() if value])
        return
    if labels is not None:
        raise click.UsageError("--labels is for the aligned record of a tower; leave it out")
    if len(twins) > 1:
        raise click.UsageError("several --twin are for the cells of a tower's aligned record; give one")
    twin = twins[0] if twins else None
    from hil.diagnosis import (
        DiagnosisFolderError,
        DiagnosisRequest,
        described,
        diagnose_files,
        prepare,
        rig_of,
        show_forecast,
        write_results,
    )
    from hil.files import held, require_writable
    from hil.run.session import console
    from twin import TwinFileError

    if at_rest and (healthy or more or forecast):
        raise click.UsageError("--at-rest excludes --healthy, --with and --forecast; put all states into one file")
    if healthy and no_healthy:
        raise click.UsageError("--no-healthy and --healthy exclude each other; give one of them")
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
        units_checked=units_checked,
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
    folder = out or _folder(subject.run, target)
    if not dry:
        require_writable(folder, DiagnosisFolderError, "give another --out, or --dry to write nothing")
        click.get_current_context().with_resource(held(folder, DiagnosisFolderError))
    found = _diagnosed(ready, diagnose_files, quiet=as_json)
    unlisted = found.verdict == "unexplained" or found.own_course is not None
    if empirical and unlisted and found.empirical is None:
        raise TwinFileError(
            f"{subject.record}: no curve of any column predicts the unexplained error; there is none to adopt"
        )
    curve = empirical and found.empirical is not None
    written, extra, failure = None, described(ready, None, began), None
    if not dry:
        try:
            written, extra = write_results(ready, found, folder, empirical=curve, began=began)
        except (OSError, ValueError) as error:  # the verdict is printed in any case
            failure = error
    if as_json:
        click.echo(json.dumps({**found.document(), **extra}, indent=1))
    else:
        _report(console(), ready, found, written, target)
        console().print(f"{time.monotonic() - began:.1f} s")
    if failure is not None:
        raise failure
    if written is not None and written.unsaved:
        click.echo(f"no revision of the twin is saved: {written.unsaved}", err=True)
    if review and not dry:
        _review(folder, quiet=as_json)
    if found.verdict != "adequate":
        sys.exit(FOUND)


def _folder(run: Path | None, target: Path) -> Path:
    """Return the folder for the results: that of the run, or one in the working directory."""
    return run / "diagnosis" if run else Path(f"diagnosis-{target.absolute().parent.name}-{target.stem}")


def _diagnosed(ready: PreparedDiagnosis, diagnose: Callable[..., Diagnosis], *, quiet: bool) -> Diagnosis:
    """Diagnose, and print a line for each stage."""
    from hil.run.session import ProgressBar

    stages = 0
    with ProgressBar("diagnosing", STEPS, quiet=quiet) as steps:

        def say(what: str) -> None:
            nonlocal stages
            stages += 1
            steps.update(min(float(stages), STEPS), what)

        return diagnose(ready, say, steps.print_line)


def _report(to: Console, ready: PreparedDiagnosis, found: Diagnosis, written: Written | None, target: Path) -> None:
    """Print the diagnosis, its files and the next commands."""
    from hil.diagnosis import print_diagnosis
    from hil.run.session import invocation

    print_diagnosis(to, found)
    request, revision = ready.request, written.revision if written else None
    if written and written.experiment:
        run = f"{invocation()} run {shlex.quote(str(written.experiment))}"
        if request.rig is not None:
            run += f" --rig {shlex.quote(str(request.rig))}"
        elif not (request.record.parent / "run.json").is_file():
            run += " --rig <your rig file>"
        to.print(f"run it: {run}", soft_wrap=True)
        given = [str(target), "--twin", str(request.twin)]
        given += ["--healthy", str(request.healthy)] if request.healthy else []
        given += [word for path in request.more for word in ("--with", str(path))]
        again = f"{invocation()} {shlex.join(['diagnose', *given])} --with <the new run>/record.parquet"
        to.print(f"then:   {again}", soft_wrap=True)
    if found.empirical is not None:
        to.print(f"offered, {'and adopted' if revision else 'not adopted'}: {found.empirical.says}", soft_wrap=True)
        if written and written.proposal and not revision:
            to.print(f"see {written.proposal}; the same command with --empirical adopts it", soft_wrap=True)
    if ready.stored.path is not None:
        to.print(
            f"healthy reference: the record that the twin was commissioned on, {ready.stored.path}", soft_wrap=True
        )
    if revision:
        to.print(f"revision of the twin: {shlex.quote(str(revision))}", soft_wrap=True, markup=False)
    if written:
        to.print(f"page with pictures: {written.page}", soft_wrap=True)


def _bootstrap(network: Network, healthy: Columns, named: Path | None, draws: int, *, quiet: bool) -> None:
    """Draw, commission and diagnose healthy records, and store the results for this and later diagnoses."""
    from hil.run.session import ProgressBar
    from twin import TwinFileError
    from twin.discovery import NotHealthyError, bootstrap_claims, keep_bootstrap

    with ProgressBar("drawing healthy records", float(draws), quiet=quiet) as steps:
        try:
            found = bootstrap_claims(
                network,
                healthy,
                draws,
                done=lambda n: steps.update(float(n), f"{n} of {draws} commissioned, diagnosed"),
            )
        except NotHealthyError as error:
            raise TwinFileError(f"{named}: {error}") from None
    keep_bootstrap(found, network, healthy.time_s, healthy.inputs, healthy.measured)


def _review(folder: Path, *, quiet: bool) -> None:
    from hil.diagnosis import REVIEW
    from hil.review import has_display, show_review, write_findings_review
    from hil.run.session import console

    write_findings_review(folder, folder / REVIEW)
    if has_display():
        show_review(folder / REVIEW)
    else:
        console(quiet=quiet).print(f"for Rerun: {folder / REVIEW}", soft_wrap=True)
