"""Bench of the calibration of cooling towers."""

from __future__ import annotations

from pathlib import Path

import click

from hil.bench.commands.output import JSON, OUT, finish
from hil.cli.options.paths import INPUT_FILE


@click.command("tower")
@click.argument("record", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option(
    "--twin", "twins", required=True, multiple=True, type=INPUT_FILE, help="Twin file of a cell; may be repeated."
)
@click.option("--labels", type=INPUT_FILE, help="Inspections, traverses and certificates, CSV.")
@click.option("--truth", type=INPUT_FILE, help="Truth of a made station, Parquet: errors of the deviations too.")
@OUT
@JSON
def tower_command(
    record: Path, twins: tuple[Path, ...], labels: Path | None, truth: Path | None, out: Path | None, as_json: bool
) -> None:
    """Predictions of a cell's outlet on RECORD by each baseline, its own readings hidden.

    \b
    Example:
      hil bench tower record --twin cell1.toml
    """
    from hil.bench.tower import compare

    tables, skipped = compare(record, twins, labels, truth)
    finish("tower", 0, tuple(tables), tuple(skipped), out, as_json)
