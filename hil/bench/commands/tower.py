"""Bench of the calibration of cooling towers."""

from __future__ import annotations

from pathlib import Path

import click

from hil.bench.commands.output import JSON, OUT, SEED, data_folder, finish
from hil.cli.options import INPUT_FILE


@click.command("tower")
@click.argument("record", required=False, type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--twin", "twins", multiple=True, type=INPUT_FILE, help="Twin file of a cell; may be repeated.")
@click.option(
    "--network",
    "networks",
    multiple=True,
    type=INPUT_FILE,
    help="Trained member; RECORD is then the folder of simulated stations of `hil train tower`. May be repeated.",
)
@click.option("--windows", type=click.IntRange(1), help="Test windows at most, for a network.  [default: all]")
@click.option(
    "--results", type=INPUT_FILE, help="Scores that a training within a time limit left, instead of --network."
)
@click.option("--labels", type=INPUT_FILE, help="Inspections, traverses and certificates, CSV.")
@click.option("--truth", type=INPUT_FILE, help="Truth of a made station, Parquet: errors of the deviations too.")
@click.option(
    "--steps", type=click.IntRange(1), help="Trials with a step of the outlet thermometer, instead of the baselines."
)
@click.option("--step-size", default=0.5, show_default=True, help="Size of these steps, K.")
@click.option(
    "--stations",
    type=click.IntRange(1),
    help="Simulated stations with hidden recirculation, and with defects, instead of RECORD.",
)
@click.option("--months", type=click.FloatRange(0.5, 14.0), default=2.0, show_default=True, help="Length of these.")
@SEED
@OUT
@JSON
def tower_command(
    record: Path | None,
    twins: tuple[Path, ...],
    networks: tuple[Path, ...],
    windows: int | None,
    results: Path | None,
    labels: Path | None,
    truth: Path | None,
    steps: int | None,
    step_size: float,
    stations: int | None,
    months: float,
    seed: int,
    out: Path | None,
    as_json: bool,
) -> None:
    """Predictions of a cell's outlet on RECORD by each baseline, its own readings hidden.

    With --network: trained members and their rivals on simulated stations that no training saw.

    With --stations: diagnosis of an undeclared recirculation and defects of the archive, on stations of as many seeds.

    With --steps: steps of an outlet thermometer, how soon each is found, and the fouling that the refit then reports.

    \b
    Example:
      hil bench tower record --twin cell1.toml
      hil bench tower record --twin cell1.toml --twin cell2.toml --steps 200
      hil bench tower training/tower --network training/tower_small_0.safetensors
      hil bench tower --stations 10 --months 2
    """
    if stations is not None:
        _stations(range(seed, seed + stations), months, out, as_json)
        return
    if record is None:
        raise click.UsageError("name the aligned RECORD, or simulate stations with --stations")
    if networks or results is not None:
        _networks(record, networks, windows, results, out, as_json)
        return
    if not twins:
        raise click.UsageError("name the twins of the record's cells with --twin, or trained members with --network")
    if steps is not None:
        from hil.bench.tower_steps import tables_of, try_steps

        trials = try_steps(
            record, twins, steps, step_size, seed, lambda k: click.echo(f"trial {k} of {steps}", err=True)
        )
        finish("tower_steps", seed, tuple(tables_of(trials, step_size)), (), out, as_json)
        return
    from hil.bench.tower import compare

    tables, skipped = compare(record, twins, labels, truth)
    finish("tower", 0, tuple(tables), tuple(skipped), out, as_json)


def _stations(seeds: range, months: float, out: Path | None, as_json: bool) -> None:
    import tempfile

    from hil.bench.tower_stations import tables_of, try_stations

    with tempfile.TemporaryDirectory(prefix="hil-stations-") as folder:
        weather = data_folder() / "weather"
        trials = try_stations(Path(folder), seeds, months, weather, lambda text: click.echo(text, err=True))
    finish("tower_stations", seeds.start, tuple(tables_of(trials)), (), out, as_json)


def _networks(
    folder: Path, networks: tuple[Path, ...], windows: int | None, results: Path | None, out: Path | None, as_json: bool
) -> None:
    from hil.bench.tower_network import latency, network_tables, read_results, tables_of

    if results is not None:
        found = [*tables_of(read_results(results)), *([latency(networks)] if networks else [])]
    else:
        found = network_tables(folder, networks, most=windows, note=lambda text: click.echo(text, err=True))
    finish("tower_network", 0, tuple(found), (), out, as_json)
