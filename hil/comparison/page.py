"""Page of a comparison: differences, drift of parameters, verdicts by requirement, and overlaid plots."""

from __future__ import annotations

import math
from pathlib import Path

from hil.comparison.differences import Comparison, Difference
from hil.files import Html, document, element, estimate_text, joined, replacing, table
from hil.report import HINT, PLOT_STYLE, SCRIPT, ZoomCurve, number, symbol, zoom_plot
from hil.run_folder import RunFolderError, require_output
from hil.testing import Matrix

COLOURS = ("#30343a", "#e07b1f", "#1f77c9", "#2a9d6f", "#8a4fbf", "#b03a5b", "#b8860b", "#0f8b8d")
_STYLE = (
    PLOT_STYLE
    + """
body { font: 15px/1.45 system-ui, sans-serif; max-width: 72rem; margin: 2rem auto; padding: 0 1rem; color: #22262b }
h1 { font-size: 1.5rem } h2 { font-size: 1.15rem; margin-top: 2rem }
table { border-collapse: collapse; display: block; width: fit-content; max-width: 100%; overflow-x: auto }
td, th { padding: .25rem .8rem; border-bottom: 1px solid #d8dce0; text-align: right }
td:first-child, th:first-child { text-align: left; white-space: nowrap }
p.note { color: #5b636b; font-size: .9rem }
.ERROR { color: #b3261e } .WARN { color: #9a6700 } .PASS { color: #1b6e3c }
"""
    + "\n".join(f".run{k} {{ color: {colour}; font-weight: 600 }}" for k, colour in enumerate(COLOURS))
    + "\n@media screen and (prefers-color-scheme: dark) { .run0 { color: #d9dee4 } }\n"
)


def write_comparison(made: Comparison, matrix: Matrix | None, path: Path) -> None:
    """Write the page of a comparison; `matrix` holds the verdicts of runs that were judged.

    Raises
    ------
    RunFolderError
        The page cannot be written there.
    """
    require_page(path)
    title = f"{len(made.runs)} runs compared"
    body = [element("h1", title), _legend(made), _verdicts(matrix), _differences(made), _drifts(made), _plots(made)]
    try:
        with replacing(path) as unfinished:
            unfinished.write_text(document(title, _STYLE, body, SCRIPT), encoding="utf-8")
    except OSError as error:
        raise RunFolderError(f"{path} cannot be written ({error.strerror}); choose another name with --out") from None


def require_page(path: Path) -> None:
    """Check that the page of a comparison may be written here, before the runs are read.

    Raises
    ------
    RunFolderError
        The path is a folder, a file of a run, or a file that is no page.
    """
    require_output(path, RunFolderError)
    if path.exists() and path.suffix.lower() not in (".html", ".htm"):
        raise RunFolderError(f"{path} exists and is no page; give --out a name that ends with .html")


def _colour(number_of_run: int) -> int:
    return number_of_run % len(COLOURS)


def _legend(made: Comparison) -> Html:
    rows = [
        element("li", element("span", name, class_=f"run{_colour(k)}"), " (reference)" if k == 0 else "")
        for k, name in enumerate(made.runs)
    ]
    missing = f"Not in every run: {', '.join(made.only_in_some)}." if made.only_in_some else ""
    return joined([element("ol", *rows), element("p", missing, class_="note")])


def _verdicts(matrix: Matrix | None) -> Html:
    if matrix is None:
        return joined([])
    classes = {"pass": "PASS", "fail": "ERROR", "inconclusive": "WARN"}
    rows = [
        [matrix.heading(name), *(element("b", verdict, class_=classes[verdict]) if verdict else "-" for verdict in row)]
        for name, row in matrix.rows.items()
    ]
    return joined([element("h2", "Requirements"), table(["requirement", *matrix.runs], rows)])


def _differences(made: Comparison) -> Html:
    rows = [difference_row(made, item) for item in made.differences]
    note = (
        "Run minus reference on the same profile time, over the ticks on which both have a good value; differences of "
        "temperatures in K. Runs have their numbers of the list above."
    )
    return joined([element("h2", "Differences"), table(difference_head(made), rows), element("p", note, class_="note")])


def difference_head(made: Comparison) -> list[str]:
    """Return the headings of the table of differences; that of two runs needs no column for the run."""
    run = ["run"] if len(made.runs) > 2 else []
    return ["signal", *run, "unit", "mean", "reference", "mean difference", "RMS", "largest", "at / s", "common"]


def difference_row(made: Comparison, item: Difference) -> list[str]:
    """Return the cells of a difference under `difference_head`.

    A mean difference is rounded to the last of four digits of the RMS: the rest is noise.
    """
    bias = item.bias
    if bias is not None and item.rms:
        bias = round(bias, 3 - math.floor(math.log10(item.rms))) + 0.0  # no negative zero
    run = [str(made.runs.index(item.run) + 1)] if len(made.runs) > 2 else []
    values = (item.mean, item.reference_mean, bias, item.rms, item.largest)
    at = number(item.largest_at_s, "g")
    return [item.column, *run, symbol(item.unit), *map(number, values), at, f"{item.share:.1%}"]


def _drifts(made: Comparison) -> Html:
    if not made.drifts:
        return joined([])
    rows = []
    for drift in made.drifts:
        cells: list[Html | str] = [f"{drift.parameter} ({drift.calibrator})"]
        for value, half, beyond in zip(drift.values, drift.half_widths, drift.beyond, strict=True):
            text = number(value) if value is None or half is None else estimate_text(value, half)
            cells.append(element("b", text, class_="WARN") if beyond else text)
        rows.append(cells)
    note = "At the end of each run, ± 90 %. Marked: the change exceeds both intervals together."
    table_ = table(["parameter", *made.runs], rows)
    return joined([element("h2", "Drift of parameters"), table_, element("p", note, class_="note")])


def _plots(made: Comparison) -> Html:
    end_s = max((float(data.time_s[-1]) for data in made.data if len(data.time_s)), default=1.0)
    parts = [element("h2", "Signals over profile time / s"), element("p", HINT, class_="note")]
    for column, unit in made.units.items():
        curves = [
            ZoomCurve(name, COLOURS[_colour(k)], data.time_s, data.columns[column])
            for k, (name, data) in enumerate(zip(made.runs, made.data, strict=True))
        ]
        parts.append(zoom_plot(f"{column} / {symbol(unit)}".rstrip(" /"), curves, end_s))
    return joined(parts)
