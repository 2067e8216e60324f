"""`hil tower calibrate`: deviations of cells from their clean twins, on an aligned record."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hil.cli.options import INPUT_CARD, INPUT_FILE

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from rich.table import Table

    from hil.tower import CellGovernance, NetworkGovernance, NetworkMode


BALANCE = {
    "NO_MAKEUP": "no make-up flow is recorded",
    "NO_BASIN": "the datasheet gives no basin.volume_m3",
    "NOT_ALL_CELLS": "not all cells of the station are calibrated",
    "NO_WHOLE_SUM": "no six hours running have all flows",
    "NOT_CLOSED": "most of its sums contradict the cells",
}
"""Reasons for which the water balance is not used, in words."""


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
@click.option(
    "--network",
    "card",
    type=INPUT_CARD,
    metavar="CARD",
    help="Card (.json) of a network ensemble for cooling-tower cells, such as profiles/trained/tower_small; its "
    "proposals stand beside those of Gauss-Newton.",
)
@click.option(
    "--network-mode",
    type=click.Choice(("shadow", "advisory", "controlled")),
    default="shadow",
    show_default=True,
    help="Use of the network's proposals, as --mode; one of both at most is controlled.",
)
@click.option("--propose-reverted", is_flag=True, help="Propose values again that `hil twin revert` undid.")
@click.option("--replace", is_flag=True, help="Remove another calibration that OUT holds, with its records.")
def command(
    record: Path,
    twins: tuple[Path, ...],
    out: Path,
    labels: Path | None,
    events: Path | None,
    mode: str,
    card: Path | None,
    network_mode: NetworkMode,
    propose_reverted: bool,
    replace: bool,
) -> None:
    """Calibrate cells on RECORD, the aligned record of their station.

    Writes OUT/calibrated.parquet, the outlet with its 90 % interval and the deviations by minute, OUT/records.jsonl,
    a record for every five minutes, OUT/events.json and OUT/review_queue.json. In the controlled mode a deviation that
    passes all gates is saved as a revision of the twin; `hil twin revert` undoes it. A value that was reverted is not
    proposed again until a new day of the record or a new label shows it, or with --propose-reverted.

    OUT belongs to one calibration: the same twins, labels, events and modes. When RECORD goes on beyond the former
    one, records of the new times are appended. Anything else is refused there unless --replace is given.

    With --network, OUT/network.parquet holds the network's outlet and deviations with 90 % intervals by its symmetric
    branch, OUT/network_records.jsonl those of its causal branch. The twins need a healthy record that RECORD holds. An
    ensemble with a member that ignores its channels (BLIND) only runs in the shadow mode.

    \b
    Example:
      hil tower calibrate record --twin cell1.toml --twin cell2.toml --labels labels.csv --out out
      hil tower calibrate record --twin cell1.toml --out out --network profiles/trained/tower_small
    """
    from hil.files import held, replacing_all
    from hil.tower import (
        TABLE,
        TowerOutputError,
        adopt_accepted,
        ask_network,
        calibrate_station,
        cells_of,
        check_network,
        continue_chains,
        govern,
        is_of_calibration,
        require_same,
        sources_of,
        unused_labels,
        write_about,
        write_network_table,
        write_table,
        writing,
    )

    if mode == network_mode == "controlled":
        raise click.UsageError(
            "--mode controlled and --network-mode controlled would both revise the twins; choose one"
        )
    if card is None and network_mode != "shadow":
        raise click.UsageError(f"--network-mode {network_mode} needs a network; name its card with --network")
    if card is not None:
        check_network(card, network_mode, record, twins)
    sources = sources_of(record, twins, labels=labels, events=events, card=card, modes=(mode, network_mode))
    with writing(out), held(out, TowerOutputError):
        continued = not replace and require_same(out, sources)
        results, notes = calibrate_station(record, twins, labels, events)
        if labels is not None:
            times = [time_s for one in results for time_s in (one.minutes.time_s[0], one.minutes.time_s[-1])]
            for remark in unused_labels(labels, cells_of(record), (min(times), max(times))):
                _note(remark)
        asked = None if card is None else ask_network(card, results, notes, network_mode, _note)
        with replacing_all(out, is_of_calibration) as part:
            if continued:
                continue_chains(out, part)
            write_table(results, part)
            if asked is not None:
                write_network_table(asked, results, part)
            governed = govern(results, notes, part, mode, asked, propose_reverted)
            write_about(part, sources)
        governed = adopt_accepted(governed, mode, network_mode)
    _show(governed, out / TABLE)


def _note(text: str) -> None:
    """Print what goes on, beside the results."""
    click.echo(text, err=True)


def _show(cells: Sequence[CellGovernance], path: Path) -> None:
    import numpy as np
    from rich.table import Table

    from hil.run.session import console
    from hil.tower import step_sentence
    from twin.tower import DEVIATIONS
    from twin.tower.calibration import NORMAL

    terminal = console()
    table = Table(
        title="Deviations at the end of the record with 90 % intervals, and the outlet's error against its readings",
        title_justify="left",
    )
    for heading in ("cell", "calibrator", *DEVIATIONS, "error before K", "after K", "windows held back"):
        table.add_column(heading)
    for one in cells:
        c, m = one.result.calibrated, one.result.minutes
        last = int(np.flatnonzero(m.known)[-1])
        values = [f"{c.deviations[last, j] + (j < 3):.3f} ± {NORMAL * c.sd[last, j]:.3f}" for j in range(4)]
        before = np.nanmean(np.abs(m.outlet - c.commissioned))
        after = np.nanmean(np.abs(m.outlet - c.deviations[:, 3] - c.t_out))
        held = ", ".join(f"{name} {100 * share:.0f} %" for name, share in one.withheld.items())
        table.add_row(str(one.result.cell), "Gauss-Newton", *values, f"{before:.3f}", f"{after:.3f}", held)
        if one.network is not None:
            _add_network(table, one.network, m.outlet - c.commissioned)
    terminal.print(table)
    for one in cells:
        for step in one.result.steps:
            if step.lasting:
                terminal.print(f"cell {one.result.cell}: {step_sentence(step)}", markup=False, soft_wrap=True)
        for text in one.alarm_lines:
            terminal.print(f"cell {one.result.cell}: {text}", markup=False, soft_wrap=True)
        if refused := one.low_sensitivity:
            terminal.print(f"cell {one.result.cell}: {refused}", markup=False, soft_wrap=True)
        if one.network is not None and one.network.blind:
            terminal.print(
                f"cell {one.result.cell}: the network's proposals are held back: {', '.join(one.network.blind)} "
                "ignores its channels (BLIND)",
                markup=False,
                soft_wrap=True,
            )
        if one.network is not None and one.network.outlet:
            terminal.print(f"cell {one.result.cell}: network: {one.network.outlet}", markup=False, soft_wrap=True)
        if one.balance:
            terminal.print(
                f"cell {one.result.cell}: the station's water balance is not used, since {BALANCE[one.balance]} "
                f"({one.balance})",
                markup=False,
                soft_wrap=True,
            )
        for remark in one.remarks:
            terminal.print(f"cell {one.result.cell}: {remark}", markup=False, soft_wrap=True)
        if one.revision is not None:
            terminal.print(f"written: {one.revision}", markup=False, soft_wrap=True)
    terminal.print(f"written: {path}", markup=False, soft_wrap=True)


def _add_network(table: Table, network: NetworkGovernance, before: NDArray[np.float64]) -> None:
    """Add the row of a network: its last answer, and its error on the minutes that it answered."""
    import numpy as np

    from twin.tower.calibration import NORMAL

    last = network.last
    values = ["-"] * 4 if last is None else [f"{v:.3f} ± {NORMAL * sd:.3f}" for _, v, sd in network.proposals(last)]
    residual = network.residual()
    there = np.isfinite(residual) & np.isfinite(before)
    errors = [f"{np.abs(e[there]).mean():.3f}" if there.any() else "-" for e in (before, residual)]
    held = ", ".join(f"{name} {100 * share:.0f} %" for name, share in network.withheld.items())
    table.add_row(str(network.result.cell), "network", *values, *errors, held)
