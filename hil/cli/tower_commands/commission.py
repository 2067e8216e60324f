"""`hil tower commission`: the clean cell from its test points and datasheet, as a twin file."""

from __future__ import annotations

from pathlib import Path

import click

from hil.cli.options import INPUT_FILE


@click.command()
@click.argument("record", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--cell", required=True, type=int, help="Number of the cell.")
@click.option("--datasheet", required=True, type=INPUT_FILE, help="Datasheet of the station, JSON.")
@click.option("--points", required=True, type=INPUT_FILE, help="Test points of the clean cells, CSV.")
@click.option("--out", required=True, type=click.Path(path_type=Path, dir_okay=False), help="Twin file to write.")
@click.option("--healthy", metavar="FROM..TO", help="Days of RECORD on which the cell was clean.")
def command(record: Path, cell: int, datasheet: Path, points: Path, out: Path, healthy: str | None) -> None:
    """Fit the clean cell to its test points and write its twin file.

    RECORD is the aligned record of the station; it must hold the cell. The Merkel number and its exponent are fitted
    to the outlet temperatures; air flow, fan power and evaporation follow from what was measured of them. A fit that
    describes no cooling tower is refused.

    With --healthy the twin's own error is learned from these days and kept beside the twin file, as
    <name>.healthy.json. A calibration with this twin subtracts it and carries its uncertainty.

    \b
    Example:
      hil tower commission record --cell 1 --datasheet datasheet.json --points commissioning.csv --out cell1.toml
      hil tower commission record --cell 1 ... --out cell1.toml --healthy 2022-05-01..2022-05-15
    """
    from hil.record import RecordError
    from hil.run.session import console
    from hil.run_folder import RunFolderError, require_output
    from hil.tower import (
        TowerOutputError,
        cells_of,
        commission_cell,
        learn_healthy,
        parse_span,
        path_beside,
        write_healthy,
        writing,
    )
    from twin import save

    require_output(out, RunFolderError, (datasheet, points))
    span = None if healthy is None else parse_span(healthy)
    there = cells_of(record)
    if cell not in there:
        raise RecordError(f"{record}: has no cell {cell}; it has {', '.join(f'cell {n}' for n in there) or 'no cell'}")
    network, fitted, found = commission_cell(cell, datasheet, points)
    kept = None if span is None else learn_healthy(record, network, span)
    beside = path_beside(out, network)
    if kept is not None:
        require_output(beside, RunFolderError, (datasheet, points))
        if beside.exists():
            raise RecordError(
                f"{beside}: is a healthy record already, which another twin uses; give --out in another folder, or "
                "take it away"
            )
    save(network, out)
    if kept is not None:
        try:
            with writing(beside):
                write_healthy(kept, beside)
        except TowerOutputError:
            out.unlink(missing_ok=True)  # a twin without the healthy record that was asked for
            raise
    terminal, design = console(), fitted.design
    terminal.print(
        f"cell {cell}: Merkel number {design.merkel:.3f}, exponent {design.exponent:.3f}, air {design.m_a0:.1f} "
        f"kg/s, fan "
        f"{design.power:.1f} kW and {design.idle:.2f} kW at any speed, evaporation {design.evaporation:.3f} of "
        f"Merkel's",
        markup=False,
    )
    worst = max(range(len(found.names)), key=lambda k: abs(fitted.residual[k]))
    terminal.print(
        f"{len(found.names)} test points: outlet RMSE {fitted.rmse:.3f} K, largest {fitted.residual[worst]:+.2f} K "
        f"at {found.names[worst]}",
        markup=False,
    )
    for remark in fitted.remarks:
        terminal.print(remark, markup=False)
    if kept is not None:
        terminal.print(
            f"healthy record: {(kept.end_s - kept.start_s) / 86400.0:.0f} days, {beside}",
            markup=False,
            soft_wrap=True,
        )
    terminal.print(f"written: {out}", markup=False, soft_wrap=True)
