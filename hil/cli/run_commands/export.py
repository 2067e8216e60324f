"""Command `hil export`: write a run, or a twin, in a format of other tools."""

from __future__ import annotations

import json
from pathlib import Path

import click

from hil.cli.options import INPUT_PATH

FORMATS = ("csv", "parquet", "mf4", "hdf5", "tdms", "fmu")


@click.command()
@click.argument("subject", metavar="RUN|TWIN", type=INPUT_PATH)
@click.option("--to", type=click.Choice(FORMATS), required=True, help="Format; fmu for a twin, the others for a run.")
@click.option(
    "--out", type=click.Path(path_type=Path), help="File to write.  [default: name of RUN or TWIN, working directory]"
)
@click.option(
    "--signals", metavar="NAMES", help="Columns, signals or patterns (T_*) with commas between them.  [default: all]"
)
@click.option("--force", is_flag=True, help="Replace a file that exists.")
@click.option("--json", "as_json", is_flag=True, help="Print the files and their sizes as JSON.")
def command(subject: Path, to: str, out: Path | None, signals: str | None, force: bool, as_json: bool) -> None:
    """Write the signals of RUN, a run folder, with units, qualities and events; or TWIN, a twin file, as an FMU.

    Values that were not good are missing, and marked with their quality.

    \b
    Example:
      hil export runs/20260520T120000Z-battle_40h --to mf4
      hil export runs/20260520T120000Z-battle_40h --to csv --signals "T_*,heater_power"
      hil export profiles/twins/virtual.toml --to fmu
    """
    from hil.export import ExportError, export_run, export_twin
    from hil.files import on_terminal

    names = [name.strip() for name in (signals or "").split(",") if name.strip()]
    files: tuple[Path, ...]
    remark = ""
    if to == "fmu":
        if names:
            raise click.UsageError("--signals chooses signals of a run; an FMU has all sensors of its twin")
        made = export_twin(_twin_of(subject), out, force=force)
        files, remark = (made.path,), made.remark
    elif subject.is_dir():
        files = export_run(subject, to, out, signals=names, force=force)
    else:
        raise ExportError(f"{subject} is a file; --to {to} takes the folder of a run (runs/*)")
    if as_json:
        sizes = [{"path": str(path), "bytes": path.stat().st_size} for path in files]
        click.echo(json.dumps({"files": sizes, "remark": remark}))
        return
    for path in files:
        click.echo(f"{on_terminal(str(path))}  {path.stat().st_size / 1e6:.2f} MB")
    if remark:
        click.echo(on_terminal(remark), err=True)


def _twin_of(subject: Path) -> Path:
    """Return the twin file itself, or that of a run."""
    from hil.export import ExportError
    from hil.run_folder import RunFolder

    if not subject.is_dir():
        return subject
    twin = RunFolder(subject).twin
    if not twin.is_file():
        raise ExportError(f"{subject} holds no twin.toml; give a twin file")
    return twin
