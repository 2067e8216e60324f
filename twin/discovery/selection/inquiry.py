"""How much of a record the fits may see, and which of the effects that they find are told."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twin.discovery.diagnosis import SensorError
from twin.discovery.effects.catalogue import LATE as LATE_DRIVERS
from twin.discovery.effects.shapes import EARLY_S
from twin.discovery.healthy.basis import Basis, Columns
from twin.discovery.records.grid import Grid
from twin.discovery.refit.fitting import Fit, fit
from twin.discovery.refit.model import Model
from twin.discovery.refit.validation import holds
from twin.discovery.scoring.search import Entry, scan
from twin.discovery.scoring.sweep import LAST_SHARE
from twin.discovery.selection.caution import as_commissioned, weak
from twin.discovery.selection.held_out import HeldOut, contradicted
from twin.discovery.selection.ladder import EXACT_SHARE, SECOND_SHARE, all_told, search, unaided
from twin.discovery.selection.part import Part, fitted, plainly
from twin.discovery.selection.ranking import Finding, enough, stand
from twin.elements.base import Candidate
from twin.network import Network

STILL_HELD = 0.4
"""Share of the part held out that stays so where it showed what the rest had not."""
FORETELLS_SHARE, FORETELLS = 0.15, 0.5
"""Of the squares in the part that no fit saw, in what is usual there, the share and the amount that a lesser further
effect has to take, to be told all the same."""
OTHER_FORM = 0.5
"""Share of those squares that as many effects of another form may leave, to be told in the place of plain ones."""
ALIKE, TOLD = 0.01, 4.0
"""Share by which those squares may differ where they tell neither, and the gain, in what a score at the threshold has,
from which the fit then decides."""
USUAL, BACK = 0.5, 4.0
"""Squares a sensor, in what is usual there, up to which that part is foretold as well as can be asked: then an effect
may stay that brings the tunables back to where commissioning had them, and so many times nearer than it has to win."""
WELL_SEEN, KEPT = LAST_SHARE - 0.01, 6
"""Share of a part within which a search looks for an onset wherever the part's blocks may end, and bins that no fit
sees even so."""
MORE = 1.1
"""Times a score, beyond what a longer record makes of it, from which the part held out shows more than the rest did."""
LATE = 0.85
"""Share of the part that a fit sees, beyond which an onset leaves it too little of what follows."""


@dataclass(frozen=True)
class Answer:
    """What was found in `train`, the record up to bin `split`; where `doubted`, it has to leave nothing over."""

    finding: Finding
    train: Part
    split: int
    doubted: bool
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Inquiry:
    """A record, what is known of its rig, and who is told what is being done."""

    network: Network
    record: Columns
    known: Basis
    grid: Grid
    say: Callable[[str], None]

    @cached_property
    def _scanned(self) -> tuple[Part, tuple[Candidate, ...]]:
        whole = Part.of(self.known, self.grid)
        forms = whole.sharpened()
        whole.add(forms)
        return whole, forms

    @property
    def whole(self) -> Part:
        """All of the record, to scan; answers are fitted to a part of it."""
        return self._scanned[0]

    def part(self, grid: Grid) -> Part:
        """A part of the record, or a further one, with the forms that suit this record best."""
        made = Part.of(self.known, grid)
        made.add(self._scanned[1])
        return made

    def on_unseen(self, finding: Finding, split: int) -> dict[str, SensorError]:
        """Errors of a finding from bin `split` on."""
        return self._held_out.errors(finding, split)

    def foretold(self, finding: Finding, split: int) -> tuple[float, float]:
        """How much of what it changes from bin `split` on a finding is right about (`HeldOut.foretold`)."""
        return self._held_out.foretold(finding, split)

    @cached_property
    def _held_out(self) -> HeldOut:
        return HeldOut(self.network, self.record, self.grid, self.known.plain)

    def answer(self, held_out: float) -> Answer:
        """The effects that are told, and what was kept out of their fit.

        Args:
            held_out: share of the record, at its end, that no fit sees, unless it holds what the rest does not show.
        """
        bins = len(self.grid.time)
        split = int(bins * (1.0 - held_out))
        most = max(split, int(bins * (1.0 - held_out * STILL_HELD)))
        train = self._train(split)
        if self.known.plain is None:
            self.say("re-tuning")
            calm = unaided(train)
            if as_commissioned(self.network, self.on_unseen(calm, split)):
                return Answer(calm, train, split, False)
        found = None if _begins_late(self.whole, train, split) else self._searched(train, split)
        later, why, doubted = self._later(found, train, split, most)
        notes = []
        if found is None or later > split:
            if later > split:
                notes.append(f"{why}; the fit was given the record up to {self._hours(later)}")
                train = self._train(later)
            found = self._searched(train, later, doubted)
            if found.finding.fit is None and later < most and self.whole.best_z >= train.threshold:
                # What grows shows late.
                notes.append(f"it showed nothing yet; so the fit was given {self._hours(most)}")
                found = self._searched(self._train(most), most, found.doubted)
        found = self._with_lesser(found)
        near = _near(found.finding) and not found.finding.formed
        beside = _beside(self.whole, found.finding) if near else None
        # What is there all along scores more the longer a record is.
        usual = MORE * np.sqrt(bins / found.split) * found.finding.ladder[-1].best_z
        more = beside is not None and beside.z > usual
        if beside is not None and more and (later := max(most, self._amid(beside))) > found.split:
            fuller = self._with_lesser(self._searched(self._train(later), later, found.doubted))
            if self._is_better(fuller, found):
                found = fuller
                notes.append(
                    "beside the answer, the part that was to be kept out of the fit showed more; so the fit was given "
                    f"the record up to {self._hours(later)}"
                )
        return replace(found, finding=_retuned_by_itself(found.finding, found.train), notes=tuple(notes))

    def _train(self, split: int) -> Part:
        return self.part(self.grid.part(0, split))

    def _hours(self, split: int) -> str:
        return f"{split * self.grid.step_s / 3600.0:.1f} h"

    def _amid(self, entry: Entry) -> int:
        """The bin in the middle between an onset and the record's end, or where a search can see that onset at all."""
        bins, onset = len(self.grid.time), entry.shape.onset_s / self.grid.step_s
        return min(max((int(onset) + bins) // 2, int(onset / WELL_SEEN)), bins - KEPT)

    def _later(self, found: Answer | None, train: Part, split: int, most: int) -> tuple[int, str, bool]:
        """Up to which bin a fit has to see the record after all, why, and whether its answer is doubted."""
        whole, doubted = self.whole, found is not None and found.doubted
        finding = None if found is None else found.finding
        if finding is None or (finding.fit is None and whole.best_z >= train.threshold):
            if (later := self._amid(whole.entries[0])) > split:
                began_h = whole.entries[0].shape.onset_s / 3600.0
                why = f"something changed at {began_h:.1f} h, inside the part that was to be kept out of the fit"
                return later, why, doubted
            return most, "what stands out does so in the part that was to be kept out of the fit", doubted
        if finding.fit is not None and not _near(finding):
            return split, "", doubted
        if finding.fit is not None and self._held_out.far_off(finding, split):
            why = "on the part that was to be kept out of the fit the best answer was off by more than is usual"
            seen = self.on_unseen(_retuned_by_itself(finding, train), split)
            beside = _beside(whole, finding)
            later = most if beside is None else max(most, self._amid(beside))
            return later, why, contradicted(seen, self.network) and not weak(finding)
        if any(e.shape.onset_s > LATE * split * self.grid.step_s for e in finding.entries):
            return most, "an effect begins so late that the fit saw little of it", doubted
        return split, "", doubted

    def _searched(self, train: Part, split: int, doubted: bool = False) -> Answer:
        """The search, and whether its answer has to leave nothing over.

        What was too little to be told from an error of form may be why an answer does not predict: then it is let in.
        """
        finding = search(train, self.say, EXACT_SHARE if doubted else SECOND_SHARE)
        if not doubted and finding.beside is not None and not _good(finding):
            further = search(train, self.say, EXACT_SHARE)
            if _good(further) and further.beside is None:
                finding, doubted = further, True
        return Answer(self._foretelling(_as_used(finding, train), train, split), train, split, doubted)

    def _foretelling(self, finding: Finding, train: Part, split: int) -> Finding:
        """The finding without those of its last effects that make the part that no fit saw no better.

        Where so much is left without one that there must be something, it stays: how it goes on is then told wrongly.
        So it does where that part tells neither, and the fit far more than that there is something.
        """
        while finding.shorter is not None and finding.shorter.fit is not None:
            if not enough(finding.shorter.fit.chi, finding.start / finding.count, finding.contest, quiet=True):
                break
            shorter = _as_used(finding.shorter, train)
            left, before = (self._held_out.left(f, split) for f in (finding, shorter))
            if left < before or (left < (1.0 + ALIKE) * before and _well_told(finding)):
                break
            if left < USUAL * len(self.network.sensors) and _brings_back(finding):
                break
            finding = replace(shorter, refuted=True)
        return finding

    def _with_lesser(self, found: Answer) -> Answer:
        """The answer, with what wins little beside it where that foretells.

        Without a healthy record it is not asked: there, what wins little is of the first effect's form (`caution`).
        """
        finding, train = found.finding, found.train
        if self.known.plain is None or finding.fit is None or finding.beside is None or found.doubted:
            return found
        if all_told(finding.fit, finding.contest) or _of_form(finding.beside, finding.entries):
            return found
        self.say("asking whether lesser effects foretell")
        lesser = _as_used(search(train, self.say, 0.0), train)
        if not _may_be_told(lesser, train):
            return found
        before, after = (self._held_out.left(f, found.split) for f in (finding, lesser))
        told = before - after > max(FORETELLS_SHARE * before, FORETELLS)
        return replace(found, finding=lesser) if told else found

    def _is_better(self, fuller: Answer, found: Answer) -> bool:
        """Whether an answer from more of the record foretells better, with effects more or as many, not two of one."""
        late, more = fuller.finding, len(fuller.finding.entries) - len(found.finding.entries)
        if late.fit is None or more < 0 or not stand(late.fit, late.contest):
            return False
        left, before = (self._held_out.left(f, fuller.split) for f in (late, found.finding))
        return left < (1.0 if more or weak(found.finding) else OTHER_FORM) * before


def _well_told(finding: Finding) -> bool:
    """Whether the last effect won far more than one has to, and leaves no more than noise."""
    assert finding.fit is not None and finding.shorter is not None and finding.shorter.fit is not None
    won = finding.shorter.fit.total - finding.fit.total
    return won > TOLD * finding.threshold**2 and finding.fit.chi <= finding.contest.expected


def _brings_back(finding: Finding) -> bool:
    """Whether the tunables had to leave what commissioning knows of them without the last effect, and return with it.

    They foretell as well where they have taken on what acts all along, so that squares there tell neither.
    """
    assert finding.fit is not None and finding.shorter is not None and finding.shorter.fit is not None
    return finding.shorter.fit.away > finding.threshold**2 > BACK * finding.fit.away


def _begins_late(whole: Part, train: Part, split: int) -> bool:
    """Whether what stands out in the whole record begins in the part that no fit was to see."""
    if not whole.entries or whole.best_z < train.threshold:
        return False
    late = whole.entries[0].shape.onset_s > LATE * split * whole.grid.step_s
    return train.best_z < train.threshold or (late and whole.best_z > 1.5 * train.best_z)


def _beside(whole: Part, finding: Finding) -> Entry | None:
    """What scores most in the whole record beside effects that were found in a part of it, if it is enough."""
    if finding.fit is None:
        return None
    whole.know(e.candidate for e in finding.entries)
    laws = {law.candidate.id: law for law in whole.laws}
    entries = tuple(replace(e, law=laws[e.candidate.id]).refreshed(whole.contest) for e in finding.entries)
    whole.reset()
    found = fit(whole.contest, Model.of(whole.basis.probe, entries), whole.state)
    left = scan(whole.contest, whole.laws, np.stack([e.placed(whole.contest) for e in found.entries]))
    whole.reset()
    return left[0] if left and left[0].z >= whole.threshold else None


def _of_form(beside: Entry, entries: tuple[Entry, ...]) -> bool:
    """Whether what scores beside effects is one of them again: then it is of its form, and so is what would be found
    instead, as two of one kind at one place are not told."""
    return (beside.candidate.kind, beside.candidate.where) in {(e.candidate.kind, e.candidate.where) for e in entries}


def _may_be_told(lesser: Finding, part: Part) -> bool:
    """Whether effects that win little beside the first may be: no more than noise is left, and what is late came in.

    What is late is of what a lumped twin leaves, too, but that is there all along; and what leaves more than noise is
    of another form.
    """
    if lesser.fit is None or lesser.fit.chi > lesser.contest.expected:
        return False
    late = [i for i, e in enumerate(lesser.entries) if i and e.candidate.driver in LATE_DRIVERS]
    return all(came_in(lesser.fit, i, part) for i in late)


def came_in(found: Fit, i: int, part: Part) -> bool:
    """Whether the part contradicts that the i-th effect of a fit had been there all along."""
    entry = found.entries[i]
    if entry.shape.onset_s <= EARLY_S:
        return False
    always = replace(entry, shape=replace(entry.shape, onset_s=0.0)).refreshed(part.contest)
    ((other, _),) = fitted(part, [(*found.entries[:i], always, *found.entries[i + 1 :])])
    return other.total - found.total > part.threshold**2


def all_along(finding: Finding, part: Part) -> bool:
    """Whether something late in a finding, which a twin of mixed volumes leaves, may have been there all along."""
    late = [i for i, e in enumerate(finding.entries) if e.candidate.lumped]
    return finding.fit is not None and any(not came_in(finding.fit, i, part) for i in late)


def _as_used(finding: Finding, part: Part) -> Finding:
    """The finding with values that foretell best by themselves: a twin does not know what its structure leaves."""
    return finding if finding.fit is None else replace(finding, fit=_by_itself(finding.fit, part))


def _retuned_by_itself(finding: Finding, part: Part) -> Finding:
    """The same for re-tuning alone."""
    return replace(finding, retuned=_by_itself(finding.retuned, part))


def _by_itself(found: Fit, part: Part) -> Fit:
    """A fit with the values that it has by itself; what by itself vanishes or turns round is better left as found."""
    used = plainly(part, found)
    same = all(a.size * b.size > 0.0 for a, b in zip(used.entries, found.entries, strict=True))
    return replace(used, total=found.total, chi=found.chi) if same else found


def _near(finding: Finding) -> bool:
    """Whether effects come near to explaining what they were fitted to: if not, more of the record helps nothing."""
    return finding.fit is not None and enough(
        finding.fit.chi, finding.start / finding.count, finding.contest, quiet=True
    )


def _good(finding: Finding) -> bool:
    """Whether effects leave no more than noise, however much there was, and predict what they were not taken from."""
    assert finding.fit is not None
    return enough(finding.fit.chi, 0.0, finding.contest) and holds(finding.folds)
