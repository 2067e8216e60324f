"""Command `hil commission`: fit a twin to a healthy record."""

from __future__ import annotations

import dataclasses
import json
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hil.cli.options import INPUT_FILE, INPUT_PATH, reading

if TYPE_CHECKING:
    from hil.record import ReadingOptions
    from twin import CommissionResult


@click.command()
@click.argument("target", type=INPUT_PATH, metavar="RUN|RECORD")
@click.option("--twin", type=INPUT_FILE, help="Twin file to start from; it is not changed.")
@click.option(
    "--datasheet",
    type=INPUT_FILE,
    help="Datasheet of a rig (datasheet.json): sets the values of --twin, or of loop.toml.",
)
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), required=True, help="New twin file to write.")
@click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of the fit's further starting points."
)
@click.option(
    "--initial-sd",
    type=click.FloatRange(min=0.0, min_open=True),
    default=5.0,
    show_default=True,
    metavar="K",
    help="Tightness of the prior on the initial state at the first readings; 0.1 for a record that begins at rest.",
)
@click.option("--units-checked", is_flag=True, help="Take the units of RECORD as right, whatever is asked about them.")
@reading
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def command(
    target: Path,
    twin: Path | None,
    datasheet: Path | None,
    out: Path,
    seed: int,
    initial_sd: float,
    units_checked: bool,
    as_json: bool,
    choice: ReadingOptions,
) -> None:
    """Fit the tunables of a twin to a healthy RUN or RECORD, and write them as a new revision.

    The record that the fit reads is stored beside the twin, as <OUT>.healthy.parquet, the healthy reference of `hil
    diagnose`.

    A fifth of the record is the held-out segment: its end, unless only the end shows some pump or fan speed. Errors
    before and after are of a free run over it. No twin is written if RECORD identifies none of the tunables, if a
    constant predicts most sensors as well as the fitted twin, or while a question about units is open.

    \b
    Example:
      hil commission runs/<a healthy run> --twin profiles/twins/loop.toml --out my_twin.toml
      hil commission commissioning.parquet --datasheet datasheet.json --out my_twin.toml
      hil commission commissioning.parquet --datasheet datasheet.json --twin profiles/twins/loop_six.toml --out my.toml
    """
    from hil.cli.options import record_of
    from hil.diagnosis import columns_in_use, healthy_path, save_with_record, without_stuck
    from hil.files import printable
    from hil.record import read_record
    from hil.record.values import beyond_declared, open_questions
    from hil.run.session import console
    from hil.run_folder import RunFolderError, require_output
    from twin import CommissionOptions, TwinFileError, clock_warning, commission, from_datasheet, load, refusal_reason

    if twin is None and datasheet is None:
        raise click.UsageError("give --twin, --datasheet or both; the fit starts from them")
    for path in (out, healthy_path(out)):
        if path.exists():
            raise click.UsageError(f"{path} exists already; a twin is never overwritten, give --out another name")
        require_output(path, RunFolderError)
    network = from_datasheet(datasheet, twin) if datasheet is not None else load(twin or "")
    record = record_of(target)
    data = read_record(record, choice=choice)
    data.require(*network.recorded_inputs)
    data = without_stuck(network, data)
    messages = (*data.messages, *beyond_declared(network, data.columns))
    if (asked := open_questions(columns_in_use(network), messages)) and not units_checked:
        raise TwinFileError(
            f"{record}: no twin is written, since the fit depends on an open question of units: {' '.join(asked)} "
            "Correct the record or its heading, or give --units-checked if they are right"
        )
    try:
        inputs, measured = network.select(data.columns)
    except TwinFileError as error:
        raise TwinFileError(f"{record}: {error}") from None
    result = commission(
        network,
        data.time_s,
        inputs,
        measured,
        CommissionOptions(seed=seed, initial_sd=initial_sd, made_by=f"hil commission {printable(record.name)}"),
    )
    if why := refusal_reason(result, measured):
        for message in messages:
            console(quiet=as_json).print(message, markup=False, soft_wrap=True)
        raise TwinFileError(f"{record}: no twin is written: {why}")
    if said := clock_warning(result):
        result = dataclasses.replace(result, notes=(*result.notes, said))
    healthy = save_with_record(result.network, data, out)
    if as_json:
        click.echo(json.dumps(_document(result, out, healthy), indent=1))
        return
    _show(result, messages, out, healthy)


def _document(result: CommissionResult, out: Path, healthy: Path) -> dict[str, object]:
    return {
        "twin": str(out),
        "healthy": str(healthy),
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


def _show(result: CommissionResult, messages: tuple[str, ...], out: Path, healthy: Path) -> None:
    from rich.table import Table

    from hil.record.times import span
    from hil.run.session import console

    to = console()
    for message in messages:
        to.print(message, markup=False, soft_wrap=True)
    parameters = Table(title="Parameters", title_justify="left")
    for heading in ("parameter", "before", "after", "90 % interval", "unit", ""):
        parameters.add_column(heading, justify="left" if heading in ("parameter", "unit", "") else "right")
    for name, value in result.values.items():
        low, high = result.interval90[name]
        told = "not identifiable" if name in result.unidentifiable else ""
        if name in result.at_bound:
            told = "at its bound"
        unit = result.network.parameters[name].unit
        parameters.add_row(name, f"{result.start[name]:.4g}", f"{value:.4g}", f"{low:.4g} to {high:.4g}", unit, told)
    to.print(parameters)
    held = result.held_out_s
    part = f"free run from {span(held[0])} to {span(held[1])}"
    to.print(f"RMSE in K, {part}, held-out segment", style="italic", soft_wrap=True)
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
        to.print(f"no reading there, so not in the table: {', '.join(unread)}", soft_wrap=True)
    for note in result.notes:
        to.print(note, markup=False, soft_wrap=True)
    to.print(f"written: {out}, and its healthy record: {healthy.name}", soft_wrap=True)
