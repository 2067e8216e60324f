"""Report of an explanation in the terminal: table of the rounds, verdict, errors, paths and next command."""

from __future__ import annotations

import shlex
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from hil.explain.explanation import DOCUMENT, PAGE, Explanation
from hil.explain.page import beliefs_text


def print_explanation(to: Console, explanation: Explanation, folder: Path, again: str, rig: str) -> None:
    """Print all rounds and the end of an explanation.

    Parameters
    ----------
    folder
        Folder of its files.
    again
        Command that continues it.
    rig
        Options that name the rig for the experiments, where this command has none.
    """
    last = explanation.last
    to.print(_rounds(explanation))
    to.print(Text.assemble((last.verdict, "bold"), f": {last.summary}"), soft_wrap=True)
    to.print(_errors(explanation))
    if last.revision:
        to.print(f"revision of the twin: {shlex.quote(last.revision)}", soft_wrap=True, markup=False)
    to.print(f"page with pictures: {folder / PAGE}", soft_wrap=True, markup=False)
    to.print(f"for scripts: {folder / DOCUMENT}", soft_wrap=True, markup=False)
    for line in advice(explanation, again, rig):
        to.print(line, soft_wrap=True, markup=False)


def advice(explanation: Explanation, again: str, rig: str) -> list[str]:
    """Return the reason why the question is still open and the next command, a line each; nothing once settled."""
    plan = explanation.last.next
    if explanation.end == "not separable":
        return [f"no experiment: {explanation.reason}"]
    if explanation.end == "no rig" and plan is not None:
        return [
            f"experiment {plan.sentence}",
            f"as a load profile: {shlex.quote(plan.profile)}",
            f"to run it and go on: {again} {rig}",
            f"to go on with the record of it: {again} --with <the new run>",
        ]
    if explanation.end == "stopped":
        went_on = "with the record of the experiment once `hil resume` has completed it, else with a new run"
        return [f"{explanation.reason}; what is done is kept", f"to go on, {went_on}: {again}"]
    if explanation.end == "declined":
        return [f"{explanation.reason}; what is done is kept", f"to go on: {again}"]
    if explanation.end == "settled" and explanation.last.verdict == "effect found" and plan is not None:
        if plan.possible:
            return [f"its driver is still open; an experiment {plan.sentence} would settle it: {plan.profile}"]
        return [f"its driver is still open: {plan.why}"]
    return [explanation.reason] if explanation.end == "no more rounds" else []


def _rounds(explanation: Explanation) -> Table:
    table = Table(title="Rounds", title_justify="left", show_lines=True)
    table.add_column("round", justify="right")
    table.add_column("new evidence", ratio=2)
    table.add_column("verdict", no_wrap=True)
    table.add_column("beliefs after it", ratio=2)
    for one in explanation.rounds:
        did = "the record"
        if one.ran is not None:
            did = f"experiment {one.ran.sentence}"
        elif one.records:
            did = f"the record and {len(one.records)} later"
        table.add_row(str(one.number), did, one.verdict, beliefs_text(one))
    return table


def _errors(explanation: Explanation) -> Table:
    last = explanation.last
    table = Table(title="RMSE in K, held-out segment of the record", title_justify="left")
    table.add_column("sensor")
    for heading in ("baseline", "re-tuned", last.after, "noise"):
        table.add_column(heading, justify="right")
    for name, e in last.errors.items():
        cells = (e.baseline, e.retuned, e.after, e.noise)
        table.add_row(name, *("-" if cell is None else f"{cell:.3f}" for cell in cells))
    return table
