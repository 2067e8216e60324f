"""Command `hil test`: verdicts of a test plan on a recorded run."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import click

from hil.cli.options import INPUT_FILE


@click.command()
@click.argument("plan", type=INPUT_FILE)
@click.option("--on", "run", type=click.Path(exists=True, file_okay=False, path_type=Path), help="Judge this run.")
@click.option("--json", "as_json", is_flag=True, help="Print verdict.json.")
def command(plan: Path, run: Path | None, as_json: bool) -> None:
    """Judge the limits of PLAN, a test plan, on a run.

    \b
    Example:
      hil test profiles/tests/cooling_steps.toml --on runs/20260520T120000Z-cooling_steps
    """
    from hil.run.session import judge_recorded
    from hil.run_folder import RunFolder, read_verdict
    from hil.testing import read_plan, result_lines

    assert run is not None
    folder = RunFolder(run)
    result = judge_recorded(read_plan(plan), folder)
    if as_json:
        click.echo(json.dumps(read_verdict(folder), indent=1))
    else:
        for line in result_lines(result):
            click.echo(line)
    sys.exit(0 if result.verdict == "pass" else 1)
