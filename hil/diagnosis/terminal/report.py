"""Report of a diagnosis in the terminal."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table
from rich.text import Text

from hil.diagnosis.terminal.table import error_table, errors_of, held_out
from hil.diagnosis.wording import after_label, ambiguity_group, likeness, reasons
from twin.discovery import Diagnosis


def _number(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 10_000.0 else f"{value:.4g}"


def _since(onset_s: float, d: Diagnosis) -> str:
    return f"{onset_s / 3600.0:.2f} h" if d.method == "contest" else "start"


def print_diagnosis(to: Console, d: Diagnosis) -> None:
    """Print verdict, effects, other explanations, errors on the held-out segment and the next experiment."""
    document = d.document()
    for warning in d.warnings:
        to.print(f"warning: {warning}", style="yellow", soft_wrap=True)
    to.print(Text.assemble((d.verdict, "bold"), f": {d.summary}"), soft_wrap=True)
    for note in d.notes:
        to.print(note, soft_wrap=True)
    for lead in d.leads:
        to.print(f"lead: {lead.says}", soft_wrap=True)
    if d.effects:
        table = Table(title="Effects", title_justify="left")
        for heading in ("kind", "place", "driver", "change", "size", "90 %", "onset", "z"):
            table.add_column(heading, justify="right" if heading in ("size", "90 %", "onset", "z") else "left")
        for e in d.effects:
            low, high = e.interval90
            size = f"{_number(e.value)} {e.unit}".removesuffix(" 1")
            table.add_row(
                e.kind,
                e.where,
                e.driver,
                e.change,
                size,
                f"{_number(low)} to {_number(high)}",
                _since(e.onset_s, d),
                f"{e.z:.0f}",
            )
        to.print(table)
    for reason in reasons(document):
        to.print(reason, soft_wrap=True)
    if d.indistinguishable or d.alternatives:
        table = Table(title="Other explanations", title_justify="left")
        for heading in ("kind", "place", "driver", "reason for rejection"):
            table.add_column(heading)
        for one in ambiguity_group(document):
            table.add_row(one["kind"], one["where"], one["driver"], likeness(document, one), style="bold")
        for a in d.alternatives[:8]:
            table.add_row(a.kind, a.where, a.driver, a.why_not)
        to.print(table)
    to.print(held_out(document), style="italic", soft_wrap=True)
    to.print(errors_of(document))
    for one in document["further_records"]:
        title = f"RMSE in K, free run over {one['record']}, not used for the effect's fit"
        to.print(title, style="italic", soft_wrap=True)
        to.print(error_table(one["sensors"], "with the effect" if d.network is not None else "re-tuned"))
    far = [m for m in d.moved if d.method == "contest" and max(abs(m.before_sd), abs(m.after_sd)) > 3.0]
    if far and d.effects and after_label(document) != "re-tuned":
        table = Table(title="Changed tunables, in standard deviations of commissioning", title_justify="left")
        for heading in ("parameter", "commissioned", "re-tuned alone", "with the effect", "unit"):
            table.add_column(heading, justify="left" if heading in ("parameter", "unit") else "right")
        for m in far:
            table.add_row(
                m.parameter,
                f"{m.commissioned:.4g}",
                f"{m.before:.4g} ({m.before_sd:+.0f})",
                f"{m.after:.4g} ({m.after_sd:+.0f})",
                m.unit,
            )
        to.print(table)
    if d.next_experiment:
        to.print(f"next experiment: {d.next_experiment['why']}", soft_wrap=True)
        for group in d.next_experiment.get("stay_alike", ()):
            measured = " or ".join(d.next_experiment["measure"])
            to.print(f"no input distinguishes {group}; {measured} would", soft_wrap=True)
    for spot in d.blind_spots:
        to.print(f"blind spot: {spot}", soft_wrap=True)
