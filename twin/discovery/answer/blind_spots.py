"""Sentences about ambiguity groups: effects that this record, or any record of the rig, does not isolate."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from twin.discovery.answer.isolation import excluded_labels
from twin.discovery.diagnosis import Alternative
from twin.discovery.effects.ambiguity_groups import ALIKE, AmbiguityGroups, EffectLabel
from twin.discovery.scoring.search import Entry

if TYPE_CHECKING:
    from twin.discovery.evidence.finding import Finding

MOST = 8
"""Blind spots that are listed at most."""


def structural_ambiguities(finding: Finding, groups: AmbiguityGroups) -> tuple[str, ...]:
    """Return a sentence for each effect of the answer that has the signature of others on every record of the rig.

    Others that this very record excludes, because the effect is large, are left out.
    """
    out, gone = [], excluded_labels(finding) if finding.ranked else frozenset()
    for entry in finding.entries:
        label = _own(entry)
        same = [x for x in groups.indistinguishable_from(label) if x[:2] != label[:2] and x not in gone]
        if same:
            names = " and ".join(label_text(x) for x in (label, *same))
            out.append(f"{names} are indistinguishable on any record of this rig")
    return tuple(dict.fromkeys(out))


def further_group_members(
    finding: Finding, groups: AmbiguityGroups, known: tuple[Alternative, ...]
) -> tuple[Alternative, ...]:
    """Return members of the answer's ambiguity group that are not yet alternatives and that the record does not
    exclude.

    Signatures of a group agree to one part in a thousand, and a large effect shows the difference.
    """
    named = {(a.kind, a.where, a.driver) for a in known} | {e.label for e in finding.entries} | excluded_labels(finding)
    weights = {r.entries[-1].label: r.weight for r in finding.ranked[::-1]}
    out = {}
    for entry in finding.entries:
        # What grows, or was a step, follows the time for its twin too.
        label = _own(entry)
        for kind, where, driver in groups.indistinguishable_from(label):
            shown = (kind, where, entry.driver if entry.shape.grows else driver)
            if (kind, where) != label[:2] and shown not in named and shown not in out:
                out[shown] = Alternative(*shown, confidence=weights.get(shown, 0.0))
    return tuple(out.values())


def practical_ambiguities(finding: Finding) -> tuple[str, ...]:
    """Return a sentence for each pair of causes with different physics that this record does not isolate."""
    score_test = finding.score_test
    entries = list({e.candidate.id: e for e in finding.scanned}.values())[:24]
    if len(entries) < 2:
        return ()
    gram, _ = score_test.joint(np.stack([e.vector for e in entries]))
    norm = np.sqrt(np.maximum(np.diag(gram), 1e-30))
    rho = gram / np.outer(norm, norm)
    out = []
    for i in range(len(entries)):
        for j in range(i + 1, len(entries)):
            a, b = entries[i], entries[j]
            if abs(rho[i, j]) > ALIKE and a.label != b.label:
                out.append(f"{label_text(a.label)} and {label_text(b.label)} are indistinguishable on this record")
    return tuple(dict.fromkeys(out))[:MOST]


def _own(entry: Entry) -> EffectLabel:
    c = entry.candidate
    return c.kind, c.where, c.driver


def label_text(label: EffectLabel) -> str:
    """Return kind, place and driver of an effect in words."""
    kind, where, driver = label
    return f"{kind.replace('_', ' ')} at {where} ({driver.replace('_', ' ')})"
