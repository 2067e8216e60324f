"""Command `hil report`: make the files of a run from its journal."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import click


@click.command()
@click.argument("run", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--rebuild", is_flag=True, help="Rebuild record.parquet and review.rrd from the journal, too.")
@click.option("--pdf", is_flag=True, help="Write report.pdf, too; needs a Chromium on this machine.")
@click.option("--json", "as_json", is_flag=True, help="Print run.json, with a list of the missing files.")
def command(run: Path, rebuild: bool, pdf: bool, as_json: bool) -> None:
    """Write report.html of RUN, a run folder, and the missing files of record.parquet and review.rrd.

    The rig is not touched. An interrupted run is reported as far as it came, and can still be resumed.

    \b
    Example:
      hil report runs/20260520T120000Z-battle_40h
      hil report runs/20260520T120000Z-battle_40h --pdf
      hil report runs/20260520T120000Z-battle_40h --rebuild
    """
    from hil.run.session import regenerate_files
    from hil.run_folder import RunFolder

    derived = regenerate_files(RunFolder(run), rebuild, lambda text: click.echo(text, err=True))
    printed = derived.folder.report.with_suffix(".pdf")
    if pdf and not derived.missing:
        from hil.report import write_pdf

        write_pdf(derived.folder.report, printed)
    if as_json:
        click.echo(json.dumps(derived.folder.read_manifest(), indent=1))
    elif not derived.missing:
        click.echo(str(derived.folder.report))
        if pdf:
            click.echo(str(printed))
    sys.exit(derived.exit_code(True))
