"""Calibration as a service: windows, gates, records, review queue and, in the controlled state, revisions of the
twins."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.tower.calibration import (
    CellResult,
    conflict_sentence,
    contradiction_sentence,
    remarks_of,
    site_of,
    step_sentence,
)
from hil.tower.governance.adoption import Adoption, save_accepted
from hil.tower.governance.events_file import write_events
from hil.tower.governance.gates import GateEvidence, ProposalsOf, Verdict, held_beyond_bounds, judge
from hil.tower.governance.network_service import NetworkGovernance, network_governance
from hil.tower.governance.records import (
    EVERY_S,
    NETWORK_RECORDS,
    QUEUE,
    RECORDS,
    CellLines,
    Indicators,
    append_records,
    drift_alarms,
    drift_sentence,
    write_queue,
)
from hil.tower.governance.reverted import hold_reverted
from hil.tower.network import StationAnswers
from hil.tower.station import StationNotes, iso, seconds
from twin.historian import Regime
from twin.tower import (
    DEVIATIONS,
    MOST_CONDITION,
    Array,
    CellModel,
    TargetWindow,
    design_of,
    novelty,
    value_of,
    windows_of,
)
from twin.tower.calibration import WINDOW_S

REQUIRED = ("t_in_C", "t_out_C", "m_w_kg_s", "fan_speed_pct", "fan_power_kW", "dry_C", "pressure_kPa")
"""Channels that a calibration needs, beside a wet bulb."""
INSPECTIONS = ("inspection",)
STEP_CODES = {"water": "CONTRADICTORY_EVENT", "thermometer": "THERMOMETER_STEP", "fan": "FAN_STEP"}


@dataclass(frozen=True)
class CellGovernance:
    """Windows, verdicts and alarms of a cell, and the revision of its twin where one was saved; `network`: the same of
    a network that was asked; `remarks`: sentences for the user."""

    result: CellResult
    windows: Sequence[TargetWindow]
    verdicts: Sequence[Verdict]
    alarms: Sequence[tuple[float, tuple[str, ...]]]
    revision: Path | None
    balance: str
    network: NetworkGovernance | None = None
    remarks: tuple[str, ...] = ()

    @property
    def alarm_lines(self) -> list[str]:
        """A sentence for each drift alarm."""
        return [f"drift alarm at {iso(time_s)}: {drift_sentence(names)}" for time_s, names in self.alarms]

    @property
    def withheld(self) -> dict[str, float]:
        """Share of the windows in which each deviation is held back."""
        n = max(len(self.verdicts), 1)
        return {name: sum(not v.accepts(name) for v in self.verdicts) / n for name in DEVIATIONS}

    @property
    def low_sensitivity(self) -> str:
        """Refusal of the last window in which the cell ran, in words; "" where the deviations are identifiable."""
        k = _latest(self.windows)
        if k is None or not self.windows[k].told.refused:
            return ""
        told = self.windows[k].told
        if told.refused == "MISSING_REQUIRED":
            return f"the last window is refused: {100 * told.hidden:.0f} % of its channels are hidden"
        return (
            f"the last day does not identify all deviations (condition {told.condition_says()}, limit "
            f"{MOST_CONDITION:.0f}); the combination that it shows least is {told.says()}; "
            f"{', '.join(told.frozen)} is held back. "
            f"`hil tower plan` proposes a step test"
        )


def govern(
    results: Sequence[CellResult],
    notes: StationNotes,
    out: Path,
    state: str,
    asked: StationAnswers | None = None,
    propose_reverted: bool = False,
) -> list[CellGovernance]:
    """Write records, review queue and events of the cells into `out`.

    `adopt_accepted` saves the revisions of the twins afterwards.

    Parameters
    ----------
    results
        Calibrated cells.
    notes
        Datasheet and events of the station.
    out
        Folder of the calibration.
    state
        Use of the calibration: shadow, advisory or controlled.
    asked
        Answers of a network, which are governed in their own mode.
    propose_reverted
        Propose values again that an operator reverted.

    Raises
    ------
    RecordError
        The records that are there were changed.
    OSError
        A file cannot be written.
    ValueError
        Both calibrators would revise the twins.
    """
    mode = "shadow" if asked is None else asked.mode
    if state == mode == "controlled":
        raise ValueError("Gauss-Newton and the network cannot both revise a twin; choose one")
    found, lines, queue = [], [], []
    for result in results:
        windows, verdicts, balance = _judged(result, notes)
        gates, remarks = verdicts, remarks_of(result)
        proposed = _proposals_of(result, windows)
        verdicts = held_beyond_bounds(windows, gates, proposed, result.network)
        if not propose_reverted:
            verdicts, said = hold_reverted(result, windows, verdicts, proposed)
            remarks = (*remarks, *said)
        alarms = drift_alarms(_indicators(result, windows, verdicts))
        lines.append(_lines(result, windows, verdicts))
        network = None if asked is None else network_governance(result, windows, gates, asked)
        if network is not None:
            of_network = held_beyond_bounds(windows, network.verdicts, network.proposals, result.network)
            if not propose_reverted:
                of_network, said = hold_reverted(result, windows, of_network, network.proposals)
                remarks = (*remarks, *said)
            network = replace(network, verdicts=of_network)
        found.append(CellGovernance(result, windows, verdicts, alarms, None, balance, network, remarks))
        if state != "shadow":
            queue += _queue(result, windows, verdicts, alarms, state)
        if network is not None and mode != "shadow":
            queue += network.queue(mode)
    append_records(out / RECORDS, lines, state)
    if asked is not None:
        governed = [one.network.lines(_twin_digest(one.result)) for one in found if one.network is not None]
        append_records(out / NETWORK_RECORDS, governed, mode)
    if state != "shadow" or mode != "shadow":
        write_queue(out / QUEUE, queue)
    write_events(results, notes, out)
    return found


def adopt_accepted(cells: Sequence[CellGovernance], state: str, network_mode: str) -> list[CellGovernance]:
    """Save the accepted deviations of the calibrator that is controlled as revisions of the twins.

    Parameters
    ----------
    cells
        Governed cells, whose records are written.
    state, network_mode
        Use of the proposals of Gauss-Newton and of the network.

    Raises
    ------
    TwinFileError
        The folder of a twin cannot be written.
    """
    if state == "controlled":
        return [_controlled(one) for one in cells]
    if network_mode == "controlled":
        return [_controlled_by_network(one) for one in cells]
    return list(cells)


def hidden_shares(columns: Mapping[str, Array], regime: NDArray[np.uint8]) -> Array:
    """Return the share of the required channels that each minute lacks (n,).

    A cell that is off lacks none: on standby for weeks its tags may be silent, and that is no drift of the record.

    Parameters
    ----------
    columns
        (n,) each, of the aligned record by name.
    regime
        (n,) of the record; a cell is off by its water or its state of service.
    """
    n = len(regime)
    lacking = np.mean([~np.isfinite(columns.get(name, np.full(n, np.nan))) for name in REQUIRED], axis=0)
    return np.asarray(np.where(regime == Regime.OFF, 0.0, lacking))


def _judged(result: CellResult, notes: StationNotes) -> tuple[list[TargetWindow], list[Verdict], str]:
    design = design_of(result.network)
    model = CellModel(design, site_of(notes, value_of(result.network, "cell.bypass_share")))
    columns, n = result.record.columns, len(result.record.time_s)
    hidden = hidden_shares(columns, result.minutes.regime)
    windows = windows_of(model, result.minutes, result.calibrated, hidden, result.second, not result.unused)
    dropped = _shares(result, windows, ~np.isfinite(columns.get("wet_C", np.full(n, np.nan))))
    bypass = _shares(result, windows, result.minutes.operation.bypass > 0.05)
    balance = result.unused
    inspections = [
        seconds(e["time"]) for e in notes.events if e["kind"] in INSPECTIONS and e["cell"] in (0, result.cell)
    ]
    unexplained = [s.start_s for s in result.steps if s.lasting and s.kind == "water"]
    conflicts = frozenset(one.label.parameter for one in result.conflicts)
    evidence = GateEvidence(
        result.labels, inspections, unexplained, result.second, balance, bool(result.contradictions), conflicts
    )
    return windows, judge(windows, dropped, bypass, evidence), balance


def _shares(result: CellResult, windows: Sequence[TargetWindow], rows: NDArray[np.bool_]) -> Array:
    edges = np.searchsorted(result.minutes.time_s, [w.start_s for w in windows] + [windows[-1].end_s])
    return np.array([float(np.mean(rows[a:b])) if b > a else 0.0 for a, b in zip(edges[:-1], edges[1:], strict=True)])


def _lines(result: CellResult, windows: Sequence[TargetWindow], verdicts: Sequence[Verdict]) -> CellLines:
    m, c = result.minutes, result.calibrated
    rows = np.flatnonzero(np.mod(m.time_s, EVERY_S) < 60.0)
    window = np.clip(((m.time_s[rows] - windows[0].start_s) // WINDOW_S).astype(int), 0, len(windows) - 1)
    deviations, sd = c.deviations[rows].copy(), c.sd[rows].copy()
    deviations[:, :3] += 1.0
    return CellLines(
        result.cell,
        m.time_s[rows],
        deviations,
        sd,
        (c.t_out - c.commissioned)[rows],
        0.5 * (c.high - c.low)[rows],
        m.regime[rows],
        window,
        windows,
        verdicts,
        result.record.digest,
        _twin_digest(result),
    )


def _twin_digest(result: CellResult) -> str:
    return hashlib.sha256(result.twin.read_bytes()).hexdigest()


def _indicators(result: CellResult, windows: Sequence[TargetWindow], verdicts: Sequence[Verdict]) -> Indicators:
    m, c = result.minutes, result.calibrated
    hour = (m.time_s // 3600.0).astype(np.int64)
    hour -= hour[0]
    count = int(hour[-1]) + 1
    residual = m.outlet - c.deviations[:, 3] - c.t_out
    there = np.isfinite(residual)
    covered = (np.abs(residual) <= c.high - c.t_out) & there
    with np.errstate(invalid="ignore", divide="ignore"):
        seen = np.bincount(hour, there, count)
        mean = np.bincount(hour, np.nan_to_num(residual), count) / seen
        coverage = np.bincount(hour, covered, count) / seen
    time_s = m.time_s[0] + 3600.0 * np.arange(count)
    at = np.clip(((time_s - windows[0].start_s) // WINDOW_S).astype(int), 0, len(windows) - 1)
    distance = novelty([w.features for w in windows], [True] * len(windows))[at]
    withheld = np.array([float(bool(verdicts[k].codes)) for k in at])
    missing = np.array([windows[k].told.hidden for k in at])
    return Indicators(time_s, mean, coverage, withheld, missing, distance)


def _queue(
    result: CellResult,
    windows: Sequence[TargetWindow],
    verdicts: Sequence[Verdict],
    alarms: Sequence[tuple[float, tuple[str, ...]]],
    state: str,
) -> list[dict[str, Any]]:
    """Return what waits for an engineer: the present proposal of each deviation, steps and alarms."""
    entries: list[dict[str, Any]] = []
    k = _latest(windows)
    if k is not None:
        for name, value, sd in _proposals(result, windows[k]):
            codes = [*verdicts[k].codes, *verdicts[k].of.get(name, ())]
            entries.append(
                {
                    "time": iso(windows[k].end_s),
                    "cell": result.cell,
                    "parameter": name,
                    "value": round(value, 4),
                    "sd": round(sd, 4),
                    "accepted": not codes,
                    "codes": codes,
                    "condition": round(windows[k].told.condition, 1),
                    "combined": windows[k].told.says(),
                    "state": state,
                }
            )
    for step in result.steps:
        if step.lasting:
            entries.append(
                {
                    "time": iso(step.alarm_s),
                    "cell": result.cell,
                    "event": f"{step.kind}_step",
                    "from": iso(step.since_s),
                    "size_K": round(step.size, 2),
                    "text": step_sentence(step),
                    "codes": [STEP_CODES[step.kind]],
                }
            )
    bound = result.priors.bounds["bias"]
    for span in result.contradictions:
        entries.append(
            {
                "time": iso(span.end_s),
                "cell": result.cell,
                "event": "contradictory_record",
                "from": iso(span.start_s),
                "text": contradiction_sentence(span, bound),
                "codes": ["CONTRADICTORY_RECORD"],
            }
        )
    for one in result.conflicts:
        entries.append(
            {
                "time": iso(one.label.time_s),
                "cell": result.cell,
                "event": "contradictory_label",
                "text": conflict_sentence(one),
                "codes": [f"CONTRADICTORY_LABEL:{one.label.parameter}"],
            }
        )
    entries += [
        {"time": iso(t), "cell": result.cell, "event": "drift_alarm", "indicators": list(names)} for t, names in alarms
    ]
    return entries


def _latest(windows: Sequence[TargetWindow]) -> int | None:
    running = [k for k, w in enumerate(windows) if w.share_known > 0.5]
    return running[-1] if running else None


def _proposals(result: CellResult, window: TargetWindow) -> list[tuple[str, float, float]]:
    row = int(np.clip(np.searchsorted(result.minutes.time_s, window.end_s) - 1, 0, len(result.minutes.time_s) - 1))
    c = result.calibrated
    return [
        (name, float(c.deviations[row, j]) + (0.0 if name == "bias" else 1.0), float(c.sd[row, j]))
        for j, name in enumerate(DEVIATIONS)
    ]


def _proposals_of(result: CellResult, windows: Sequence[TargetWindow]) -> ProposalsOf:
    return lambda k: _proposals(result, windows[k])


def _adopted(one: CellGovernance, adoption: Adoption) -> CellGovernance:
    remarks = (*one.remarks, adoption.remark) if adoption.remark else one.remarks
    return replace(one, revision=adoption.revision, remarks=remarks)


def _controlled(one: CellGovernance) -> CellGovernance:
    """Save the deviations of the last windows that passed all gates as a revision of the twin."""
    adoption = save_accepted(
        one.result,
        one.windows,
        one.verdicts,
        _proposals_of(one.result, one.windows),
        "hil tower calibrate",
        one.result.calibrated.posterior.residual,
    )
    return _adopted(one, adoption)


def _controlled_by_network(one: CellGovernance) -> CellGovernance:
    """Save the network's deviations of the last windows that passed all gates as a revision of the twin."""
    assert one.network is not None
    network = one.network
    adoption = save_accepted(
        one.result,
        one.windows,
        network.verdicts,
        network.proposals,
        "hil tower calibrate --network-mode controlled",
        network.residual(),
    )
    return _adopted(one, adoption)
