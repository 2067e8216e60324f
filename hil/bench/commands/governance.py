"""Bench of a tower's governance as a calibration goes on."""

from __future__ import annotations

from pathlib import Path

import click

from hil.bench.commands.output import JSON, OUT, QUICK, SEED, data_folder, finish


@click.command("tower-governance")
@click.option(
    "--work",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("runs/bench/tower_governance"),
    show_default=True,
    help="Folder that keeps finished stations.",
)
@QUICK
@SEED
@OUT
@JSON
def tower_governance_command(work: Path, quick: bool, seed: int, out: Path | None, as_json: bool) -> None:
    """Calibrate simulated stations again and again as their records grow, and score what was known at each time.

    The fill of a cell is lost by 12 % within 30 days, and nozzles plug and are cleaned. Further stations wear as
    usual. Rows A17, A19, A20 and A21 of `hil bench tower-rows` read the result. An interrupted
    trial continues in --work.

    \b
    Example:
      hil bench tower-governance --quick
      hil bench tower-governance --out docs/results
    """
    from hil.bench import tower_governance
    from hil.bench.measure import code_state
    from hil.run.session import ProgressBar

    size = tower_governance.QUICK if quick else tower_governance.FULL
    folder = data_folder() / "weather"
    code = code_state("tower-governance").digests
    with ProgressBar("stations", 1.0, quiet=as_json) as steps:
        tables = tower_governance.measure(size, seed, work, folder if folder.is_dir() else None, code, steps.update)
    finish("tower_governance", seed, tables, (), out, as_json)
