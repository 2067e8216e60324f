"""`hil diagnose`: why the twin was wrong, and the effect that it lacks."""

from __future__ import annotations

import dataclasses
import json
import shlex
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hil.cli.options.paths import INPUT_FILE, INPUT_PATH
from hil.cli.options.reading import reading
from hil.errors import FOUND

if TYPE_CHECKING:
    from rich.console import Console

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
    from hil.diagnosis.experiment_file import limits_of, rig_of, write_experiment
    from hil.diagnosis.forecast import foretell
    from hil.diagnosis.hand_over import (
        answer,
        clock_beside,
        clock_of,
        further_columns,
        provenance,
        read_columns,
        read_healthy,
        revise,
        with_clock,
        write,
        write_proposal,
    )
    from hil.diagnosis.healthy_record import Kept, commissioned_on
    from hil.run.session.terminal import Steps, console, invocation
    from twin.discovery.healthy.health import NotHealthyError
    from twin.discovery.records.grid import TooShortError
    from twin.network import TwinFileError
    from twin.twinfile import load

    if at_rest and (healthy or more or forecast):
        raise click.UsageError("--at-rest goes without --healthy, --with and --forecast; put all states into one file")
    if healthy and no_healthy:
        raise click.UsageError("--no-healthy goes without --healthy: there is one or there is none")
    began = time.monotonic()
    subject = subject_of(target, twin)
    folder = (
        subject.run / "diagnosis" if subject.run else Path(f"diagnosis-{target.absolute().parent.name}-{target.stem}")
    )
    folder = out or folder
    network = load(subject.twin)
    named, kept = healthy, Kept() if healthy or no_healthy or at_rest else commissioned_on(subject.twin)
    healthy = healthy or kept.path
    if bootstrap and not healthy:
        raise click.UsageError("--bootstrap draws records like the healthy one: give it with --healthy")
    hour = clock_of(clock) if clock else clock_beside(subject.record)
    told = with_clock(network) if hour is not None and not at_rest else network
    good = read_healthy(told, subject.twin, healthy, hour, choice if named else None) if healthy else None
    if forecast:
        foretell(console(), told, subject.record, good, hour, as_json=as_json)
        return
    if bootstrap and good is not None:
        _bootstrap(told, good, healthy, bootstrap, quiet=as_json)
    try:
        record, messages = read_columns(told, subject.record, hour, at_rest=at_rest, choice=choice)
    except TooShortError as error:
        raise TwinFileError(f"{error}; where each row is a steady state of its own, give --at-rest") from None
    allowed = rig or (rig_of(target) if target.is_dir() else None)
    limits = limits_of(allowed) if allowed is not None else None
    later = further_columns(told, more, hour, choice)
    stages = 0
    with Steps("diagnosing", STEPS, quiet=as_json) as steps:
        for message in messages:
            steps.say(message)

        def say(what: str) -> None:
            nonlocal stages
            stages += 1
            steps.update(min(float(stages), STEPS), what)

        try:
            diagnosis = answer(told, record, good, more=later, limits=limits, at_rest=at_rest, say=say)
        except NotHealthyError as error:
            raise TwinFileError(f"{healthy}: {error}") from None
        except TwinFileError as error:
            raise TwinFileError(f"{subject.record}: {error}") from None
    if kept.why:
        diagnosis = dataclasses.replace(diagnosis, notes=(kept.why, *diagnosis.notes))
    if empirical and diagnosis.verdict == "unexplained" and diagnosis.empirical is None:
        raise TwinFileError(
            f"{subject.record}: no curve of anything in it foretells what is unexplained; none to adopt"
        )
    curve = empirical and diagnosis.empirical is not None
    revision = None if dry else revise(diagnosis, network, subject.twin, subject.record, empirical=curve)
    extra: dict[str, object] = {
        "record": str(subject.record), "twin": str(subject.twin), "revision": str(revision) if revision else None,
        "healthy": str(healthy) if healthy else None, "seconds": round(time.monotonic() - began, 2),
    }  # fmt: skip
    planned = proposal = None
    if not dry:
        files = {"record": subject.record, "twin": subject.twin, "healthy record": healthy}
        files |= {f"later record {number}": path for number, path in enumerate(more, start=1)}
        extra["provenance"] = provenance(files)
        shown = write(diagnosis, told.sensor_names, folder, extra)
        extra["page"] = str(shown)
        proposal = write_proposal(diagnosis, network, subject.record, folder)
        planned = write_experiment(diagnosis, folder, allowed)
    if as_json:
        click.echo(json.dumps({**diagnosis.document(), **extra}, indent=1))
    else:
        to = console()
        _show(to, diagnosis)
        if planned:
            to.print(f"run it: {invocation()} run {planned}", soft_wrap=True)
            again = f"{invocation()} diagnose {target} --twin {subject.twin}" + (f" --healthy {named}" if named else "")
            before = "".join(f" --with {path}" for path in more)
            to.print(f"then:   {again}{before} --with <the new run>/record.parquet", soft_wrap=True)
        if diagnosis.empirical is not None:
            to.print(
                f"offered, {'and adopted' if revision else 'not adopted'}: {diagnosis.empirical.says}", soft_wrap=True
            )
            if proposal and not revision:
                to.print(f"look at {proposal}; the same again with --empirical adopts it", soft_wrap=True)
        if kept.path is not None:
            to.print(f"what is usual, from the record that the twin was commissioned on: {kept.path}", soft_wrap=True)
        if revision:
            to.print(f"revision of the twin: {shlex.quote(str(revision))}", soft_wrap=True, markup=False)
        if not dry:
            to.print(f"page with pictures: {shown}", soft_wrap=True)
        to.print(f"{time.monotonic() - began:.1f} s")
    if review and not dry:
        _review(folder, quiet=as_json)
    if diagnosis.verdict != "adequate":
        sys.exit(FOUND)


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


def _number(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 10_000.0 else f"{value:.4g}"


def _since(onset_s: float, d: Diagnosis) -> str:
    return f"{onset_s / 3600.0:.2f} h" if d.method == "contest" else "start"


def _show(to: Console, d: Diagnosis) -> None:
    from rich.table import Table

    from hil.diagnosis.table import error_table, errors_of, held_out
    from hil.diagnosis.wording import reasons

    document = d.document()
    for warning in d.warnings:
        to.print(f"warning: {warning}", style="yellow", soft_wrap=True)
    to.print(f"[bold]{d.verdict}[/bold]: {d.summary}", soft_wrap=True)
    for note in d.notes:
        to.print(note, soft_wrap=True)
    if d.effects:
        table = Table(title="Effects", title_justify="left")
        for heading in ("kind", "where", "driver", "change", "size", "90 %", "since", "z"):
            table.add_column(heading, justify="right" if heading in ("size", "90 %", "since", "z") else "left")
        for e in d.effects:
            low, high = e.interval90
            size = f"{_number(e.value)} {e.unit}".removesuffix(" 1")
            table.add_row(
                e.kind, e.where, e.driver, e.change, size, f"{_number(low)} to {_number(high)}",
                _since(e.onset_s, d), f"{e.z:.0f}",
            )  # fmt: skip
        to.print(table)
    for reason in reasons(document):
        to.print(reason, soft_wrap=True)
    if d.indistinguishable or d.alternatives:
        table = Table(title="Other explanations", title_justify="left")
        for heading in ("kind", "where", "driver", "why not"):
            table.add_column(heading)
        said = {(e.kind, e.where, e.driver) for e in d.effects}
        for a in d.indistinguishable:
            if (a.kind, a.where, a.driver) in said:
                continue
            table.add_row(a.kind, a.where, a.driver, "this record cannot tell it from the answer", style="bold")
        for a in d.alternatives[:8]:
            table.add_row(a.kind, a.where, a.driver, a.why_not)
        to.print(table)
    to.print(held_out(document), style="italic", soft_wrap=True)
    to.print(errors_of(document))
    for one in document["further_records"]:
        what = f"RMSE in K, free run over {one['record']}, which no effect was fitted to"
        to.print(what, style="italic", soft_wrap=True)
        to.print(error_table(one["sensors"], "with the effect" if d.network is not None else "re-tuned"))
    far = [m for m in d.moved if d.method == "contest" and max(abs(m.before_sd), abs(m.after_sd)) > 3.0]
    if far and d.effects:
        table = Table(title="Tunables that had to move, in standard deviations of commissioning", title_justify="left")
        for heading in ("parameter", "commissioned", "re-tuned alone", "beside the effect", "unit"):
            table.add_column(heading, justify="left" if heading in ("parameter", "unit") else "right")
        for m in far:
            table.add_row(
                m.parameter, f"{m.commissioned:.4g}", f"{m.before:.4g} ({m.before_sd:+.0f})",
                f"{m.after:.4g} ({m.after_sd:+.0f})", m.unit,
            )  # fmt: skip
        to.print(table)
    if d.next_experiment:
        to.print(f"next experiment: {d.next_experiment['why']}", soft_wrap=True)
        for alike in d.next_experiment.get("stay_alike", ()):
            measured = " or ".join(d.next_experiment["measure"])
            to.print(f"no input separates {alike}; {measured} would", soft_wrap=True)
    for spot in d.blind_spots:
        to.print(f"blind spot: {spot}", soft_wrap=True)
