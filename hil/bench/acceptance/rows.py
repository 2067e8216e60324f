"""Benchmark `hil bench tower-rows`: the table of all acceptance rows, published and measured here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from hil.bench.acceptance.calibration import calibration_rows
from hil.bench.acceptance.criteria import CRITERIA
from hil.bench.acceptance.governance import governance_rows
from hil.bench.acceptance.outcome import FAILED, NOT_MEASURED, REACHED, Outcome, Published, not_measured
from hil.bench.acceptance.outlet import outlet_rows
from hil.bench.acceptance.physics import physics_measures
from hil.bench.acceptance.stations import station_rows
from hil.bench.measure import Cell, ReportTable

CARD = Path(__file__).resolve().parents[3] / "profiles" / "trained" / "tower_small.json"
COLUMNS = (
    "row",
    "metric",
    "paper",
    "our gate",
    "ours",
    "class",
    "protocol",
    "seeds",
    "interval",
    "result",
    "source",
)
RESULT = COLUMNS.index("result")

NOTES = (
    "class: S can be shown on simulated stations, P in part or by an analogue, N not without the paper's plant",
    "protocol: P1 readings of the target hidden, P3 scored against the truth of the simulation, P4 window after window",
    "the paper's figures are of its own plants; ours are of simulated stations and say nothing of a real tower",
    "here: measured by this command; stations that no training saw, the answers of the shipped ensemble",
)


def assemble(
    results: Path, data: Path, seed: int, say: Callable[[float, str], None] | None
) -> tuple[tuple[ReportTable, ...], tuple[str, ...]]:
    """Return the table of all rows, and a line for everything left out.

    Parameters
    ----------
    results
        Folder of published results.
    data
        Folder of references and recordings.
    say
        Called with each stage; None assembles published results alone.

    Raises
    ------
    ValueError
        A page is no result of a bench.
    """
    published = Published(results)
    found: dict[str, Outcome] = outlet_rows(published) | calibration_rows(published) | governance_rows(published)
    left_out: list[str] = []
    if say is None:
        left_out.append("rows measured here: run without --no-measure")
    else:
        for key, measure in physics_measures(data).items():
            say(0.1, key)
            found[key] = measure()
        try:
            found |= station_rows(CARD, seed, lambda text: say(0.4, text))
        except ImportError:
            left_out.append("rows of simulated stations: torch is not installed; install the extra ml")
    return tables_of(found), tuple(left_out)


def tables_of(found: Mapping[str, Outcome]) -> tuple[ReportTable, ...]:
    """Return the table of all rows and their count by result.

    Parameters
    ----------
    found
        Outcomes by the key of `CRITERIA`; others were not measured.
    """
    rows: list[tuple[Cell, ...]] = []
    reasons: list[tuple[Cell, ...]] = []
    for key, criterion in CRITERIA.items():
        one = found.get(key) or not_measured("no published result has it")
        rows.append(
            (
                criterion.row,
                criterion.metric,
                criterion.paper,
                criterion.gate,
                one.ours,
                criterion.kind,
                one.protocol or "-",
                one.seeds or "-",
                one.interval or "-",
                one.verdict,
                one.source,
            )
        )
        if one.why:
            reasons.append((criterion.row, criterion.metric, one.verdict, one.why))
    counts = tuple(
        (verdict, sum(row[RESULT] == verdict for row in rows)) for verdict in (REACHED, FAILED, NOT_MEASURED)
    )
    return (
        ReportTable("rows", "Acceptance rows of the tower paper", COLUMNS, tuple(rows), NOTES),
        ReportTable("reasons", "Reasons and remarks", ("row", "metric", "result", "why"), tuple(reasons)),
        ReportTable("count", "Rows by result", ("result", "rows"), counts),
    )
