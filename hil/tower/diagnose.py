"""Diagnosis of a station's cells on an aligned record: `diagnosis.json`, and revisions of the twins."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hil.files import estimate_text, replacing
from hil.record import RecordError
from hil.tower.calibration import PreparedCell, prepare_cells, undeclared_jumps
from hil.tower.station import iso, writing
from twin.network import Revision
from twin.revisions import save_revision
from twin.tower import UNITS, CellEffect, Opening
from twin.tower.calibration import NORMAL, CalibrationError, Fitted
from twin.tower.diagnosis import (
    CellCase,
    CellHypothesis,
    ClaimedEffect,
    HeldOutBlocks,
    TowerDiagnosis,
    adopted,
    search_effects,
)

DOCUMENT = "diagnosis.json"


@dataclass(frozen=True)
class StationDiagnosis:
    """Diagnosis of the cells of a station, and the cells as they were read."""

    record: Path
    cells: tuple[PreparedCell, ...]
    found: TowerDiagnosis


def diagnose_station(
    record: Path, twins: Sequence[Path], labels: Path | None, say: Callable[[str], None] = lambda text: None
) -> StationDiagnosis:
    """Find the undeclared effects of the cells of these twins.

    Raises
    ------
    RecordError, TwinFileError
        A file cannot be used, or the record is too short.
    """
    cells, notes = prepare_cells(record, twins, labels)
    by_cell = {one.record.cell: one for one in cells}
    cases = [
        CellCase(
            one.record.cell,
            one.model,
            one.minutes,
            one.record.columns,
            one.priors,
            one.labels,
            one.openings,
            one.edges_s,
        )
        for one in cells
    ]

    def jumps(cell: int, fitted: Fitted) -> tuple[Opening, ...]:
        one = by_cell[cell]
        return undeclared_jumps(fitted, one.record, one.priors, one.labels, one.openings)[1]

    zone = notes.datasheet.get("timezone")
    try:
        found = search_effects(cases, zone if isinstance(zone, str) else None, jumps, say)
    except CalibrationError as error:
        raise RecordError(f"{record}: without its held-out weeks it {error}") from error
    return StationDiagnosis(record, tuple(cells), found)


def document(diagnosis: StationDiagnosis, revisions: Sequence[Path] = ()) -> dict[str, Any]:
    """Return the diagnosis as plain data, as `diagnosis.json` holds it."""
    found = diagnosis.found
    effects = [_effect(finding, cell, effect) for finding in found.findings for cell, effect in finding.effects.items()]
    return {
        "format": 1,
        "verdict": "effects found" if effects else "adequate",
        "summary": [says(entry) for entry in effects] or ["no undeclared effect is supported by the record"],
        "record": str(diagnosis.record),
        "twins": {str(d.record.cell): str(d.twin) for d in diagnosis.cells},
        "effects": effects,
        "held_out": [{"from": iso(a), "to": iso(b)} for a, b in found.held_s],
        "error_K": {str(cell): _errors(found.before[cell], found.after[cell]) for cell in found.before},
        "rejected": list(found.rejected),
        "leading": [_leading(one) for one in found.leading],
        "decoy_log_odds": _number(found.decoy, 1),
        "revisions": [str(path) for path in revisions],
    }


def _effect(finding: ClaimedEffect, cell: int, effect: CellEffect) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "kind": effect.kind,
        "driver": effect.named_driver(),
        "cell": cell,
        "time": iso(effect.onset_s) if effect.onset_s is not None else None,
        "mechanism": finding.hypothesis.candidate.name,
        "path": effect.path,
        "size": _number(effect.size),
        "sd": _number(effect.sd),
        "unit": UNITS[effect.path],
        "size_is": finding.hypothesis.candidate.says,
        "log_odds": _number(finding.hypothesis.log_odds, 1),
        "p_value": finding.p_value,
        "held_out_gain": _number(finding.held_out_gain, 1),
        "error_K": _errors(finding.before[cell], finding.after[cell]),
        "rivals": [_leading(one) for one in finding.rivals],
    }
    if effect.form is not None:
        key = {"wind_direction": "from_deg", "solar": "noon_h_utc"}.get(effect.driver, "below_share_of_flow")
        entry[key] = round(effect.form, 2)
    return entry


def _errors(before: HeldOutBlocks, after: HeldOutBlocks) -> dict[str, float | None]:
    """Return mean absolute errors of the held-out weeks, and those about the median of each week, K."""
    return {
        "before": _number(before.mean_absolute()),
        "after": _number(after.mean_absolute()),
        "before_without_offset": _number(before.without_offset()),
        "after_without_offset": _number(after.without_offset()),
    }


def says(entry: dict[str, Any]) -> str:
    """Return an effect of the document as a sentence."""
    form = f" from {entry['from_deg']:.0f} deg" if "from_deg" in entry else ""
    driver = f"follows {entry['driver']}" if entry["kind"] == "follows" else f"driven by {entry['driver']}{form}"
    since = f"since {entry['time']}" if entry["time"] else "all along"
    errors = entry["error_K"]
    size = f"{estimate_text(entry['size'], NORMAL * entry['sd'])} ({entry['size_is']})"
    return (
        f"cell {entry['cell']}: {entry['mechanism']} ({entry['path']}), {driver}, {since}: {size}; held-out error "
        f"{errors['before']:.3f} -> {errors['after']:.3f} K, without the weeks' offsets "
        f"{errors['before_without_offset']:.3f} -> {errors['after_without_offset']:.3f} K"
    )


def _leading(one: CellHypothesis) -> dict[str, Any]:
    effect = next(iter(one.effects.values()))
    return {
        "mechanism": one.candidate.name,
        "kind": effect.kind,
        "driver": effect.named_driver(),
        "path": effect.path,
        "cells": list(one.cells),
        "log_odds": _number(one.log_odds, 1),
    }


def write_document(diagnosis: StationDiagnosis, out: Path, revisions: Sequence[Path]) -> Path:
    """Write `diagnosis.json` into the folder `out`, which the caller holds.

    Raises
    ------
    TowerOutputError
        The folder cannot be written.
    """
    with writing(out), replacing(out / DOCUMENT) as unfinished:
        unfinished.write_text(json.dumps(document(diagnosis, revisions), indent=1) + "\n")
    return out / DOCUMENT


def adopt(diagnosis: StationDiagnosis) -> list[Path]:
    """Save each twin that lacks a found effect as a new revision with it; return the new files.

    Raises
    ------
    TwinFileError
        A twin cannot be saved.
    """
    found, saved = diagnosis.found, []
    first = diagnosis.cells[0].minutes.time_s[0]
    for draft in diagnosis.cells:
        cell = draft.record.cell
        entries = [_effect(f, cell, f.effects[cell]) for f in found.findings if cell in f.effects]
        effects = [f.effects[cell] for f in found.findings if cell in f.effects]
        if not effects:
            continue
        start, end = found.held_s[0][0], found.held_s[-1][1]
        revision = Revision(
            made_by="hil diagnose",
            record=draft.record.digest,
            record_file=draft.record.path.name,
            error_before_K={"outlet": found.before[cell].mean_absolute()},
            error_after_K={"outlet": found.after[cell].mean_absolute()},
            held_out_s=(float(start - first), float(end - first)),
            effects=tuple(f"{e.kind} by {e.named_driver()}, {e.size:.4g}" for e in effects),
            evidence="; ".join(f"{e['mechanism']}: log odds {e['log_odds']}" for e in entries),
        )
        saved.append(save_revision(adopted(draft.network, effects, revision), draft.twin))
    return saved


def _number(value: float, digits: int = 4) -> float | None:
    return round(float(value), digits) if np.isfinite(value) else None
