"""Adoption of accepted deviations: the next revision of a cell's twin, which `hil twin revert` undoes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from hil.tower.calibration import CellResult
from hil.tower.governance.gates import Verdict
from hil.tower.station import iso
from twin.network import Revision
from twin.revisions import save_revision
from twin.tower import DEVIATIONS, IDS, Array, TargetWindow

ProposalsOf = Callable[[int], Sequence[tuple[str, float, float]]]
"""Name, value and standard deviation of each deviation that is proposed in a window of this number."""


def save_accepted(
    result: CellResult,
    windows: Sequence[TargetWindow],
    verdicts: Sequence[Verdict],
    proposals: ProposalsOf,
    made_by: str,
    residual_after: Array,
) -> Path | None:
    """Save the deviations of the last windows that passed all gates; return the revision, None where none passed.

    Parameters
    ----------
    result
        Calibration of the cell.
    windows, verdicts
        Windows of the cell, and the gates' verdict on each.
    proposals
        Function that returns the proposals of a window.
    made_by
        Command or calibrator, for the revision.
    residual_after
        (n,) readings less outlet by the calibrator, K.

    Raises
    ------
    TwinFileError
        The twin's folder cannot be written.
    """
    values, notes = {}, []
    for name in DEVIATIONS:
        passed = [k for k, v in enumerate(verdicts) if v.accepts(name) and windows[k].share_known > 0.5]
        if not passed:
            codes = sorted({c for v in verdicts for c in (*v.codes, *v.of.get(name, ()))})
            notes.append(f"{name} stays: {', '.join(codes) or 'no window ran'}")
            continue
        value, sd = next((v, s) for n, v, s in proposals(passed[-1]) if n == name)
        low, high = (float(b[0]) for b in result.network.bounds([IDS[name]]))
        if not low < value < high:
            notes.append(f"{name} stays: {value:.3f} is outside its bounds {low:g} to {high:g}")
            continue
        values[IDS[name]] = float(f"{value:.5g}")
        notes.append(f"{name} {value:.4g} +- {sd:.2g} at {iso(windows[passed[-1]].end_s)}")
    if not values:
        return None
    revision = Revision(
        made_by=made_by,
        notes=tuple(notes),
        record=result.record.digest,
        record_file=result.record.path.name,
        error_before_K={"outlet": _rms(result.minutes.outlet - result.calibrated.commissioned)},
        error_after_K={"outlet": _rms(residual_after)},
        window_s=(float(result.minutes.time_s[0]), float(result.minutes.time_s[-1])),
        effects=tuple(f"{name} {values[name]:.4g}" for name in values),
        evidence="windows that passed all gates",
    )
    return save_revision(result.network.with_values(values, revision), result.twin)


def _rms(values: Array) -> float:
    there = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(there**2))) if len(there) else float("nan")
