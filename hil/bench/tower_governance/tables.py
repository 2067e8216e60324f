"""Tables of the page: the rows' figures, and what they are made of."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from hil.bench.measure import Cell, ReportTable
from hil.bench.tower_governance.cases import CLEANING, PLAIN, RAMP, StationCase
from hil.bench.tower_governance.figures import (
    CONFIRMED,
    FALSE,
    OPEN,
    CleaningFigures,
    GateFigures,
    Judged,
    RampFigures,
    cleaning_figures,
    drift_alarms_of,
    false_losses,
    gate_figures,
    of_kind,
    persistent_proposals,
    ramp_figures,
    verdict_counts,
)
from hil.bench.tower_governance.known import CellTrial
from twin.tower import DEVIATIONS

YEAR_D = 365.25
CAUSAL = (
    "every value is that of a calibration on the minutes, events and labels before its time; the archive is aligned "
    "once, and a maintenance entry carries a day up to three days off"
)


def tables_of(cells: Sequence[CellTrial], cost: Sequence[tuple[StationCase, float, int]]) -> list[ReportTable]:
    """Return the tables of a trial.

    Parameters
    ----------
    cells
        Cells of all stations.
    cost
        Stations with their processor time, s, and number of calibrations.
    """
    ramps = [(one, ramp_figures(one)) for one in of_kind(cells, RAMP)]
    cleanings = [(one, trace) for one in of_kind(cells, CLEANING) for trace in cleaning_figures(one)]
    windows = [window for one in cells for state in one.known for window in state.windows]
    gates = gate_figures(windows)
    judged = [proposal for one in cells for proposal in persistent_proposals(one)]
    plain = of_kind(cells, PLAIN)
    return [
        _figures([r for _, r in ramps], plain, [t for _, t in cleanings], gates, judged),
        _ramps(ramps),
        _alarms(cells),
        _cleanings(cleanings),
        _gates(cells, gates),
        _proposals(judged),
        _judged(judged),
        _cost(cost),
    ]


def _figures(
    ramps: Sequence[RampFigures],
    plain: Sequence[CellTrial],
    cleanings: Sequence[CleaningFigures],
    gates: GateFigures,
    judged: Sequence[Judged],
) -> ReportTable:
    """Return the figures that the acceptance rows read."""
    losses = [(r.found_loss, r.true_loss) for r in ramps if r.found_loss is not None]
    adopted = [r.accepted_loss for r in ramps if r.accepted_loss is not None]
    errors = [abs(found - true) for found, true in losses]
    delays = [r.delay_d for r in ramps if r.delay_d is not None]
    years = sum(one.watched_days for one in plain) / YEAR_D
    drift, false = (sum(counts) for counts in _false_alarms(plain))
    first = [one for one in cleanings if one.when == "3 excited windows"]
    count = verdict_counts(judged)
    decided = count[CONFIRMED] + count[FALSE]
    rows: list[tuple[Cell, ...]] = [
        ("ramps", len(ramps)),
        ("loss of fill at the end, mean, %", _percent([found for found, _ in losses])),
        ("true loss of fill then, mean, %", _percent([true for _, true in losses])),
        ("mean absolute error of that loss, % of the clean fill", _percent(errors)),
        ("ramps with a proposal at the end", len(losses)),
        ("loss of fill accepted by the end, mean, %", _percent(adopted)),
        ("ramps proposed at 5 %", len(delays)),
        ("ramps proposed too early", sum(r.early for r in ramps)),
        ("mean delay at 5 %, d", float(np.mean(delays)) if delays else None),
        ("longest delay at 5 %, d", max(delays) if delays else None),
        ("ramps accepted at 5 %", sum(r.accepted_day is not None for r in ramps)),
        ("ramps with a drift alarm", sum(r.drift_alarms > 0 for r in ramps)),
        ("cell-years without a ramp", years),
        ("drift alarms without a ramp", drift),
        ("false proposals of 5 % without a ramp", false),
        ("false alarms a cell-year", (drift + false) / years if years > 0.0 else None),
        ("cleanings", len(first)),
        ("cleanings seen within 3 excited windows", sum(one.seen for one in first)),
        ("uniformity moved, median sd", float(np.median([c.moved["uniformity"] for c in first])) if first else None),
        ("largest other change, sd", max(c.others for c in first) if first else None),
        ("windows", gates.windows),
        ("windows withheld, %", 100.0 * gates.withheld),
        ("outlet MAE of accepted windows, K", gates.accepted_K),
        ("outlet MAE of withheld windows, K", gates.withheld_K),
        ("windows with an error above 0.5 K", gates.large),
        ("AUROC of the gates for these", gates.auroc),
        ("AUROC of the width for these", gates.width_auroc),
        ("persistent proposals", len(judged)),
        ("proposals confirmed", count[CONFIRMED]),
        ("proposals open", count[OPEN]),
        ("proposals false", count[FALSE]),
        ("precision of the decided", count[CONFIRMED] / decided if decided else None),
        ("proposals nearer to the truth than the value before", sum(one.nearer for one in judged)),
    ]
    notes = (
        CAUSAL,
        "proposed: fill of the last window in the review queue, whether gates accept it or an engineer has to decide",
        "accepted: fill of the last window that passed all of its gates, which the controlled mode adopts",
        "delay: from the minute at which the true fill falls below 0.95 to the calibration that first proposes it",
        "proposed too early, or false: the true loss is below 3.5 % then, 5 % less the tolerance of the row",
        "drift alarm: two indicators beyond their limits for a day, as `hil tower calibrate` raises it",
    )
    return ReportTable(
        "figures", "Figures of the acceptance rows A17, A19, A20 and A21", ("figure", "value"), tuple(rows), notes
    )


def _percent(shares: Sequence[float]) -> float | None:
    return 100.0 * float(np.mean(shares)) if shares else None


def _false_alarms(plain: Sequence[CellTrial]) -> tuple[list[int], list[int]]:
    return [len(drift_alarms_of(one)) for one in plain], [false_losses(one) for one in plain]


def _ramps(ramps: Sequence[tuple[CellTrial, RampFigures]]) -> ReportTable:
    rows: list[tuple[Cell, ...]] = []
    for cell, r in ramps:
        found = None if r.found_loss is None else 100.0 * r.found_loss
        rows.append(
            (
                cell.case,
                cell.station,
                100.0 * r.true_loss,
                found,
                None if found is None else found - 100.0 * r.true_loss,
                None if r.accepted_loss is None else 100.0 * r.accepted_loss,
                r.crossed_day,
                r.found_day,
                r.delay_d,
                r.accepted_day,
                r.drift_alarms,
            )
        )
    columns = (
        "case",
        "station",
        "true loss %",
        "found %",
        "error %",
        "accepted %",
        "5 % on day",
        "found on day",
        "delay d",
        "accepted on day",
        "drift alarms",
    )
    notes = (
        "12 % of the clean fill are lost from day 22 to day 52 beside the wear of the seed; other cells of the station "
        "have no ramp",
        "calibrated every fifth midnight, and at each midnight between the first proposal of 5 % and the one before",
    )
    return ReportTable("ramps", "Ramps of the fill in the simulated plant", columns, tuple(rows), notes)


def _alarms(cells: Sequence[CellTrial]) -> ReportTable:
    rows: list[tuple[Cell, ...]] = []
    for one in cells:
        alarms = drift_alarms_of(one)
        named = Counter(" and ".join(names) for _, names in alarms)
        rows.append(
            (
                one.case,
                one.station,
                one.cell,
                one.kind,
                one.watched_days,
                len(alarms),
                ", ".join(f"{n} {names}" for names, n in named.items()) or "none",
                false_losses(one),
            )
        )
    columns = (
        "case",
        "station",
        "cell",
        "kind",
        "days watched",
        "drift alarms",
        "their indicators",
        "false proposals of 5 %",
    )
    notes = (
        "watched: from the end of the healthy days to the last calibration",
        "no archive has seeded defects; wear, steps of thermometers and cleanings are those of the seed",
    )
    return ReportTable("alarms", "Alarms by cell", columns, tuple(rows), notes)


def _cleanings(cleanings: Sequence[tuple[CellTrial, CleaningFigures]]) -> ReportTable:
    rows: list[tuple[Cell, ...]] = [
        (
            cell.case,
            cell.station,
            trace.when,
            trace.day,
            trace.true,
            trace.found,
            *(trace.moved[name] for name in DEVIATIONS),
            "yes" if trace.seen else "no",
        )
        for cell, trace in cleanings
    ]
    moved = tuple(f"{name} moved sd" for name in DEVIATIONS)
    columns = ("case", "station", "after", "day", "true change", "found change", *moved, "seen")
    notes = (
        "nozzles plug by 0.13 of the wetted share from day 22 to day 36 and are cleaned by 0.09 on day 37",
        "moved: proposal less that of the midnight before the cleaning, in standard deviations of the latter",
        "seen: uniformity moves to the right side by one standard deviation or more, every other deviation by less",
        "excited window: two hours after the cleaning whose day passes the thresholds of excitation and condition",
    )
    return ReportTable("cleanings", "Cleanings of nozzles in the simulated plant", columns, tuple(rows), notes)


def _gates(cells: Sequence[CellTrial], every: GateFigures) -> ReportTable:
    windows = [window for one in cells for state in one.known for window in state.windows]
    rows: list[tuple[Cell, ...]] = [("all", *_gate_row(every))]
    for name, kinds in (("stations with ramps", (RAMP, CLEANING)), ("plain stations", (PLAIN,))):
        some = [w for one in cells if one.kind in kinds for state in one.known for w in state.windows]
        if some:
            rows.append((name, *_gate_row(gate_figures(some))))
    codes = Counter(code for window in windows for code in window.codes)
    for code, count in codes.most_common():
        mine = [w for w in windows if code in w.codes]
        error = float(np.average([w.error for w in mine], weights=[w.minutes for w in mine]))
        large = sum(w.error > 0.5 for w in mine)
        rows.append((code, count, 100.0 * count / len(windows), None, error, large, None, None))
    columns = (
        "windows of",
        "windows",
        "withheld %",
        "accepted MAE K",
        "withheld MAE K",
        "above 0.5 K",
        "AUROC gates",
        "AUROC width",
    )
    notes = (
        "withheld: a reason code of the window holds; codes of single deviations do not concern the outlet",
        "error: of the outlet against the truth by running minute; the readings of the own window are hidden, those of "
        "the windows up to the calibration are not",
        "AUROC: for windows whose mean absolute error is above 0.5 K, by withheld or not, and by the interval's width",
    )
    return ReportTable("gates", "Outlet of accepted and withheld windows", columns, tuple(rows), notes)


def _gate_row(g: GateFigures) -> tuple[Cell, ...]:
    return g.windows, 100.0 * g.withheld, g.accepted_K, g.withheld_K, g.large, g.auroc, g.width_auroc


def _proposals(judged: Sequence[Judged]) -> ReportTable:
    rows: list[tuple[Cell, ...]] = []
    for name in (*DEVIATIONS, "all"):
        mine = [one for one in judged if name in (one.name, "all")]
        count = verdict_counts(mine)
        decided = count[CONFIRMED] + count[FALSE]
        rows.append(
            (
                name,
                len(mine),
                count[CONFIRMED],
                count[OPEN],
                count[FALSE],
                count[CONFIRMED] / decided if decided else None,
                sum(one.nearer for one in mine),
            )
        )
    notes = (
        "persistent: three windows running passed all gates, and the value before is outside of the 90 % interval",
        "value before: that of the clean cell, then that of the last persistent proposal",
        "confirmed: the truth at the window is nearer to the proposal than to the value before; false: it is not",
        "open: the truth is nearer to the middle of both than the standard uncertainty of an inspection, which cannot "
        "decide: 0.023 fill, 0.02 air, 0.018 uniformity, 0.05 K bias",
    )
    columns = ("deviation", "proposals", CONFIRMED, OPEN, FALSE, "precision", "nearer by the truth alone")
    return ReportTable("proposals", "Persistent proposals by simulated inspections", columns, tuple(rows), notes)


def _judged(judged: Sequence[Judged]) -> ReportTable:
    rows: list[tuple[Cell, ...]] = [
        (
            one.cell.case,
            one.cell.cell,
            one.name,
            one.cell.day(one.proposal.end_s),
            one.before,
            one.proposal.value,
            one.proposal.true,
            one.verdict,
        )
        for one in judged
    ]
    columns = ("case", "cell", "deviation", "day", "value before", "proposed", "truth", "verdict")
    return ReportTable("verdicts", "The proposals", columns, tuple(rows))


def _cost(cost: Sequence[tuple[StationCase, float, int]]) -> ReportTable:
    rows: list[tuple[Cell, ...]] = [
        (case.name, case.design.station, f"2022-{case.month:02d}", case.seed, case.days, count, cpu_s)
        for case, cpu_s, count in cost
    ]
    columns = ("case", "station", "from", "seed", "days", "calibrations", "CPU s")
    return ReportTable("stations", "Stations and their cost", columns, tuple(rows))
