"""Trials of sudden thermometer errors in a tower's record: time to the alarm, and the fouling that the refit reports.

A trial takes a week of a cell, adds a step to its outlet readings from some minute on, and calibrates the week as
`hil tower calibrate` does: fit, search for steps, refit with a jump of the bias opened. An archive that reports by
exception stores the first scan after a step, so the trial does. The same week without the step
gives the deviations that nothing has happened to. A step is called fouling where the refit moves fill, air or
uniformity by more than one standard deviation of the plain fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.bench.measure import Cell, ReportTable
from hil.record import RecordError
from hil.tower import (
    DRIVEN,
    CellRecord,
    StationNotes,
    fit_with_steps,
    load_all,
    openings_of,
    priors_of,
    read_cell,
    read_notes,
    site_of,
)
from twin import Network
from twin.tower import (
    DAY_S,
    DEVIATIONS,
    MEASURED,
    Array,
    CellModel,
    Fitted,
    Step,
    design_of,
    minutes_of,
    site_pressure_of,
    value_of,
)

BEFORE_DAYS, AFTER_DAYS = 5.0, 2.0
"""A step is confirmed by the day after it, and its level is known from the days before."""
IN_TIME_MIN = 18.0
"""Limit of the paper for a step of 0.5 K."""
RUNNING_MIN = 240
"""Minutes before and after a step in which the cell must run steadily: a thermometer that stands dry shows nothing."""
SCAN_SHARE = 0.01
"""Share of the intervals between stored samples that are no longer than a scan."""
CASES = (
    "trial",
    "cell",
    "size K",
    "found after min",
    "class",
    "fill moved sd",
    "air moved sd",
    "uniformity moved sd",
    "bias moved K",
)


@dataclass(frozen=True)
class Trial:
    """A step of a thermometer: cell, size K, minutes to the alarm or None, class, and the refit's changes.

    `moved`: of fill, air, uniformity in standard deviations of the plain fit. `bias`: K.
    """

    cell: int
    size: float
    after_min: float | None
    kind: str
    moved: tuple[float, float, float]
    bias: float

    @property
    def called_fouling(self) -> bool:
        return max(abs(m) for m in self.moved) > 1.0


def try_steps(
    record: Path,
    twins: Sequence[Path],
    count: int,
    size: float,
    seed: int,
    note: Callable[[int], None] = lambda _: None,
) -> list[Trial]:
    """Return `count` trials with steps of either sign at random times of random cells.

    Raises
    ------
    RecordError, TwinFileError
        A file cannot be used, or no cell runs steadily for long enough.
    """
    loaded, notes = load_all(twins, record), read_notes(record)
    networks = {cell: network for cell, (_, network) in loaded.items()}
    cells = {cell: read_cell(record, cell) for cell in networks}
    rng = np.random.default_rng(seed)
    found: list[Trial] = []
    times = {cell: _times(networks[cell], whole) for cell, whole in cells.items()}
    running = [cell for cell, some in times.items() if len(some)]
    if not running:
        raise RecordError(
            f"{record}: no cell runs steadily for {2 * RUNNING_MIN / 60:g} h between the first {BEFORE_DAYS:g} and the "
            f"last {AFTER_DAYS:g} days; give a longer record, or one in which the cells run"
        )
    plain: dict[tuple[int, int], Fitted] = {}
    while len(found) < count:
        cell = int(rng.choice(running))
        at, sign = float(rng.choice(times[cell])), float(rng.choice([-1.0, 1.0]))
        # Weeks begin and end at noon or midnight, so that trials share the fit without a step.
        half = 0.5 * DAY_S
        ends = np.floor((at - BEFORE_DAYS * DAY_S) / half) * half, np.ceil((at + AFTER_DAYS * DAY_S) / half) * half
        rows = slice(*(int(i) for i in np.searchsorted(cells[cell].time_s, ends)))
        week, key = _part(cells[cell], rows), (cell, rows.start)
        if key not in plain:
            plain[key] = _fit(networks[cell], week, notes)[0]
        found.append(_trial(networks[cell], week, notes, plain[key], at, sign * size))
        note(len(found))
    return found


def _times(network: Network, whole: CellRecord) -> Array:
    """Return the minutes at which a step may be tried, s."""
    t = whole.time_s
    inside = (t >= t[0] + BEFORE_DAYS * DAY_S) & (t <= t[-1] - AFTER_DAYS * DAY_S)
    return np.asarray(t[inside & _watched(network, whole)])


def _part(whole: CellRecord, rows: slice) -> CellRecord:
    return replace(
        whole,
        time_s=whole.time_s[rows],
        columns={n: v[rows] for n, v in whole.columns.items()},
        origin={n: v[rows] for n, v in whole.origin.items()},
    )


def _fit(network: Network, record: CellRecord, notes: StationNotes) -> tuple[Fitted, tuple[Step, ...]]:
    share = value_of(network, "cell.bypass_share")
    design = design_of(network)
    minutes = minutes_of(
        record.time_s, record.columns, record.origin, design.m_w0, share, site_kPa=site_pressure_of(network)
    )
    model, openings = CellModel(design, site_of(notes, share)), openings_of(notes, record.cell)
    fitted, steps, _ = fit_with_steps(model, minutes, record, priors_of(network, notes), (), openings)
    return fitted, steps


def _watched(network: Network, record: CellRecord) -> NDArray[np.bool_]:
    """Return the minutes about which the cell runs steadily and driven for hours, with readings of its outlet."""
    m = minutes_of(
        record.time_s, record.columns, record.origin, design_of(network).m_w0, value_of(network, "cell.bypass_share")
    )
    good = np.convolve(m.steady & (m.operation.inputs.speed > DRIVEN), np.ones(2 * RUNNING_MIN), "same")
    read = np.convolve(np.isfinite(m.outlet), np.ones(2 * RUNNING_MIN), "same")
    return np.asarray((good > 0.9 * 2 * RUNNING_MIN) & (read > 0.1 * 2 * RUNNING_MIN))


def _trial(network: Network, week: CellRecord, notes: StationNotes, plain: Fitted, at: float, size: float) -> Trial:
    refit, steps = _fit(network, _stepped(week, at, size), notes)
    near = [s for s in steps if at - 600.0 <= s.alarm_s <= at + 6 * 3600.0 and s.lasting]
    row = int(plain.posterior.cells_at(np.array([week.time_s[-1]]))[0])
    change = refit.posterior.slow[row] - plain.posterior.slow[row]
    fill, air, uniformity = (change / plain.posterior.sd()[row])[:3].tolist()
    after = (near[0].alarm_s - at) / 60.0 if near else None
    return Trial(
        week.cell,
        size,
        after,
        near[0].kind if near else "none",
        (fill, air, uniformity),
        float(change[DEVIATIONS.index("bias")]),
    )


def _stepped(week: CellRecord, at: float, size: float) -> CellRecord:
    """Return a week whose outlet thermometer steps; the first scan after the step is a sample of the archive."""
    stored = np.flatnonzero(week.origin["t_out_C"] == MEASURED)
    scan = max(int(np.quantile(np.diff(stored), SCAN_SHARE)), 1)
    step = int(np.searchsorted(week.time_s, at))
    before = int(stored[np.searchsorted(stored, step) - 1])
    first = before + scan * -(-(step - before) // scan)
    origin = week.origin["t_out_C"].copy()
    if first < len(origin) and np.isfinite(week.columns["t_out_C"][first]):
        origin[first] = MEASURED
    columns = {**week.columns, "t_out_C": week.columns["t_out_C"] + size * (week.time_s >= at)}
    return replace(week, columns=columns, origin={**week.origin, "t_out_C": origin})


def tables_of(trials: Sequence[Trial], size: float) -> list[ReportTable]:
    """Return the counts of the trials, and each of them."""
    n = len(trials)
    delays = np.array([t.after_min for t in trials if t.after_min is not None])
    late = int((delays > IN_TIME_MIN).sum())
    bias = np.array([np.sign(t.size) * t.bias for t in trials])
    rows: list[tuple[Cell, ...]] = [
        ("steps", n),
        (f"found within {IN_TIME_MIN:g} min", int(len(delays) - late)),
        ("found later", late),
        ("missed", n - len(delays)),
        ("taken for a change of the water", sum(t.kind == "water" for t in trials)),
        ("called fouling by the refit", sum(t.called_fouling for t in trials)),
        ("median minutes to the alarm", float(np.median(delays)) if len(delays) else None),
        ("longest minutes to the alarm", float(delays.max()) if len(delays) else None),
        ("largest change of fill, air or uniformity, sd", max((max(map(abs, t.moved)) for t in trials), default=None)),
        ("median change of the bias with the step, K", float(np.median(bias)) if n else None),
    ]
    about = f"{n} steps of {size:g} K of an outlet thermometer, either sign, at random times; the fan runs steadily"
    notes = (
        f"each in a record of {BEFORE_DAYS:g} days before and {AFTER_DAYS:g} days after it, fitted with and without",
        "called fouling: fill, air or uniformity moves by more than one standard deviation",
    )
    each = [(k + 1, t.cell, t.size, t.after_min, t.kind, *t.moved, t.bias) for k, t in enumerate(trials)]
    return [
        ReportTable("steps", about, ("figure", "value"), tuple(rows), notes),
        ReportTable("trials", "The trials", CASES, tuple(each)),
    ]
