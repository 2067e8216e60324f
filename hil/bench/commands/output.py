"""Common parts of the commands of `hil bench`: options, the folder of recordings, the final report."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hil.cli.options import PROJECT

if TYPE_CHECKING:
    from hil.bench.measure import ReportTable

_CODE = "hil.bench.code"


def _with_code(context: click.Context, parameter: click.Parameter, out: Path | None) -> Path | None:
    """Note the state of the code before the measurement: files may change, or a branch, while it runs."""
    if out is not None:
        from hil.bench.measure import code_state

        context.meta[_CODE] = code_state(context.command.name or "")
    return out


OUT = click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    callback=_with_code,
    help="Folder for JSON, Markdown and manifest.",
)
QUICK = click.option("--quick", is_flag=True, help="Use small sizes, for a trial run or for CI.")
SEED = click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of all random numbers.")
JOBS = click.option(
    "--jobs", type=click.IntRange(1, 1024), help="Cases at a time.  [default: 1; on a scheduler: one for each worker]"
)
JSON = click.option("--json", "as_json", is_flag=True, help="Print the tables as JSON.")


def data_folder() -> Path:
    """Return the folder of recordings of other rigs."""
    return Path(os.environ.get("HIL_DATA", PROJECT.parent / "shared" / "data"))


def finish(
    name: str, seed: int, tables: tuple[ReportTable, ...], skipped: tuple[str, ...], out: Path | None, as_json: bool
) -> None:
    """Print the report, and write it if requested."""
    from hil.bench.measure import BenchReport, manifest, show, write
    from hil.bench.measure import as_json as json_of

    code = click.get_current_context().meta.get(_CODE)
    report = BenchReport(name, tables, skipped, manifest(_typed(name), seed, name, code))
    if as_json:
        click.echo(json_of(report), nl=False)
    else:
        show(report)
    if out is not None:
        for path in write(report, out):
            click.echo(str(path), err=True)


def _typed(name: str) -> str:
    """Return the command as typed, without its output folders and without what an address with a user holds."""
    if Path(sys.argv[0]).name not in ("hil", "__main__.py"):
        return f"hil bench {name}"
    words = sys.argv[1:]
    places = ("--out", "--work")
    kept = [w for i, w in enumerate(words) if not w.startswith(places) and (i == 0 or words[i - 1] not in places)]
    return " ".join(["hil", *(_without_secret(word) for word in kept)])


def _without_secret(word: str) -> str:
    """Return a word of a command; an address with a user, and perhaps a password, is cut behind its scheme."""
    return re.sub(r"://\S*@\S*", "://...", word)
