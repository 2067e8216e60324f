"""Values that an operator reverted: they are not proposed again until new evidence shows them.

A revert is a decision on a value. The same record gives the same value again, so it would be undone by the next
calibration. A proposal whose 90 % interval holds the reverted value is held back with `REVERTED:<parameter>` until

- the day that a window is judged by lies after the record of the revision that was undone, or
- a label of the parameter is known that the revision was not made with.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from hil.tower.calibration import CellResult
from hil.tower.governance.gates import ProposalsOf, Verdict
from hil.tower.station import iso
from twin.network import Network
from twin.revisions import UndoneRevision, revisions_made_of, undone_revisions
from twin.tower import CONTEXT_S, DEVIATIONS, IDS, TargetWindow
from twin.tower.calibration import NORMAL
from twin.tower.cell_observations import Label

DIGITS = 10
"""Hex digits of the hash of a parameter's labels."""


def label_evidence(labels: Sequence[Label]) -> str:
    """Return the evidence of a revision: the labels that it was made with, by hashes."""
    told = [f"{name} {_hash(labels, name)}" for name in DEVIATIONS if any(one.parameter == name for one in labels)]
    return f"windows that passed all gates; labels: {', '.join(told) or 'none'}"


def _hash(labels: Sequence[Label], name: str) -> str:
    rows = sorted([one.time_s, one.low, one.high, one.sd or 0.0] for one in labels if one.parameter == name)
    return hashlib.sha256(json.dumps(rows).encode()).hexdigest()[:DIGITS]


def hold_reverted(
    result: CellResult, windows: Sequence[TargetWindow], verdicts: Sequence[Verdict], proposals: ProposalsOf
) -> tuple[list[Verdict], tuple[str, ...]]:
    """Return the verdicts with values held back that were reverted, and a sentence on each.

    Parameters
    ----------
    result
        Calibration of the cell.
    windows, verdicts
        Windows of the cell, and the gates' verdict on each.
    proposals
        Function that returns the proposals of a window.

    Raises
    ------
    TwinFileError
        The twin cannot be used.
    """
    held, said = list(verdicts), []
    for undone in undone_revisions(result.twin):
        revision = undone.network.revision
        until = result.minutes.time_s[-1] if revision.window_s is None else revision.window_s[1]
        for name, identifier in IDS.items():
            value = _value(undone.network, identifier)
            if value == _value(undone.restored, identifier) or _has_new_label(result.labels, name, undone, until):
                continue
            passed = [k for k, v in enumerate(held) if v.accepts(name) and windows[k].share_known > 0.5]
            before = [k for k in passed if windows[k].end_s - CONTEXT_S < until]
            if not before or passed[-1] != before[-1]:
                continue  # nothing to hold, or new evidence
            proposed, sd = next((v, s) for n, v, s in proposals(passed[-1]) if n == name)
            if abs(proposed - value) > NORMAL * sd:
                continue  # another value than the one that was reverted
            said.append(
                f"{name} {proposed:.3f} is held back: {undone.revert.name} undid {value:.3f} of {undone.path.name} "
                f"(REVERTED:{name}); a record that goes on for a day after {iso(until)}, a new label of it, or "
                "--propose-reverted proposes it again"
            )
            for k in before:
                codes = (*held[k].of.get(name, ()), f"REVERTED:{name}")
                held[k] = replace(held[k], of={**held[k].of, name: codes})
    return held, tuple(said)


def _value(network: Network, identifier: str) -> float:
    return float(network.parameters[identifier].value)


def _has_new_label(labels: Sequence[Label], name: str, undone: UndoneRevision, until: float) -> bool:
    """Return True for a label of a deviation that a revision was not made with."""
    mine = [one for one in labels if one.parameter == name]
    if any(one.time_s > until for one in mine):
        return True
    evidence = undone.network.revision.evidence
    return bool(mine) and "labels: " in evidence and f"{name} {_hash(labels, name)}" not in evidence


def same_revision(twin: Path, made_by: str, record: str, evidence: str, values: dict[str, float]) -> Path | None:
    """Return the revision that was made of a twin from the same evidence and was not undone, None without one.

    Parameters
    ----------
    twin
        Twin file that was calibrated.
    made_by, record, evidence
        Command, SHA-256 of the record, and labels, as the revision names them.
    values
        Value of each parameter that would be saved.

    Raises
    ------
    TwinFileError
        The twin cannot be used.
    """
    undone = {one.path for one in undone_revisions(twin)}
    for path, network in revisions_made_of(twin):
        r = network.revision
        same = r.made_by == made_by and r.record == record and r.evidence == evidence
        if same and path not in undone and all(_value(network, i) == v for i, v in values.items()):
            return path
    return None
