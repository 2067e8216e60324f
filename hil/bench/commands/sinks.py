"""Command `hil bench sinks`: the cost of streams, alarms, panel and exports."""

from __future__ import annotations

from pathlib import Path

import click

from hil.bench.commands.output import JSON, OUT, QUICK, SEED, finish


@click.command("sinks")
@click.option(
    "--to", "stores", metavar="ADDRESS", multiple=True, help="Store, as of `hil stream --to`; may be repeated."
)
@QUICK
@SEED
@OUT
@JSON
def sinks_command(stores: tuple[str, ...], quick: bool, seed: int, out: Path | None, as_json: bool) -> None:
    """Measure the cost of followers to a run at 10 Hz, of a panel with twenty viewers, and of exports of 40 hours.

    OPC UA, alarms and panel need nothing else. MQTT and PostgreSQL are measured with the stores that --to names.

    \b
    Example:
      hil bench sinks --quick
      hil bench sinks --to mqtt://127.0.0.1/bench --to postgresql://hil@127.0.0.1/bench --out docs/results
    """
    from hil.bench import sinks
    from hil.run.session import ProgressBar

    with ProgressBar("measuring", 1.0, quiet=as_json) as steps:
        tables, skipped = sinks.measure(sinks.QUICK if quick else sinks.FULL, stores, steps.update)
    missing = {"mqtt": "MQTT", "postgresql": "PostgreSQL"}
    absent = [name for scheme, name in missing.items() if not any(store.startswith(scheme) for store in stores)]
    finish("sinks", seed, tables, (*skipped, *(f"{name}: no --to names such a store" for name in absent)), out, as_json)
