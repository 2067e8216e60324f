"""Command `hil review`: show a run in Rerun."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import click


@click.command()
@click.argument("run", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--follow", is_flag=True, help="Show a live run as it goes on.")
@click.option("--rebuild", is_flag=True, help="Rebuild review.rrd from the journal.")
@click.option("--tab", help="Tab of the screenshot, by its title: Overview, Diagnosis, ...")
@click.option("--screenshot", type=click.Path(dir_okay=False, path_type=Path), help="Write a PNG without a display.")
def command(run: Path, follow: bool, rebuild: bool, tab: str | None, screenshot: Path | None) -> None:
    """Show RUN, a run folder: measured against static and tracked twin, residuals, parameters, events.

    If RUN has been diagnosed, one tab shows the diagnosis. A folder that `hil diagnose` wrote of a run or record may be
    given, too, and one that `hil tower calibrate` wrote: outlet measured against the twin with its interval, and the
    deviations. The diagnosis of a tower has no picture: calibrate with its revisions, and review that.

    \b
    Example:
      hil review runs/20260520T120000Z-battle_40h
      hil review runs/20260520T120000Z-battle_40h --screenshot picture.png
    """
    from hil.diagnosis import REVIEW, has_diagnosis
    from hil.files import require_plain
    from hil.review import has_display, write_review
    from hil.run_folder import RunFolder, RunFolderError, require_output

    if screenshot is not None:
        require_output(screenshot, RunFolderError)
        if screenshot.suffix.lower() != ".png":
            raise click.UsageError(f"{screenshot}: the picture is a PNG; give --screenshot a name that ends with .png")
    folder = RunFolder(run)
    if not folder.manifest.is_file() and has_diagnosis(run):
        require_plain(run, RunFolderError)
        from hil.review import write_findings_review

        write_findings_review(run, run / REVIEW)
        _show(run, run / REVIEW, tab, screenshot)
        return
    if not folder.manifest.is_file() and _is_tower(run):
        require_plain(run, RunFolderError)
        _show(run, _tower_review(run), tab, screenshot)
        return
    finished = folder.read_manifest()["exit_status"] != "running"
    if follow:
        if not has_display():
            raise click.UsageError(
                "--follow opens a window and there is no display; use --screenshot on the finished run"
            )
        from hil.review import follow_review

        follow_review(folder.journal)
        return
    if rebuild or not folder.is_review_current(finished=finished):
        cut = f" (the run was interrupted: shown as far as it came; `hil resume {shlex.quote(str(run))}` continues it)"
        so_far = "" if finished else cut if folder.was_cut else " (the run is live: shown as far as it has come)"
        click.echo(f"writing {folder.review}{so_far}", err=True)
        write_review(folder.journal, folder.review)
    _show(run, folder.review, tab, screenshot)


def _is_tower(folder: Path) -> bool:
    """Return True for a folder of a tower: of its calibration, its diagnosis or its aligned record."""
    from hil.tower import TABLE, cells_of

    return any((folder / name).is_file() for name in (TABLE, "diagnosis.json")) or bool(cells_of(folder))


def _tower_review(folder: Path) -> Path:
    """Write the review of a tower's calibration and return its file."""
    from drivers.historian import why_unwritten
    from hil.files import held, require_complete
    from hil.record import RecordError
    from hil.review import write_tower_review
    from hil.run_folder import RunFolder
    from hil.tower import NETWORK_TABLE, TABLE, read_events

    if not (folder / TABLE).is_file():
        what = "the diagnosis of a tower, which has no picture, and " if (folder / "diagnosis.json").is_file() else ""
        raise RecordError(
            f"{folder}: holds {what}no {TABLE} to show; calibrate with hil tower calibrate and review its folder"
        )
    rrd = RunFolder(folder).review
    network = folder / NETWORK_TABLE
    try:
        with held(folder, RecordError):
            require_complete(folder, RecordError)
            asked = network if network.is_file() else None
            write_tower_review(folder / TABLE, rrd, folder.resolve().name, asked, read_events(folder))
    except ValueError as error:
        raise RecordError(str(error)) from error
    except OSError as error:
        raise RecordError(f"{rrd}: cannot be written: {why_unwritten(error)}") from error
    return rrd


def _show(run: Path, rrd: Path, tab: str | None, screenshot: Path | None) -> None:
    """Take the requested screenshot, open a window, or print the commands to use without a display."""
    from hil.review import has_display, screenshot_review, show_review

    if screenshot is not None:
        try:
            problems = screenshot_review(rrd, screenshot, tab=tab)
        except KeyError as error:
            raise click.UsageError(str(error.args[0])) from None
        except TimeoutError:
            raise click.ClickException(
                f"the viewer did not answer in time, so there is no picture; repeat the command, or open {rrd}"
            ) from None
        for problem in problems:
            click.echo(f"hil: {problem}", err=True)
        click.echo(f"{screenshot}")
        sys.exit(1 if problems else 0)
    if has_display():
        show_review(rrd)
        return
    click.echo(f"{rrd} is ready, but there is no display here. On a machine with one:")
    click.echo(f"  rerun {shlex.quote(str(rrd))}")
    click.echo(f"or take a picture of it: hil review {shlex.quote(str(run))} --screenshot picture.png")
