"""Governance of a network's proposals: the gates of a calibration and its own, records, queue entries.

A proposal is the causal branch's answer to a window. It passes the gates on the record and the station's evidence that
Gauss-Newton's passes too. Its interval, and the distance from what the members were trained on, are the network's own.

| code | holds back where |
|---|---|
| `NO_WINDOW` | the network has no answer: no full day before, too few steady blocks, or unknown inputs |
| `BLIND` | a member's parameters hardly hang on its channels; every window, and such an ensemble only runs in shadow |
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hil.tower.calibration import CellResult
from hil.tower.governance.gates import MOST_HALF_K, Verdict
from hil.tower.governance.records import EVERY_S, CellLines
from hil.tower.network import NETWORK, NetworkAnswers, StationAnswers
from hil.tower.station import iso
from twin.tower import DEVIATIONS, Array, TargetWindow
from twin.tower.calibration import NORMAL, WINDOW_S

QUERIES = ("ambient", "hydraulic", "airflow", "degradation")
OWN = ("HIGH_UNCERTAINTY", "OUT_OF_ENVELOPE")
"""Codes of Gauss-Newton's interval and envelope, which say nothing of a network's."""


@dataclass(frozen=True)
class NetworkGovernance:
    """Verdicts on the answers of a network to the windows of a cell.

    Attributes
    ----------
    answered
        Number of the network's answer to each window of the cell, -1 where it has none.
    outlet
        Sentence on an outlet that is the start's, "" where it is the network's.
    """

    result: CellResult
    windows: Sequence[TargetWindow]
    verdicts: Sequence[Verdict]
    answers: NetworkAnswers
    answered: Sequence[int]
    digest: str
    blind: tuple[str, ...]
    outlet: str = ""

    @property
    def last(self) -> int | None:
        """Number of the last window with an answer, None without one."""
        there = [k for k, number in enumerate(self.answered) if number >= 0]
        return there[-1] if there else None

    @property
    def withheld(self) -> dict[str, float]:
        """Share of the windows with an answer in which each deviation is held back."""
        there = [v for v, k in zip(self.verdicts, self.answered, strict=True) if k >= 0]
        return {name: sum(not v.accepts(name) for v in there) / max(len(there), 1) for name in DEVIATIONS}

    def residual(self) -> Array:
        """Return readings less bias and outlet by the network, K (n,)."""
        return np.asarray(self.result.minutes.outlet - self.answers.deviations[:, 3] - self.answers.t_out)

    def proposals(self, k: int) -> list[tuple[str, float, float]]:
        """Return name, value and standard deviation of each deviation in window `k`."""
        time_s = self.result.minutes.time_s
        row = int(np.clip(np.searchsorted(time_s, self.windows[k].start_s), 0, len(time_s) - 1))
        found = self.answers
        return [
            (
                name,
                float(found.deviations[row, j]) + (0.0 if name == "bias" else 1.0),
                float(found.deviation_half[row, j]) / NORMAL,
            )
            for j, name in enumerate(DEVIATIONS)
        ]

    def lines(self, twin: str) -> CellLines:
        """Return the records of the cell, one for every five minutes from the first answer on.

        Parameters
        ----------
        twin
            Hash of the twin file.
        """
        m, found = self.result.minutes, self.answers
        first = float(found.start_s[0]) if len(found.start_s) else np.inf
        rows = np.flatnonzero((np.mod(m.time_s, EVERY_S) < 60.0) & (m.time_s >= first))
        window = np.clip(((m.time_s[rows] - self.windows[0].start_s) // WINDOW_S).astype(int), 0, len(self.windows) - 1)
        deviations = found.deviations[rows].copy()
        deviations[:, :3] += 1.0
        return CellLines(
            self.result.cell,
            m.time_s[rows],
            deviations,
            found.deviation_half[rows] / NORMAL,
            (found.t_out - self.result.calibrated.commissioned)[rows],
            found.half[rows],
            m.regime[rows],
            window,
            self.windows,
            self.verdicts,
            self.result.record.digest,
            twin,
            self.digest,
        )

    def queue(self, mode: str) -> list[dict[str, Any]]:
        """Return the entries of the review queue: the proposals of the last window with an answer."""
        k = self.last
        if k is None:
            return []
        window, verdict = self.windows[k], self.verdicts[k]
        attention = self.answers.attention[self.answered[k]]
        looked = {q: [round(float(v), 3) for v in row] for q, row in zip(QUERIES, attention, strict=True)}
        entries = []
        for name, value, sd in self.proposals(k):
            codes = [*verdict.codes, *verdict.of.get(name, ())]
            entries.append(
                {
                    "time": iso(window.end_s),
                    "cell": self.result.cell,
                    "calibrator": NETWORK,
                    "parameter": name,
                    "value": round(value, 4),
                    "sd": round(sd, 4),
                    "accepted": not codes,
                    "codes": codes,
                    "condition": round(window.told.condition, 1),
                    "combined": window.told.says(),
                    "attention": looked,
                    "state": mode,
                }
            )
        return entries


def network_governance(
    result: CellResult, windows: Sequence[TargetWindow], verdicts: Sequence[Verdict], asked: StationAnswers
) -> NetworkGovernance:
    """Return the verdicts on a network's causal answers to a cell.

    Parameters
    ----------
    windows, verdicts
        Of the cell's calibration; gates on the record and the evidence are theirs.
    """
    answers = asked.causal[result.cell]
    number = {round(float(start)): k for k, start in enumerate(answers.start_s)}
    answered = [number.get(round(w.start_s), -1) for w in windows]
    time_s = result.minutes.time_s
    found = []
    for window, verdict, k in zip(windows, verdicts, answered, strict=True):
        codes = [code for code in verdict.codes if code not in OWN]
        if k < 0:
            codes.append("NO_WINDOW")
        else:
            within = slice(*(int(i) for i in np.searchsorted(time_s, (window.start_s, window.end_s))))
            half = answers.half[within]
            mean = float(np.nanmean(half)) if np.isfinite(half).any() else float("nan")
            if not mean <= MOST_HALF_K:
                codes.append("HIGH_UNCERTAINTY")
            if answers.distance[k] > 1.0:
                codes.append("OUT_OF_ENVELOPE")
        if asked.blind:
            codes.append("BLIND")
        found.append(replace(verdict, codes=tuple(codes)))
    return NetworkGovernance(result, windows, found, answers, answered, asked.digest, asked.blind, asked.outlet)
