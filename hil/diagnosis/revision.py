"""Revisions of a twin that a diagnosis offers: with its effects, or with an empirical curve if no effect explains the
record.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from types import MappingProxyType

from hil.diagnosis.columns import CLOCK
from hil.diagnosis.store import PROPOSAL
from hil.files import printable
from twin import Network, Revision, save, save_revision
from twin.discovery import Diagnosis


def revise(diagnosis: Diagnosis, network: Network, twin: Path, record: Path, *, empirical: bool = False) -> Path | None:
    """Save the twin with its new effects as a new revision; return None if there are none.

    Parameters
    ----------
    empirical
        Adopt the curve that is offered where nothing explains the record.
    """
    bigger = _curved(diagnosis, network, record) if empirical else _grown(diagnosis, network, record)
    return save_revision(bigger, twin) if bigger is not None else None


def write_proposal(diagnosis: Diagnosis, network: Network, record: Path, out: Path) -> Path | None:
    """Write the twin with the empirical curve, `empirical.toml`, into the folder; return None if there is none."""
    bigger = _curved(diagnosis, network, record)
    path = out / PROPOSAL
    path.unlink(missing_ok=True)
    return save(bigger, path) if bigger is not None else None


def _grown(diagnosis: Diagnosis, network: Network, record: Path) -> Network | None:
    if diagnosis.network is None:
        return None
    effects = tuple(
        f"{e.kind} at {e.where}, {e.driver}, {e.value:.4g} {e.unit}, {e.shape} since {e.onset_s:.0f} s"
        for e in diagnosis.effects
    )
    before = {name: float(e.before) for name, e in diagnosis.errors.items()}
    after = {name: float(e.after) for name, e in diagnosis.errors.items()}
    return _stamped(diagnosis, diagnosis.network, network, record, effects, diagnosis.summary, before, after)


def _curved(diagnosis: Diagnosis, network: Network, record: Path) -> Network | None:
    curve = diagnosis.empirical
    if curve is None:
        return None
    effects = (f"heat of unknown origin at {curve.node}, a curve of {curve.variable}",)
    before = {name: b for name, (b, _) in curve.errors.items()}
    after = {name: a for name, (_, a) in curve.errors.items()}
    return _stamped(diagnosis, curve.network, network, record, effects, curve.says, before, after)


def _stamped(
    diagnosis: Diagnosis,
    bigger: Network,
    network: Network,
    record: Path,
    effects: tuple[str, ...],
    evidence: str,
    before: dict[str, float],
    after: dict[str, float],
) -> Network:
    """Return the extended network with its evidence, and without a time of day that no element uses."""
    used = {column for element in bigger.elements for column in element.inputs()}
    inputs = {c: s for c, s in bigger.inputs.items() if c in used or (c in network.inputs and c != CLOCK)}
    revision = Revision(
        number=network.revision.number + 1,
        made_by=f"hil diagnose {printable(record.name)}",
        window_s=(0.0, diagnosis.held_out_s[0]),
        error_before_K=before,
        error_after_K=after,
        held_out_s=diagnosis.held_out_s,
        effects=effects,
        evidence=evidence,
    )
    return dataclasses.replace(bigger, inputs=MappingProxyType(inputs), revision=revision)
