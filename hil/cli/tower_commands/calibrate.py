"""`hil tower calibrate`: deviations of cells from their clean twins, on an aligned record."""

from __future__ import annotations

from pathlib import Path

import click

from hil.cli.options.paths import INPUT_FILE


@click.command()
@click.argument("record", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--twin", "twins", required=True, multiple=True, type=INPUT_FILE, help="Twin file of a cell; may be repeated.")
@click.option("--out", required=True, type=click.Path(path_type=Path, file_okay=False), help="Folder of the results.")
@click.option("--labels", type=INPUT_FILE, help="Inspections, traverses and certificates, CSV.")
def command(record: Path, twins: tuple[Path, ...], out: Path, labels: Path | None) -> None:
    """Calibrate cells on RECORD, the aligned record of their station.

    \b
    Example:
      hil tower calibrate record --twin cell1.toml --twin cell2.toml --labels labels.csv --out out
    """
    from hil.run.session.terminal import console
    from hil.tower.calibrate import calibrate, write_table

    results, _ = calibrate(record, twins, labels)
    path = write_table(results, out)
    console().print(f"written: {path}", markup=False, soft_wrap=True)
