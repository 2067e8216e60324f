"""Command `hil compare`: differences of runs on profile time."""

from __future__ import annotations

import json
from pathlib import Path

import click


@click.command()
@click.argument("runs", nargs=-1, required=True, type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("comparison.html"), show_default=True, help="Page."
)
@click.option("--json", "as_json", is_flag=True, help="Print the tables as JSON.")
def command(runs: tuple[Path, ...], out: Path, as_json: bool) -> None:
    """Compare two or more RUNS, the first one being the reference, aligned on profile time.

    The table shows each signal that all runs have; the page also has overlaid plots that zoom without a network, the
    drift of parameters, and the verdicts of runs that were judged.

    \b
    Example:
      hil compare runs/20260520T120000Z-battle_40h runs/20260601T080000Z-battle_40h
      hil compare runs/*-cooling_steps --out cooling.html
    """
    from hil.comparison import compare_runs, require_page, write_comparison
    from hil.run_folder import RunFolder, read_verdict
    from hil.testing import requirement_matrix

    require_page(out)
    folders = [RunFolder(path) for path in runs]
    made = compare_runs(folders)
    judged = [folder for folder in folders if read_verdict(folder)["tests"]]
    matrix = requirement_matrix(judged) if judged else None
    write_comparison(made, matrix, out)
    if as_json:
        verdicts = None if matrix is None else matrix.document()
        click.echo(json.dumps(made.document() | {"requirements": verdicts, "page": str(out)}, indent=1))
        return
    from rich.table import Table

    from hil.comparison import difference_head, difference_row
    from hil.run.session import console

    to = console()
    for position, name in enumerate(made.runs, 1):
        to.print(f"run {position}: {name}" + (" (reference)" if position == 1 else ""), markup=False, soft_wrap=True)
    table = Table()
    for heading in difference_head(made):
        table.add_column(heading, overflow="fold")
    for item in made.differences:
        table.add_row(*difference_row(made, item))
    to.print(table)
    for drift in made.drifts:
        for name, beyond, value in zip(made.runs, drift.beyond, drift.values, strict=True):
            if beyond:
                to.print(
                    f"{drift.parameter} ({drift.calibrator}): {drift.values[0]:.4g} has become {value:.4g} in {name}",
                    markup=False,
                )
    click.echo(f"page: {out}")
