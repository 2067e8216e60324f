"""`hil tower collect`: poll a rig's points into a historian."""

from __future__ import annotations

import asyncio
import contextlib
from pathlib import Path

import click

from hil.cli.options import INPUT_FILE


@click.command()
@click.argument("rig", type=INPUT_FILE)
@click.option("--into", required=True, help="Store: folder, .duckdb file or PostgreSQL URL; made where there is none.")
@click.option(
    "--every", "every_s", type=click.FloatRange(min=0.1), help="Seconds between polls; default: the rig's period."
)
@click.option("--minutes", type=click.FloatRange(min=0.0, min_open=True), help="End after this time; default: Ctrl-C.")
def command(rig: Path, into: str, every_s: float | None, minutes: float | None) -> None:
    """Poll the points of RIG into a historian until Ctrl-C.

    Each sample has its time in UTC and a quality code: 192 good, 64 uncertain, 0 bad.

    \b
    Example:
      hil tower collect station.toml --into station --every 60
      hil tower collect station.toml --into station.duckdb --minutes 30
    """
    from drivers.historian import open_store
    from drivers.rig_file import load_rig
    from hil.run.session import console
    from hil.tower import Collected, collect_points

    out = console(stderr=True)
    loaded = load_rig(rig)
    done = Collected()

    def note(now: Collected) -> None:
        nonlocal done
        done = now

    with open_store(into, create=True, say=lambda text: out.print(text, markup=False, soft_wrap=True)) as store:
        out.print(f"{len(loaded.point)} points into {Path(into).name or into}; Ctrl-C ends", markup=False)
        with contextlib.suppress(KeyboardInterrupt):
            asyncio.run(
                collect_points(loaded, store, every_s=every_s or loaded.period_s, minutes=minutes, progress=note)
            )
    lost = f"; the store was away {done.away} times" if done.away else ""
    failed = f"; {done.failures} polls failed, the last: {done.last_failure}" if done.failures else ""
    click.echo(f"{done.samples} samples of {done.polls} polls stored{lost}{failed}")
