"""Command `hil check`: report the content of a file and its mistakes before anything moves."""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Callable, Iterator
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hil.cli.options import INPUT_FILE, INPUT_PATH, VIRTUAL_RIG, reading

if TYPE_CHECKING:
    from rich.console import Console

    from hil.record import ReadingOptions

MOST_PROBLEMS = 20
"""Mistakes of a tower's file that are listed."""


@click.command()
@click.argument("file", type=INPUT_PATH, required=False)
@click.option(
    "--rig", type=INPUT_FILE, default=VIRTUAL_RIG, show_default=True, help="Rig file to check a load profile against."
)
@click.option(
    "--catalogue", is_flag=True, help="For a twin: list the effects that no record of its rig can distinguish."
)
@click.option("--kinds", is_flag=True, help="Without FILE: list every kind of element of a twin file, with its keys.")
@click.option(
    "--json", "as_json", is_flag=True, help="For a rig file: print the read plan, or the result of --online, as JSON."
)
@click.option(
    "--online", is_flag=True, help="For a rig file: connect to all buses and show the readings. Writes nothing."
)
@click.option(
    "--seconds",
    type=click.FloatRange(0.0),
    help="Duration of --online; default: until Ctrl-C, or one reading if the output is no terminal.",
)
@click.option(
    "--picture", type=click.Path(dir_okay=False, path_type=Path), help="Draw the network of a twin: .svg or .png."
)
@reading
def command(
    file: Path | None,
    rig: Path,
    catalogue: bool,
    kinds: bool,
    as_json: bool,
    online: bool,
    seconds: float | None,
    picture: Path | None,
    choice: ReadingOptions,
) -> None:
    """Check FILE: a rig file, twin, load profile, test plan, scenario, effects file or record.

    Of a cooling tower: a historian store or aligned record (folders), tags.csv, events.csv, labels.csv, test points,
    datasheet.json. It exits with 1 if one has problems.

    Nothing is moved or written. If FILE is a run folder, its record is checked. A run that ended without a record gets
    one from its journal.

    --online exits with 1 if a bus is down or a point is not good at the end.

    \b
    Example:
      hil check profiles/rigs/virtual.toml
      hil check my_rig.toml --online
      hil check my_rig.toml --online --seconds 10 --json
      hil check my_rig.toml --json
      hil check my_load.csv --rig my_rig.toml
      hil check profiles/twins/loop_six.toml --picture network.svg
      hil check my_twin.toml --catalogue
      hil check profiles/tests/cooling_steps.toml
      hil check runs/<a run>
      hil check station
      hil check --kinds
    """
    from hil.record import ReadingOptions
    from hil.run.session import console

    if kinds:
        if file is not None:
            raise click.UsageError(f"--kinds takes no file; leave {file} out")
        from hil.rig import kinds_table

        console().print(kinds_table())
        return
    if file is None:
        raise click.UsageError(
            "Missing argument 'FILE'; give a file to check, or --kinds to list the elements of twin files"
        )
    from hil.cli.options import record_of

    checker: Callable[[Path, Path, Console], None] = _tower
    if _tower_kind(file) is None:
        file = record_of(file)
        checker = _checker(file, rig)
    if picture is not None:
        from hil.run_folder import RunFolderError, require_output

        if checker is not _twin:
            raise click.UsageError(f"--picture draws twins, and {file} is no twin")
        if picture.suffix.lower() not in (".svg", ".png", ".pdf"):
            raise click.UsageError(f"{picture}: a picture is a .svg, a .png or a .pdf; choose one")
        require_output(picture, RunFolderError, [file])
    if catalogue and checker is not _twin:
        raise click.UsageError(f"--catalogue lists the effects that a twin may lack, and {file} is no twin")
    if online and checker is not _rig:
        raise click.UsageError(f"--online connects to the rig of a rig file, and {file} is no rig file")
    if seconds is not None and not online:
        raise click.UsageError("--seconds belongs to --online")
    if as_json and checker is not _rig:
        raise click.UsageError(f"--json prints the read plan of a rig file, and {file} is no rig file")
    with _named(file, checker):
        if online:
            _online(file, seconds, None if as_json else console())
            return
        if as_json:
            from hil.rig import as_json as plan

            click.echo(plan(file))
            return
        if checker is _record:
            _record(file, choice, console())
        elif checker is _tower:
            _tower(file, choice, console())
        elif choice != ReadingOptions():
            raise click.UsageError(
                f"--decimal, --dates, --time-column and --time-scale describe a record; {file} is no record"
            )
        else:
            checker(file, rig, console())
    if catalogue:
        _catalogue(file, console())
    if picture is not None:
        from twin import draw, load

        draw(load(file), picture)
        click.echo(str(picture))


@contextlib.contextmanager
def _named(file: Path, checker: Callable[[Path, Path, Console], None]) -> Iterator[None]:
    """Name the kind of file before an error about it, if the kind was inferred: another may have been meant."""
    try:
        yield
    except Exception:
        if checker in _INFERRED and not (checker is _rig and _has_rig(file)):
            click.echo(f"{file}: checked as {_INFERRED[checker]}", err=True)
        raise


def _has_rig(file: Path) -> bool:
    """Return True for a TOML file with a table that only rig files have, or that shows another program's file."""
    from drivers.rig_file import read_regular, tables_of

    return not {"rig", "bus", "point", "inputs"}.isdisjoint(tables_of(read_regular(file))[1])


def _checker(file: Path, rig: Path) -> Callable[[Path, Path, Console], None]:
    from drivers.rig_file import read_regular, refuse_irregular, tables_of
    from drivers.signals import ConfigurationError

    try:
        if not file.is_dir():
            refuse_irregular(file, file.stat().st_mode)
    except OSError as error:
        raise ConfigurationError(f"{file} cannot be read ({error.strerror}); name a file") from error
    if file.suffix == ".toml":
        try:
            keys = set(tables_of(read_regular(file))[1])
        except ValueError as error:
            raise ConfigurationError(f"{file}: {error}") from error
        if not keys:
            raise ConfigurationError(
                f"{file}: holds no key; a rig file has [rig], a twin [elements.NAME], an effects file [[effect]], a "
                "scenario [[system]], a test plan [[limit]], a fleet file [[job]]"
            )
        for key, checker in _CHECKERS.items():
            if key in keys:
                return checker
        return _rig
    from hil.record import RecordError, foreign_kind

    with file.open("rb") as content:
        beginning = content.read(_SAMPLE_BYTES)
    if beginning.startswith(b"PAR1") or file.suffix in (".parquet", ".pq"):
        return _record
    if (what := foreign_kind(beginning)) is not None:
        raise RecordError(f"{file} {what}")
    if file.suffix in (".csv", ".tsv", ".tab", ".txt", ".dat", ".asc", ".prn", ".lvm", ".log"):
        return _record if _is_record(file, beginning, rig) else _profile
    if file.suffix in (".yaml", ".yml", ".dbc"):
        raise ConfigurationError(f"{file}: is no rig file; `hil init --from {file}` makes one of it")
    raise click.UsageError(f"{file}: is no .toml, .csv, .tsv or .parquet file; give a file of one of these types")


def _is_record(file: Path, content: bytes, rig: Path) -> bool:
    """Return True for the beginning of a record, False for that of a load profile.

    A record has columns that no profile has: temperatures that are no set-points of the rig, values of a long format,
    dates. A table whose first column is not time_s is a profile only if it has a set-point of the rig.

    Raises ConfigurationError for a register table.
    """
    from drivers.importers import names_registers
    from drivers.rig_file import load_rig
    from drivers.signals import ConfigurationError
    from hil.record import (
        VALUES,
        DialectError,
        beginning_of,
        find_dialect,
        is_annotated,
        is_labview,
        is_waveforms,
        name_and_unit,
    )
    from hil.record.times import names_dates
    from hil.run.session import setpoint_limits

    beginning = beginning_of(content)
    if is_annotated(beginning) or is_labview(beginning) or is_waveforms(beginning):
        return True
    try:
        names = list(find_dialect(beginning).names)
    except DialectError as error:
        if not beginning.strip():
            return False
        raise ConfigurationError(f"{file}{error}") from error
    if names_registers(names):
        raise ConfigurationError(f"{file}: is a register table; `hil init --from {file}` makes a rig file of it")
    if any(name.strip().lower() in VALUES for name in names):
        return True
    in_degC = ("degC", "degF")
    found = [name for name in names if _TEMPERATURE.search(name) or (name_and_unit(name) or ("", ""))[1] in in_degC]
    if names[0] == "time_s":
        return bool(found) and any(name not in setpoint_limits(load_rig(rig)) for name in found)
    if found or any(names_dates(name) for name in names):
        return True
    return len(names) > 1 and not any(_signal(name) in map(_signal, setpoint_limits(load_rig(rig))) for name in names)


def _signal(name: str) -> str:
    """Return a column's name without its unit, as letters and digits: `Heater power [W]` is heaterpower."""
    from drivers.signals import split_column
    from hil.record import name_and_unit

    found = split_column(name) or name_and_unit(name)
    return re.sub(r"[\W_]+", "", found[0] if found else name).lower()


_SAMPLE_BYTES = 200_000
"""Bytes from the beginning of a table that show its format."""
_TEMPERATURE = re.compile(
    r"^T_|_C$|^T(_.+|\d+)_[KF]$|[\[(]\s*(°|deg)\s*[CFK]\s*[\])]$|^(T|TC|PT|RTD|temp)[ _]?\d+$|^temp(erature|eratur)?$",
    re.IGNORECASE,
)


def _rig(file: Path, _: Path, out: Console) -> None:
    from hil.rig import show

    show(file, out)


def _online(file: Path, seconds: float | None, out: Console | None) -> None:
    import asyncio
    import sys

    from hil.errors import FOUND
    from hil.rig import checked_rig, watch_online

    found = asyncio.run(watch_online(checked_rig(file)[0], seconds, out))
    if out is None:
        click.echo(json.dumps(found, indent=1))
    elif found["faults"]:
        count = len(found["faults"])
        out.print(f"{file}: {count} fault{'s' if count > 1 else ''} on the rig", style="red")
        for sentence in found["faults"]:
            out.print(f"  {sentence}", markup=False, soft_wrap=True)
    else:
        out.print(f"{file}: all buses answer and all {len(found['points'])} points are good", style="green")
    if found["faults"]:
        sys.exit(FOUND)


def _twin(file: Path, _: Path, out: Console) -> None:
    from rich.table import Table

    from twin import load

    network = load(file)
    table = Table(title=f"{network.name}: {len(network.nodes)} volumes", title_justify="left")
    for heading in ("parameter", "value", "bounds", "unit", "status", "source"):
        table.add_column(heading, justify="right" if heading == "value" else "left")
    for name, parameter in network.parameters.items():
        bounds = f"{parameter.lower:g} to {parameter.upper:g}"
        table.add_row(name, f"{parameter.value:.5g}", bounds, parameter.unit, parameter.status, parameter.source)
    out.print(table)
    out.print(f"needs {', '.join(network.recorded_inputs)}")
    for sensor, columns in network.sensor_columns.items():
        out.print(f"predicts {sensor}" + (f" (mean of {', '.join(columns)})" if len(columns) > 1 else ""))
    revision = network.revision
    if revision.number:
        out.print(f"revision {revision.number}, made by {revision.made_by}, parent {revision.parent[:12]}")
    out.print(f"{file}: no mistakes found", style="green")


def _catalogue(file: Path, out: Console) -> None:
    from twin import load
    from twin.discovery import ambiguity_groups, catalogue, label_text

    network = load(file)
    entries = {(c.kind, c.where, c.driver) for c in catalogue(network)}
    out.print(f"A diagnosis tests {len(entries)} effects that the twin may lack")
    found = ambiguity_groups(network)
    groups = dict.fromkeys("; ".join(sorted({label_text(x) for x in group})) for group in found.groups)
    for names in groups:
        out.print(f"no input distinguishes: {names}", soft_wrap=True)
    if groups:
        out.print(
            "A diagnosis reports all effects of such a line together. To separate those of two places, measure there: "
            "a further thermometer, power meter or flow meter, as a sensor or meter of the twin",
            soft_wrap=True,
        )
    for label in found.undetectable:
        out.print(f"no input shows: {label_text(label)}", soft_wrap=True)


def _effects(file: Path, _: Path, out: Console) -> None:
    from drivers.virtual.plant import load_effects

    for number, effect in enumerate(load_effects(file), 1):
        sizes = {effect.magnitude: effect.value, **effect.shape}
        sized = ", ".join(f"{key} = {value:g}" for key, value in sizes.items())
        when = f"from {effect.onset_s:g} s" + (f" to {effect.end_s:g} s" if isfinite(effect.end_s) else " on")
        grown = f", growing for {effect.ramp_s:g} s" if effect.ramp_s else ""
        out.print(f"effect {number}: {effect.kind} at {effect.where}, {effect.driver}: {sized}; {when}{grown}")
    out.print(f"{file}: no mistakes found", style="green")


def _scenario(file: Path, _: Path, out: Console) -> None:
    from hil.profile import build, read_scenario

    scenario = read_scenario(file)
    profile = build(scenario, 1)
    low, high = profile.values[:, 0].min(), profile.values[:, 0].max()
    out.print(
        f"{file}: {profile.duration_s / 3600:.1f} h, {len(profile.time_s)} breakpoints, {low:.0f} to {high:.0f} W; "
        "no mistakes found",
        style="green",
    )


def _test_plan(file: Path, rig: Path, out: Console) -> None:
    from hil.run.session import RunRequest, check_session
    from hil.testing import read_plan

    plan = read_plan(file)
    if plan.profile is not None:
        check_session(RunRequest(plan.profile, plan.rig or rig, plan.twin, Path("runs"), test=file))
    for limit in plan.limits:
        step = f" ({limit.step})" if limit.step else ""
        out.print(f"  {limit.id}: {limit.text}{step}, {limit.severity}, for {limit.requirement}", markup=False)
    fits = "which fit its rig and profile" if plan.profile is not None else "for runs of any profile"
    out.print(f"{file}: {len(plan.limits)} limits, {fits}; no mistakes found", style="green")


def _fleet(file: Path, _: Path, out: Console) -> None:
    from collections import Counter

    from hil.fleet import jobs_of, read_fleet

    counts = Counter(job.kind for job in jobs_of(read_fleet(file)))
    for kind, count in counts.items():
        out.print(f"  {kind}: {count} job{'s' if count > 1 else ''}", markup=False)
    out.print(f"{file}: {counts.total()} jobs; no mistakes found", style="green")


def _profile(file: Path, rig: Path, out: Console) -> None:
    from drivers.rig_file import load_rig
    from hil.profile import WINDOW_S, read_profile, validate
    from hil.run.session import setpoint_limits

    target = load_rig(rig)
    profile = read_profile(file)
    least_s = 0.0 if target.twin is None else WINDOW_S
    for note in validate(profile, setpoint_limits(target), min_duration_s=least_s, period_s=target.period_s):
        out.print(f"  {note}")
    for index, column in enumerate(profile.columns):
        low, high = profile.values[:, index].min(), profile.values[:, index].max()
        out.print(f"  {column}: {low:g} to {high:g}")
    out.print(f"{file}: {profile.duration_s / 3600:.2f} h, runs on {target.name}", style="green")


def _tower_kind(file: Path) -> str | None:
    from hil.tower import tower_kind

    return tower_kind(file)


def _tower(file: Path, choice: ReadingOptions | Path, out: Console) -> None:
    import sys

    from hil.errors import FOUND
    from hil.record import ReadingOptions
    from hil.tower import check_file

    found = check_file(file, _tower_kind(file) or "", choice if isinstance(choice, ReadingOptions) else None)
    for line in found.lines:
        out.print(f"  {line}", markup=False, highlight=False, soft_wrap=True)
    if not found.problems:
        out.print(f"{file}: {found.what}; no mistakes found", style="green", soft_wrap=True)
        return
    count = len(found.problems)
    out.print(f"{file}: {found.what}; {count} problem{'s' if count > 1 else ''}", style="red", soft_wrap=True)
    for sentence in found.problems[:MOST_PROBLEMS]:
        out.print(f"  {sentence}", markup=False, highlight=False, soft_wrap=True)
    if count > MOST_PROBLEMS:
        out.print(f"  and {count - MOST_PROBLEMS} more", markup=False, highlight=False)
    sys.exit(FOUND)


def _record(file: Path, choice: ReadingOptions | Path, out: Console) -> None:
    import numpy as np

    from hil.record import ReadingOptions, read_record

    record = read_record(file, choice=choice if isinstance(choice, ReadingOptions) else None)
    for message in record.messages:
        out.print(f"  {message}", markup=False, soft_wrap=True)
    for name, values in record.columns.items():
        finite = values[np.isfinite(values)]
        spread = f"{finite.min():g} to {finite.max():g}" if finite.size else "no value"
        missing = f", {len(values) - finite.size} missing" if finite.size < len(values) else ""
        out.print(f"  {name}: {spread}{missing}", markup=False)
    out.print(f"{file}: {len(record.time_s)} samples over {np.ptp(record.time_s) / 3600:.2f} h", style="green")


_CHECKERS: dict[str, Callable[[Path, Path, Console], None]] = {
    "job": _fleet,
    "elements": _twin,
    "effect": _effects,
    "effects": _effects,
    "where": _effects,
    "system": _scenario,
    "systems": _scenario,
    "limit": _test_plan,
    "step": _test_plan,
    "trip_on": _test_plan,
    "id": _test_plan,
}
"""Key at the top of a TOML file -> its checker; a file without any of them is a rig file."""

_INFERRED: dict[Callable[[Path, Path, Console], None], str] = {
    _rig: "a rig file, since it has no [elements] (twin), [[effect]] (effects file), [[system]] (scenario), "
    "[[limit]] (test plan) or [[job]] (fleet file)",
    _profile: "a load profile, since no column is a temperature; a record has columns such as T_tank_C",
    _record: "a record, since it is Parquet or has a column that no load profile has, such as a temperature or a date",
}
"""Kind that a check infers for a file if no key names it, with the reason."""
