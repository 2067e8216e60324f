"""`hil tower report`: the report of a calibration."""

from __future__ import annotations

from pathlib import Path

import click

from hil.cli.options import INPUT_FILE


@click.command()
@click.argument("out", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--picture", type=click.Path(path_type=Path, dir_okay=False), help="Draw a cell over time, .png or .svg.")
@click.option("--cell", type=int, help="Cell of the picture; default: the first.")
@click.option("--labels", type=INPUT_FILE, help="Inspections, traverses and certificates for the picture, CSV.")
@click.option(
    "--truth", type=INPUT_FILE, help="Truth of a station, Parquet as of hil tower simulate --score: table and picture."
)
def command(out: Path, picture: Path | None, cell: int | None, labels: Path | None, truth: Path | None) -> None:
    """Print the report of OUT, the folder of a calibration, and write it to OUT/report.md.

    The chain of the records is checked up to its end: a line that was changed, added or removed is reported.

    \b
    Example:
      hil tower report out
      hil tower report out --picture cell1.png --cell 1 --labels labels.csv
    """
    from hil.files import held, replacing
    from hil.record import RecordError
    from hil.run.session import console
    from hil.run_folder import RunFolderError, require_output
    from hil.tower import (
        NETWORK_TABLE,
        REPORT,
        TABLE,
        TowerOutputError,
        compare,
        draw_cell,
        read_events,
        read_minutes,
        read_remarks,
        read_truth,
        report_text,
        writing,
    )

    if picture is not None:
        if picture.suffix.lower() not in (".png", ".svg"):
            raise click.UsageError(f"{picture}: a picture is a .png or an .svg; choose one")
        read = [path for path in (labels, truth) if path is not None]
        require_output(picture, RunFolderError, [*read, *out.iterdir()])
    true = None if truth is None else read_truth(truth)
    remedy = "calibrate again"
    needed = ("t_out", "t_out_lo", "t_out_hi", "t_out_commissioned", "fill", "air", "uniformity", "bias")
    wanted = picture is not None or true is not None
    with writing(out), held(out, TowerOutputError):
        text = report_text(out)
        found = read_minutes(out / TABLE, needed, remedy) if wanted else {}
        asked = wanted and (out / NETWORK_TABLE).is_file()
        network = read_minutes(out / NETWORK_TABLE, needed, remedy) if asked else {}
        if true is not None:
            text += "\n" + "\n".join(compare(found, true, network)) + "\n"
        with replacing(out / REPORT) as unfinished:
            unfinished.write_text(text)
    console().print(text, markup=False)
    if picture is None:
        return
    drawn = min(found) if cell is None else cell
    if drawn not in found:
        have = ", ".join(str(one) for one in found)
        raise RecordError(f"{out}: has no cell {drawn}; its cells are {have}")
    of_truth = None if true is None else true.get(drawn)
    with writing(picture):
        draw_cell(
            found[drawn],
            picture,
            cell=drawn,
            truth=of_truth,
            labels=labels,
            events=read_events(out),
            network=network.get(drawn),
            remarks=read_remarks(out / TABLE).get(drawn, ()),
        )
    click.echo(f"written: {picture}")
