"""Adoption of accepted deviations: the next revision of a cell's twin, which `hil twin revert` undoes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hil.files import estimate_text
from hil.tower.calibration import CellResult
from hil.tower.governance.gates import ProposalsOf, Verdict
from hil.tower.governance.reverted import label_evidence, same_revision
from hil.tower.station import iso
from twin.network import Revision
from twin.revisions import save_revision
from twin.tower import DEVIATIONS, IDS, Array, TargetWindow
from twin.tower.calibration import NORMAL


@dataclass(frozen=True)
class Adoption:
    """Revision that was saved, None where none was; `remark` is a sentence for the user, "" without one."""

    revision: Path | None
    remark: str = ""


def save_accepted(
    result: CellResult,
    windows: Sequence[TargetWindow],
    verdicts: Sequence[Verdict],
    proposals: ProposalsOf,
    made_by: str,
    residual_after: Array,
) -> Adoption:
    """Save the deviations of the last windows that passed all gates, if no revision of the twin holds them already.

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
        values[IDS[name]] = float(f"{value:.5g}")
        notes.append(f"{name} {estimate_text(value, NORMAL * sd)} (90 %) at {iso(windows[passed[-1]].end_s)}")
    if not values:
        return Adoption(None)
    evidence = label_evidence(result.labels)
    if there := same_revision(result.twin, made_by, result.record.digest, evidence, values):
        return Adoption(None, f"{there.name} holds the accepted values already; no revision is written")
    revision = Revision(
        made_by=made_by,
        notes=tuple(notes),
        record=result.record.digest,
        record_file=result.record.path.name,
        error_before_K={"outlet": _rms(result.minutes.outlet - result.calibrated.commissioned)},
        error_after_K={"outlet": _rms(residual_after)},
        window_s=(float(result.minutes.time_s[0]), float(result.minutes.time_s[-1])),
        effects=tuple(f"{name} {values[name]:.4g}" for name in values),
        evidence=evidence,
    )
    return Adoption(save_revision(result.network.with_values(values, revision), result.twin))


def _rms(values: Array) -> float:
    there = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(there**2))) if len(there) else float("nan")
