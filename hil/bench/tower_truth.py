"""Errors and intervals of a tower's calibration against the truth of a simulated station."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.bench.measure import Cell, ReportTable
from hil.tower import CellResult, StationNotes, TruthColumns, govern, informed, read_truth
from twin.tower import DAY_S, DEVIATIONS, NORMAL, QUANTILE, WET_C, Array

OUTLET = ("cell", "part", "minutes", "commissioned K", "calibrated K", "p90 K", "within 90 %", "width K", "score K")
DEVIATION = ("cell", "deviation", "MAE", "mean sd", "within 90 %", "rms error / sd", "withheld %")
SEASONS = {"winter": (12, 1, 2), "spring": (3, 4, 5), "summer": (6, 7, 8), "autumn": (9, 10, 11)}
FEWEST = 2000
"""Minutes of a part below which it has no row: a day and a half, whose coverage is that of one weather."""
COVERAGE, IN_EACH = (0.88, 0.92), (0.85, 0.95)
"""Goals for the share of the outlet within its 90 % interval: in all, and in each part."""


@dataclass(frozen=True)
class Outlet:
    """Minutes of a cell that ran and were predicted: truth, prediction, bounds, prediction by the clean cell, degC;
    wet bulb degC and month."""

    true: Array
    found: Array
    low: Array
    high: Array
    commissioned: Array
    wet: Array
    month: NDArray[np.intp]

    def figures(self, rows: NDArray[np.bool_]) -> tuple[Cell, ...]:
        """Return the figures of a row of the table, of these minutes."""
        true, low, high = self.true[rows], self.low[rows], self.high[rows]
        error = np.abs(self.found[rows] - true)
        penalty = 2.0 / (1.0 - QUANTILE) * (np.maximum(low - true, 0.0) + np.maximum(true - high, 0.0))
        return (
            int(rows.sum()),
            float(np.abs(self.commissioned[rows] - true).mean()),
            float(error.mean()),
            float(np.quantile(error, 0.9)),
            float(np.mean((low <= true) & (true <= high))),
            float(np.mean(high - low)),
            float(np.mean(high - low + penalty)),
        )


def outlet_of(result: CellResult, truth: TruthColumns) -> Outlet:
    """Return the outlet of a cell beside its truth."""
    c, m = result.calibrated, result.minutes
    times = truth["time"].astype("datetime64[ms]").astype(np.float64) / 1e3
    _, mine, its = np.intersect1d(np.round(m.time_s), np.round(times), return_indices=True)
    there = truth["running"][its].astype(bool) & np.isfinite(c.t_out[mine])
    mine, its = mine[there], its[there]
    month = (m.time_s[mine].astype("datetime64[s]").astype("datetime64[M]").astype(np.intp)) % 12 + 1
    return Outlet(
        truth["t_out"][its],
        c.t_out[mine],
        c.low[mine],
        c.high[mine],
        c.commissioned[mine],
        m.operation.inputs.wet[mine],
        month,
    )


def against_truth(results: Sequence[CellResult], notes: StationNotes, path: Path) -> list[ReportTable]:
    """Return tables of the outlet by regime and season, of the deviations, and of the goals.

    Raises
    ------
    RecordError
        The truth cannot be read.
    """
    truth = read_truth(path)
    outlet: list[tuple[Cell, ...]] = []
    deviations: list[tuple[Cell, ...]] = []
    for result in results:
        if result.cell not in truth:
            continue
        outlet += _outlet_rows(result.cell, outlet_of(result, truth[result.cell]))
        deviations += _deviation_rows(result, truth[result.cell])
    return [
        ReportTable(
            "outlet",
            "Outlet against the truth, readings of the own window hidden",
            OUTLET,
            tuple(outlet),
            ("score: interval score of Gneiting & Raftery 2007, width and twenty times what lies outside",),
        ),
        ReportTable(
            "deviations",
            "Deviations against the truth, day by day",
            DEVIATION,
            tuple(deviations),
            ("shares of the clean cell, and K for the bias; days whose value is withheld are left out",),
        ),
        _withheld_table(results, notes),
        ReportTable("goals", "Goals", ("goal", "found", "reached"), tuple(_goals(outlet))),
    ]


def _outlet_rows(cell: int, o: Outlet) -> list[tuple[Cell, ...]]:
    everything = np.ones(len(o.true), dtype=bool)
    parts: list[tuple[str, NDArray[np.bool_]]] = [("all", everything)]
    edges = (-np.inf, *WET_C, np.inf)
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        name = f"below {high:g} degC" if low == -np.inf else f"{low:g} degC on" if high == np.inf else None
        parts.append((f"wet bulb {name or f'{low:g} to {high:g} degC'}", (o.wet >= low) & (o.wet < high)))
    parts += [(name, np.isin(o.month, months)) for name, months in SEASONS.items()]
    return [(str(cell), name, *o.figures(rows)) for name, rows in parts if rows.sum() >= FEWEST]


def _deviation_rows(result: CellResult, truth: TruthColumns) -> list[tuple[Cell, ...]]:
    times = truth["time"].astype("datetime64[ms]").astype(np.float64) / 1e3
    rows = np.flatnonzero(np.diff(np.floor(result.minutes.time_s / DAY_S), prepend=-1.0) > 0.0)
    found: list[tuple[Cell, ...]] = []
    for j, name in enumerate(DEVIATIONS):
        value, sd = (v[rows] for v in informed(result, j))
        true = np.interp(result.minutes.time_s[rows], times, truth[name]) - (0.0 if name == "bias" else 1.0)
        stated = np.isfinite(value)
        share = 100.0 * float(1.0 - stated.mean())
        if not stated.any():
            found.append((str(result.cell), name, None, None, None, None, share))
            continue
        error, sd = value[stated] - true[stated], sd[stated]
        inside = float(np.mean(np.abs(error) <= NORMAL * sd))
        spread = float(np.sqrt(np.mean((error / sd) ** 2)))
        found.append((str(result.cell), name, float(np.abs(error).mean()), float(sd.mean()), inside, spread, share))
    return found


def _withheld_table(results: Sequence[CellResult], notes: StationNotes) -> ReportTable:
    """Return the shares of windows that a gate withholds, by reason code."""
    rows: list[tuple[Cell, ...]] = []
    with tempfile.TemporaryDirectory() as folder:
        for one in govern(results, notes, Path(folder), "shadow"):
            count: Counter[str] = Counter()
            for verdict in one.verdicts:
                count.update({*verdict.codes, *(code for codes in verdict.of.values() for code in codes)})
            n = max(len(one.verdicts), 1)
            rows += [(str(one.result.cell), code, 100.0 * k / n) for code, k in count.most_common()]
    return ReportTable("withheld", "Windows with each reason code", ("cell", "code", "% of windows"), tuple(rows))


def _goals(outlet: Sequence[tuple[Cell, ...]]) -> list[tuple[Cell, ...]]:
    """Return each goal for the intervals of the outlet with the figure, whether it is reached or not."""
    found: list[tuple[Cell, ...]] = []
    for row in outlet:
        cell, part, share = str(row[0]), str(row[1]), row[6]
        low, high = COVERAGE if part == "all" else IN_EACH
        if isinstance(share, float):
            reached = "yes" if low <= share <= high else "no"
            found.append((f"cell {cell}, {part}: {low:g} to {high:g} within 90 %", share, reached))
    return found
