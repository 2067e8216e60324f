"""`hil tower calibrate`: deviations of cells from their clean twins, on an aligned record."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hil.cli.options import INPUT_FILE

if TYPE_CHECKING:
    from hil.tower import CellGovernance


@click.command()
@click.argument("record", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option(
    "--twin", "twins", required=True, multiple=True, type=INPUT_FILE, help="Twin file of a cell; may be repeated."
)
@click.option("--out", required=True, type=click.Path(path_type=Path, file_okay=False), help="Folder of the results.")
@click.option("--labels", type=INPUT_FILE, help="Inspections, traverses and certificates, CSV.")
@click.option("--events", type=INPUT_FILE, help="Events, CSV; default: those of the record.")
@click.option(
    "--mode",
    type=click.Choice(("shadow", "advisory", "controlled")),
    default="shadow",
    show_default=True,
    help="Records alone; the review queue too; revisions of the twins too.",
)
def command(
    record: Path, twins: tuple[Path, ...], out: Path, labels: Path | None, events: Path | None, mode: str
) -> None:
    """Calibrate cells on RECORD, the aligned record of their station.

    Writes OUT/calibrated.parquet, the outlet with its 90 % interval and the deviations by minute, OUT/records.jsonl,
    a record for every five minutes, and OUT/review_queue.json. In the controlled mode a deviation that passes all
    gates is saved as a revision of the twin; `hil twin revert` undoes it.

    \b
    Example:
      hil tower calibrate record --twin cell1.toml --twin cell2.toml --labels labels.csv --out out
    """
    from hil.tower import RECORDS, calibrate_station, check_records, govern, write_table, writing

    if out.is_dir():
        check_records(out / RECORDS)
    results, notes = calibrate_station(record, twins, labels, events)
    with writing(out):
        path = write_table(results, out)
        governed = govern(results, notes, out, mode)
    _show(governed, path)


def _show(cells: Sequence[CellGovernance], path: Path) -> None:
    import numpy as np
    from rich.table import Table

    from hil.run.session import console
    from hil.tower import iso
    from twin.tower import DEVIATIONS

    terminal = console()
    table = Table(
        title="Deviations at the end of the record, and the outlet's error against its readings", title_justify="left"
    )
    for heading in ("cell", *DEVIATIONS, "error before K", "after K", "held back"):
        table.add_column(heading)
    for one in cells:
        c, m = one.result.calibrated, one.result.minutes
        last = int(np.flatnonzero(m.known)[-1])
        values = [f"{c.deviations[last, j] + (j < 3):.3f} ± {c.sd[last, j]:.3f}" for j in range(4)]
        before = np.nanmean(np.abs(m.outlet - c.commissioned))
        after = np.nanmean(np.abs(m.outlet - c.deviations[:, 3] - c.t_out))
        held = ", ".join(f"{name} {100 * share:.0f} %" for name, share in one.withheld.items())
        table.add_row(str(one.result.cell), *values, f"{before:.3f}", f"{after:.3f}", held)
    terminal.print(table)
    for one in cells:
        for step in one.result.steps:
            if step.lasting:
                subject = "the water" if step.kind == "water" else "the outlet thermometer"
                terminal.print(
                    f"cell {one.result.cell}: {subject} stepped by {step.size:+.2f} K at {iso(step.start_s)}",
                    markup=False,
                )
        for time_s, names in one.alarms:
            terminal.print(f"cell {one.result.cell}: drift alarm at {iso(time_s)}: {', '.join(names)}", markup=False)
        if refused := one.low_sensitivity:
            terminal.print(f"cell {one.result.cell}: {refused}", markup=False, soft_wrap=True)
        if one.balance:
            terminal.print(f"cell {one.result.cell}: the water balance is not used: {one.balance}", markup=False)
        if one.revision is not None:
            terminal.print(f"written: {one.revision}", markup=False, soft_wrap=True)
    terminal.print(f"written: {path}", markup=False, soft_wrap=True)
