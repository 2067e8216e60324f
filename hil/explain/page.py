"""Page `explanation.html`: beliefs before and after each round, experiments, verdict and errors, in one file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from hil.diagnosis import PAGE_STYLE
from hil.explain.explanation import PAGE, Explanation, Round, SensorErrors
from hil.explain.figures import pictures
from hil.files import Html, document, element, image, joined, replacing

_WORDS = "td { overflow-wrap: break-word }"


def write_page(explanation: Explanation, folder: Path) -> Path:
    """Write `explanation.html` into the folder atomically, and return its path; raises OSError."""
    path = folder / PAGE
    with replacing(path) as temporary:
        temporary.write_text(page(explanation), encoding="utf-8")
    return path


def page(explanation: Explanation) -> str:
    """Return the whole page as HTML; the explanation has at least one round."""
    record = Path(explanation.record.path)
    title = f"Explanation of {record.parent.name}/{record.name}"
    drawn = pictures(explanation)
    return document(
        title,
        PAGE_STYLE + _WORDS,
        [
            element("h1", title),
            _verdict(explanation),
            _open_end(explanation),
            _overview(explanation),
            _picture("Beliefs after each round", drawn, "beliefs", _BELIEFS_NOTE),
            *(_round(one, drawn) for one in explanation.rounds),
            _errors(explanation.rounds),
            _paths(explanation),
        ],
    )


_BELIEFS_NOTE = (
    "Posterior share of each explanation, by kind and place, after the diagnosis with all records of the round."
)


def _verdict(explanation: Explanation) -> Html:
    last = explanation.last
    kind = last.verdict.replace(" ", "-")
    return element("div", element("b", last.verdict), element("p", last.summary), class_=f"verdict {kind}")


def _open_end(explanation: Explanation) -> Html:
    if explanation.end in ("settled", ""):
        return joined([])
    return element("p", f"Still open: {explanation.reason}", class_="warn")


def _overview(explanation: Explanation) -> Html:
    rows = []
    for one in explanation.rounds:
        did = f"experiment {one.ran.sentence}" if one.ran is not None else f"record {explanation.record.path}"
        rows.append([str(one.number), did, one.verdict, beliefs_text(one)])
    return joined([element("h2", "Rounds"), _table(["round", "new evidence", "verdict", "beliefs after it"], rows)])


def _round(one: Round, drawn: dict[str, str]) -> Html:
    parts: list[Html] = [element("h2", f"Round {one.number}: {one.verdict}")]
    if one.ran is not None:
        parts.append(element("p", f"Experiment {one.ran.sentence}."))
        parts.append(_note(one.ran.why))
        parts.append(_picture("", drawn, f"experiment-{one.number}", "Set-points of the experiment."))
    parts.append(element("p", one.summary))
    rows = [[b.label, share_text(b.share), _drivers(b.drivers), b.size] for b in one.beliefs]
    parts.append(_table(["explanation", "share", "follows", "size"], rows) if rows else joined([]))
    if one.next is not None and one.verdict == "ambiguous":
        plan = f"Next experiment {one.next.sentence}." if one.next.possible else one.next.why
        parts.append(_note(plan))
    return joined(parts)


def _errors(rounds: Sequence[Round]) -> Html:
    last = rounds[-1]
    low, high = (f"{s / 3600.0:.4g} h" for s in last.held_out_s)
    head = ["sensor", "baseline twin", "re-tuned", last.after, "noise"]
    rows = [_cells(name, errors) for name, errors in last.errors.items()]
    parts: list[Html] = [element("h2", "Error before and after")]
    parts.append(_note(f"RMSE in K of free runs over the held-out segment of the first record, {low} to {high}."))
    parts.append(_table(head, rows, 4))
    for record, sensors in last.further.items():
        # Only an effect that was found is in a twin that can be run over another record.
        with_answer = last.verdict == "effect found"
        rows = [_cells(name, errors, with_answer) for name, errors in sensors.items()]
        parts.append(_note(f"The same over all of {record}, to which no size of an effect was fitted."))
        parts.append(_table(head if with_answer else [*head[:3], "noise"], rows, 4 if with_answer else 3))
    return joined(parts)


def _cells(name: str, errors: SensorErrors, with_answer: bool = True) -> list[str]:
    after = [errors.after] if with_answer else []
    return [name, *(_kelvin(x) for x in (errors.baseline, errors.retuned, *after, errors.noise))]


def _kelvin(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f}"


def _paths(explanation: Explanation) -> Html:
    rows = [["record", explanation.record.path], ["twin", explanation.twin.path]]
    rows += [["healthy record", explanation.healthy.path]] if explanation.healthy else []
    for one in explanation.rounds:
        rows.append([f"diagnosis of round {one.number}", f"{one.folder}/diagnosis.html"])
        rows += [[f"experiment before round {one.number}", one.ran.profile]] if one.ran and one.ran.profile else []
    rows += [[f"record of experiment {n}", file.path] for n, file in enumerate(explanation.last.records, 1)]
    rows += [["revision of the twin", explanation.last.revision]] if explanation.last.revision else []
    return joined([element("h2", "Files"), _table(["", ""], rows)])


def _picture(title: str, drawn: dict[str, str], name: str, note: str) -> Html:
    if name not in drawn:
        return joined([])
    shown = image("svg+xml", drawn[name].encode(), title or note, name)
    return joined([*([element("h2", title)] if title else []), _note(note), shown])


def _note(text: str) -> Html:
    return element("p", text, class_="note")


def _table(head: Sequence[str], rows: Sequence[Sequence[str]], numbers: int = 0) -> Html:
    """Render a table; the last `numbers` columns are right-aligned."""
    first = len(head) - numbers

    def line(tag: str, cells: Sequence[str]) -> Html:
        return element("tr", *(element(tag, cell, class_="n" if i >= first else "") for i, cell in enumerate(cells)))

    return element("table", line("th", head), *(line("td", row) for row in rows))


def beliefs_text(one: Round) -> str:
    """Return the explanations of a round with their shares, as `heat source at heater 93 %, ...`."""
    return ", ".join(f"{b.label} {share_text(b.share)}" for b in one.beliefs) or "no effect"


def share_text(share: float | None) -> str:
    """Return a posterior share in per cent; "–" where none is given."""
    if share is None:
        return "–"
    # No line break before the sign.
    percent = f"{100.0 * share:.0f}" if 0.01 <= share <= 0.99 else "> 99" if share > 0.99 else "< 1"
    return f"{percent}\N{NO-BREAK SPACE}%"


def _drivers(drivers: dict[str, float | None]) -> str:
    if len(drivers) == 1:
        return next(iter(drivers))
    return ", ".join(f"{name} {share_text(share)}" for name, share in drivers.items())
