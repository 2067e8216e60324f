"""`hil report`: the files of a run that are made from its journal."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import click


@click.command()
@click.argument("run", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--rebuild", is_flag=True, help="Make record.parquet and review.rrd anew, too, from the journal.")
@click.option("--json", "as_json", is_flag=True, help="Print run.json, with what is missing.")
def command(run: Path, rebuild: bool, as_json: bool) -> None:
    """Write report.html of RUN, a folder of runs/, and what else is missing: record.parquet, review.rrd.

    The rig is not touched. A run that was cut is reported as far as it came, and can still be resumed.

    \b
    Example:
      hil report runs/20260520T120000Z-battle_40h
      hil report runs/20260520T120000Z-battle_40h --rebuild
    """
    from hil.run.session.regenerate import regenerate_files
    from hil.run_folder.folder import RunFolder

    derived = regenerate_files(RunFolder(run), rebuild, lambda text: click.echo(text, err=True))
    if as_json:
        click.echo(json.dumps(derived.folder.read_manifest(), indent=1))
    elif not derived.missing:
        click.echo(str(derived.folder.report))
    sys.exit(derived.exit_code(True))
