"""Calibrations of a station on the record up to a time: proposals, windows and alarms that were known then.

Each is `hil tower calibrate --mode advisory` on the minutes, events and labels before that time.
"""

from __future__ import annotations

import csv
import json
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow.compute as pc
import pyarrow.parquet as pq

from hil.bench.tower_governance.cases import HEALTHY_DAYS
from hil.tower import CellGovernance, TruthColumns, calibrate_station, govern, seconds
from twin.tower import DAY_S, DEVIATIONS, Array

PERSISTENT = 3
"""Windows in which a proposal has to pass all gates: the paper's persistence, and that of the gate on excitation."""


LEVEL = 0.95
"""Fill at which a loss of 5 % is proposed."""


@dataclass(frozen=True, slots=True)
class StationFolder:
    """Aligned record of a station, twins of its cells, labels, and the truth by cell."""

    record: Path
    twins: tuple[Path, ...]
    labels: Path
    truth: dict[int, TruthColumns]


@dataclass(frozen=True, slots=True)
class Proposal:
    """Value of a deviation that a window proposes (of 1, bias in K), its standard deviation, the truth at the window's
    end, and whether the last `PERSISTENT` windows passed all its gates."""

    end_s: float
    value: float
    sd: float
    true: float
    persistent: bool = False


@dataclass(frozen=True, slots=True)
class WindowError:
    """Window of a cell: reason codes of its own and of its deviations, half width of its interval K, mean absolute
    error of the outlet K against the truth, and the minutes of that mean."""

    start_s: float
    codes: tuple[str, ...]
    of: tuple[str, ...]
    half: float
    error: float
    minutes: int


@dataclass(frozen=True, slots=True)
class KnownState:
    """Statement of a calibration on a cell, by name of the deviation.

    Attributes
    ----------
    true
        Deviations at this time.
    present
        Proposals of the last window in which the cell ran.
    accepted
        Those of the last window that passed all gates of the deviation, where there is one.
    windows
        Windows since the calibration before.
    excited_s
        (start, end) of those that are excited and identify the deviations.
    alarms
        Drift alarms: time and indicators.
    """

    time_s: float
    true: dict[str, float]
    present: dict[str, Proposal]
    accepted: dict[str, Proposal]
    windows: tuple[WindowError, ...] = ()
    excited_s: tuple[tuple[float, float], ...] = ()
    alarms: tuple[tuple[float, tuple[str, ...]], ...] = ()


@dataclass(frozen=True, slots=True)
class CellTrial:
    """A cell of a trial: station's case and letter, cell, kind, beginning s, time at which its true fill falls below
    `LEVEL`, end of the third excited window after its cleaning, and what was known of it in the order of time."""

    case: str
    station: str
    cell: int
    kind: str
    start_s: float
    crossed_s: float | None
    third_s: float | None
    known: tuple[KnownState, ...]

    def day(self, time_s: float) -> float:
        """Return a time in days of the simulation."""
        return (time_s - self.start_s) / DAY_S

    def at_day(self, day: float) -> KnownState | None:
        """Return the calibration at a midnight, None where there was none."""
        return next((one for one in self.known if abs(self.day(one.time_s) - day) < 1e-6), None)

    @property
    def watched_days(self) -> float:
        """Days from the end of the healthy days to the last calibration."""
        return self.day(self.known[-1].time_s) - HEALTHY_DAYS


def says_loss(state: KnownState, accepted: bool = False) -> bool:
    """Return True if the fill that a calibration proposes, or that its gates accept, has lost 5 % or more."""
    fill = (state.accepted if accepted else state.present).get("fill")
    return fill is not None and fill.value <= LEVEL


def calibrated_at(station: StationFolder, end_s: float, since_s: float) -> dict[int, KnownState]:
    """Return what is known of each cell at a time, s; windows are those from `since_s` on.

    Raises
    ------
    RecordError, TwinFileError
        The record up to then cannot calibrate a cell.
    """
    with tempfile.TemporaryDirectory(prefix="hil-known-") as place:
        record, out = Path(place) / "record", Path(place) / "out"
        out.mkdir()
        labels = _write_known(station, record, end_s)
        results, notes = calibrate_station(record, station.twins, labels)
        governed = govern(results, notes, out, "advisory")
    return {one.result.cell: _known(one, station.truth[one.result.cell], end_s, since_s) for one in governed}


def _write_known(station: StationFolder, record: Path, end_s: float) -> Path | None:
    """Write the part of a record before a time, and return the labels before it, None without one."""
    record.mkdir()
    limit = np.datetime64(round(end_s * 1e3), "ms")
    for path in sorted(station.record.glob("cell*.parquet")):
        table = pq.read_table(path)
        pq.write_table(table.filter(pc.less(table["time"].cast("timestamp[ms]"), limit)), record / path.name)
    notes = json.loads((station.record / "station.json").read_text())
    notes["events"] = [event for event in notes["events"] if seconds(event["time"]) < end_s]
    (record / "station.json").write_text(json.dumps(notes))
    with station.labels.open(newline="") as handle:
        head, *rows = list(csv.reader(handle))
    rows = [row for row in rows if seconds(row[head.index("time")]) < end_s]
    if not rows:
        return None
    with (record / "labels.csv").open("w", newline="") as handle:
        csv.writer(handle).writerows([head, *rows])
    return record / "labels.csv"


def _known(one: CellGovernance, truth: TruthColumns, end_s: float, since_s: float) -> KnownState:
    minutes, found = one.result.minutes, one.result.calibrated
    times = _seconds(truth)
    windows = [w for w in one.windows if w.end_s <= end_s + 60.0]
    running = [k for k, w in enumerate(windows) if w.share_known > 0.5]

    def true(name: str, at_s: float) -> float:
        return float(truth[name][int(np.clip(np.searchsorted(times, at_s) - 1, 0, len(times) - 1))])

    def proposal(name: str, k: int, persistent: bool = False) -> Proposal:
        j, at = DEVIATIONS.index(name), windows[k].end_s
        row = int(np.clip(np.searchsorted(minutes.time_s, at) - 1, 0, len(minutes.time_s) - 1))
        value = float(found.deviations[row, j]) + (0.0 if name == "bias" else 1.0)
        return Proposal(at, value, float(found.sd[row, j]), true(name, at), persistent)

    present, accepted = {}, {}
    for name in DEVIATIONS:
        passed = [k for k in running if one.verdicts[k].accepts(name)]
        if running:
            present[name] = proposal(
                name, running[-1], len(running) >= PERSISTENT and running[-PERSISTENT:] == passed[-PERSISTENT:]
            )
        if passed:
            accepted[name] = proposal(name, passed[-1])
    outlets = _errors(minutes.time_s, found.t_out, truth)
    errors, excited = [], []
    for window, verdict in zip(windows, one.verdicts, strict=False):
        if window.start_s < since_s:
            continue
        of = tuple(sorted({code for codes in verdict.of.values() for code in codes}))
        inside = outlets[slice(*np.searchsorted(minutes.time_s, (window.start_s, window.end_s)))]
        inside = inside[np.isfinite(inside)]
        if len(inside):
            errors.append(
                WindowError(window.start_s, verdict.codes, of, window.half, float(inside.mean()), len(inside))
            )
        if window.excited and not window.told.refused:
            excited.append((window.start_s, window.end_s))
    return KnownState(
        end_s,
        {name: true(name, end_s) for name in DEVIATIONS},
        present,
        accepted,
        tuple(errors),
        tuple(excited),
        tuple(one.alarms),
    )


def _seconds(truth: TruthColumns) -> Array:
    return np.asarray(truth["time"].astype("datetime64[ms]").astype(np.float64) / 1e3)


def _errors(time_s: Array, t_out: Array, truth: TruthColumns) -> Array:
    """Return the absolute error of the outlet by minute, K (n,); NaN where the cell is off or nothing is predicted."""
    _, mine, its = np.intersect1d(np.round(time_s), np.round(_seconds(truth)), return_indices=True)
    error = np.full(len(time_s), np.nan)
    error[mine] = np.where(truth["running"][its].astype(bool), np.abs(t_out[mine] - truth["t_out"][its]), np.nan)
    return error


def falls_below(truth: TruthColumns, name: str, level: float) -> float | None:
    """Return the time at which the truth of a deviation first lies below a level, s; None if it never does."""
    below = np.flatnonzero(truth[name] < level)
    return float(_seconds(truth)[below[0]]) if len(below) else None


def third_excited(states: Sequence[KnownState], since_s: float) -> float | None:
    """Return the end of the third excited window that begins at or after a time, s; None where there are fewer."""
    ends = sorted({end for state in states for start, end in state.excited_s if start >= since_s})
    return ends[PERSISTENT - 1] if len(ends) >= PERSISTENT else None
