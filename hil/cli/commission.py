"""`hil commission`: fit a twin to a healthy record."""

from __future__ import annotations

import dataclasses
import json
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hil.cli.options.paths import INPUT_FILE, INPUT_PATH
from hil.cli.options.reading import reading

if TYPE_CHECKING:
    from hil.record.reader import Reading
    from twin.commission import CommissionOptions, CommissionResult


@click.command()
@click.argument("target", type=INPUT_PATH, metavar="RUN|RECORD")
@click.option("--twin", type=INPUT_FILE, help="Twin file to start from; it is not changed.")
@click.option("--datasheet", type=INPUT_FILE, help="A rig's datasheet.json: fills in --twin, or loop.toml.")
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), required=True, help="New twin file to write.")
@click.option("--seed", default=0, show_default=True, help="Seed of the fit's further starting points.")
@click.option(
    "--initial-sd", type=click.FloatRange(min=0.0, min_open=True), default=5.0, show_default=True, metavar="K",
    help="How firmly the state at the beginning is held to the first readings; 0.1 for a record that begins at rest.",
)  # fmt: skip
@reading
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def command(
    target: Path,
    twin: Path | None,
    datasheet: Path | None,
    out: Path,
    seed: int,
    initial_sd: float,
    as_json: bool,
    choice: Reading,
) -> None:
    """Fit the tunables of a twin to RUN or RECORD, a healthy one, and write them as a new revision.

    What the twin reads of it is kept beside it, as <OUT>.healthy.parquet: `hil diagnose` asks it what is usual.

    A fifth of the record, its end unless that alone shows some pump or fan speed, is kept out of the fit; errors before
    and after are of a free run over it. No twin is written where RECORD identifies none of the tunables, or where the
    fitted twin errs there by more than its sensors move at all.

    \b
    Example:
      hil commission runs/<a healthy run> --twin profiles/twins/loop.toml --out my_twin.toml
      hil commission commissioning.parquet --datasheet datasheet.json --out my_twin.toml
      hil commission commissioning.parquet --datasheet datasheet.json --twin profiles/twins/loop_six.toml --out my.toml
    """
    from hil.cli.options.subject import record_of
    from hil.diagnosis.healthy_record import beside, save_with_record
    from hil.files.names import printable
    from hil.record.reader import read_record
    from hil.record.values.units import beyond_declared
    from hil.run.session.terminal import console
    from twin.commission import commission
    from twin.commission_check import clock_warning, refusal_reason
    from twin.datasheet import from_datasheet
    from twin.network import TwinFileError
    from twin.twinfile import load

    if twin is None and datasheet is None:
        raise click.UsageError("give --twin, --datasheet or both: what the fit starts from")
    for path in (out, beside(out)):
        if path.exists():
            raise click.UsageError(f"{path} exists already; a twin is never overwritten, give --out another name")
    network = from_datasheet(datasheet, twin) if datasheet is not None else load(twin or "")
    record = record_of(target)
    data = read_record(record, choice=choice)
    data.require(*network.input_columns)
    try:
        inputs, measured = network.select(data.columns)
    except TwinFileError as error:
        raise TwinFileError(f"{record}: {error}") from None
    result = commission(
        network, data.time_s, inputs, measured,
        CommissionOptions(seed=seed, initial_sd=initial_sd, made_by=f"hil commission {printable(record.name)}"),
    )  # fmt: skip
    messages = (*data.messages, *beyond_declared(network, data.columns))
    if why := refusal_reason(result, measured):
        for message in messages:
            console(quiet=as_json).print(message, markup=False, soft_wrap=True)
        raise TwinFileError(f"{record}: no twin is written: {why}")
    if said := clock_warning(result):
        result = dataclasses.replace(result, notes=(*result.notes, said))
    kept = save_with_record(result.network, data, out)
    if as_json:
        click.echo(json.dumps(_document(result, out, kept), indent=1))
        return
    _show(result, messages, out, kept)


def _document(result: CommissionResult, out: Path, kept: Path) -> dict[str, object]:
    return {
        "twin": str(out),
        "healthy": str(kept),
        "values": dict(result.values),
        "interval90": {name: list(interval) for name, interval in result.interval90.items()},
        "cannot_tell": list(result.unidentifiable),
        "at_bound": list(result.at_bound),
        "held_out_s": list(result.held_out_s),
        "rmse_before_K": {name: _known(error) for name, error in result.rmse_before.items()},
        "rmse_after_K": {name: _known(error) for name, error in result.rmse_after.items()},
        "notes": list(result.notes),
    }


def _known(error: float) -> float | None:
    return error if isfinite(error) else None


def _show(result: CommissionResult, messages: tuple[str, ...], out: Path, kept: Path) -> None:
    from rich.table import Table

    from hil.record.times.time_axis import span
    from hil.run.session.terminal import console

    to = console()
    for message in messages:
        to.print(message, markup=False, soft_wrap=True)
    parameters = Table(title="Parameters", title_justify="left")
    for heading in ("parameter", "before", "after", "90 % interval", "unit", ""):
        parameters.add_column(heading, justify="left" if heading in ("parameter", "unit", "") else "right")
    for name, value in result.values.items():
        low, high = result.interval90[name]
        told = "the record cannot tell" if name in result.unidentifiable else ""
        if name in result.at_bound:
            told = "at its bound"
        unit = result.network.parameters[name].unit
        parameters.add_row(name, f"{result.start[name]:.4g}", f"{value:.4g}", f"{low:.4g} to {high:.4g}", unit, told)
    to.print(parameters)
    held = result.held_out_s
    part = f"free run from {span(held[0])} to {span(held[1])}"
    to.print(f"RMSE in K, {part}, which the fit never saw", style="italic", soft_wrap=True)
    errors = Table()
    for heading in ("sensor", "before", "after", "on the fitted part"):
        errors.add_column(heading, justify="left" if heading == "sensor" else "right")
    unread = [sensor for sensor, error in result.rmse_after.items() if not isfinite(error)]
    for sensor in result.rmse_after:
        cells = (result.rmse_before[sensor], result.rmse_after[sensor], result.rmse_fitted[sensor])
        if sensor not in unread:
            errors.add_row(sensor, *(f"{cell:.3f}" if isfinite(cell) else "none" for cell in cells))
    to.print(errors)
    if unread:
        to.print(f"without a reading there, so not in the table: {', '.join(unread)}", soft_wrap=True)
    for note in result.notes:
        to.print(note, markup=False, soft_wrap=True)
    to.print(f"written: {out}, and beside it the record for later: {kept.name}", soft_wrap=True)
