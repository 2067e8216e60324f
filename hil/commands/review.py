"""`hil review`: look at a run in Rerun."""

from __future__ import annotations

import sys
from pathlib import Path

import click


@click.command()
@click.argument("run", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--follow", is_flag=True, help="Show a run that is still going on, live.")
@click.option("--rebuild", is_flag=True, help="Make review.rrd anew from the journal.")
@click.option("--screenshot", type=click.Path(dir_okay=False, path_type=Path), help="Write a PNG without a display.")
def command(run: Path, follow: bool, rebuild: bool, screenshot: Path | None) -> None:
    """Show RUN, a folder of runs/: measured against static and tracked twin, residuals, parameters, events.

    \b
    Example:
      hil review runs/20260520T120000Z-battle_40h
      hil review runs/20260520T120000Z-battle_40h --screenshot picture.png
    """
    from hil.review import has_display, screenshot_review, show_review, write_review
    from hil.run_folder import RunFolder

    folder = RunFolder(run)
    finished = folder.read_manifest()["exit_status"] != "running"
    if follow:
        if not has_display():
            raise click.UsageError(
                "--follow opens a window and there is no display; use --screenshot on the finished run"
            )
        from hil.review import follow_review

        follow_review(folder.journal)
        return
    if rebuild or not folder.review.is_file():
        click.echo(
            f"writing {folder.review}" + ("" if finished else " (the run goes on: what there is so far)"), err=True
        )
        write_review(folder.journal, folder.review)
    if screenshot is not None:
        problems = screenshot_review(folder.review, screenshot)
        for problem in problems:
            click.echo(f"hil: {problem}", err=True)
        click.echo(f"{screenshot}")
        sys.exit(1 if problems else 0)
    if has_display():
        show_review(folder.review)
        return
    click.echo(f"{folder.review} is ready, but there is no display here. On a machine with one:")
    click.echo(f"  rerun {folder.review}")
    click.echo(f"or take a picture of it: hil review {run} --screenshot picture.png")
