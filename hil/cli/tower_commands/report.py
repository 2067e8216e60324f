"""`hil tower report`: the report of a calibration."""

from __future__ import annotations

from pathlib import Path

import click


@click.command()
@click.argument("out", type=click.Path(exists=True, file_okay=False, path_type=Path))
def command(out: Path) -> None:
    """Print the report of OUT, the folder of a calibration, and write it to OUT/report.md.

    The chain of the records is checked: a line that was changed or removed is reported.

    \b
    Example:
      hil tower report out
    """
    from hil.files.atomic import replacing
    from hil.run.session.terminal import console
    from hil.tower.report import REPORT, report

    text = report(out)
    with replacing(out / REPORT) as unfinished:
        unfinished.write_text(text)
    console().print(text, markup=False)
