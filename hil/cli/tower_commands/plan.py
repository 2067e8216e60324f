"""`hil tower plan`: the next step test of a cell."""

from __future__ import annotations

from pathlib import Path

import click

from hil.cli.options import INPUT_FILE

SHOWN = 6


@click.command()
@click.argument("record", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--twin", required=True, type=INPUT_FILE, help="Twin file of the cell, as calibrated.")
@click.option(
    "--warmer",
    type=click.FloatRange(0.1, 20.0),
    default=2.5,
    show_default=True,
    help="Most that the outlet may rise, K.",
)
def command(record: Path, twin: Path, warmer: float) -> None:
    """Propose the step test of fan and flow that makes a cell's deviations identifiable.

    Starts from the last 24 hours of RECORD in which the cell ran. The tests are those that let the outlet rise by no
    more than WARMER; the first lowers the condition number most. Above 80 a window is refused.

    \b
    Example:
      hil tower plan record --twin cell1.toml
    """
    from rich.table import Table

    from hil.run.session import console
    from hil.tower import plan_step_test
    from twin.tower import MOST_CONDITION
    from twin.tower.calibration import NORMAL

    found = plan_step_test(record, twin, warmer)
    terminal = console()
    terminal.print(
        f"cell {found.cell}: in the day up to {found.until} the condition number was {found.without.condition_says()}; "
        f"the combination of the deviations that it shows least is {found.without.says()}",
        markup=False,
    )
    if not found.tests:
        terminal.print(
            f"no test keeps the outlet within {warmer:g} K; allow more with --warmer or wait for a lower load",
            markup=False,
        )
        return
    if not found.enough:
        terminal.print(
            f"no test that keeps the outlet within {warmer:g} K brings the condition below {MOST_CONDITION:.0f}; allow "
            "more with --warmer, or give labels to hil tower calibrate: a certificate of the thermometer, a traverse, "
            "an inspection",
            markup=False,
            soft_wrap=True,
        )
    table = Table(
        title="Step tests, best first: 7 steps of 75 min at the usual load. Intervals are by that day and the test "
        "alone, without labels and the days before: compare tests by them. A calibration's are narrower",
        title_justify="left",
    )
    for heading in ("fan", "flow", "condition", "fill ± (90 %)", "outlet"):
        table.add_column(heading)
    for test in found.tests[:SHOWN]:
        table.add_row(
            f"{100 * test.fan:.0f} %",
            f"{100 * test.flow:.0f} %",
            test.told.condition_says(),
            f"{100 * NORMAL * test.told.sd['fill']:.1f} %",
            f"+{test.warmer:.1f} / -{test.colder:.1f} K",
        )
    terminal.print(table)
    best = found.tests[0]
    steps = "; ".join(
        f"{100 * speed:.0f} % {flow:.0f} kg/s" for speed, flow in zip(best.speeds, best.flows, strict=True)
    )
    terminal.print(f"steps of the first (fan speed, water flow): {steps}", markup=False)
