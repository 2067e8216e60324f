"""What may be claimed where little tells an effect from the twin's own error: less.

A weak effect, true or not, is claimed where it foretells what no fit saw: blocks left out, or the record's end.

A lumped twin of a rig that is not leaves a residual that looks like effects, and only a healthy record tells how much
of it is usual. Without one, the twin file itself says what the twin left on data that its commissioning had not seen.
Where re-tuning brings it back to that, nothing is claimed; and of several effects only those that win a fair share of
what the first one wins are more than the first one's form.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from twin.discovery.diagnosis import SensorError
from twin.discovery.refit.model import Model
from twin.discovery.refit.validation import validate
from twin.discovery.scoring.search import Entry
from twin.discovery.selection.part import Part, fitted
from twin.discovery.selection.ranking import Finding, rank
from twin.gauss_newton import SE90
from twin.network import Network

AS_GOOD = 1.1
"""Times the error when commissioned that a re-tuned twin may have and still count as good as then."""
NEVER = 1.5
"""The same of a twin that was never commissioned, in times its thermometers' noise."""
OTHER_LOAD = 6.25
"""Squares beyond its thermometers' noise that a re-tuned twin may leave in health, in those when commissioned: a lumped
twin leaves more where the rig moves more (24 healthy records of the virtual rig under other loads: up to 4.2)."""
TELLS, RIGHT = 0.1, 0.3
"""Mean squares, in those of noise, of what an effect changes in the part that no fit saw, from which that part tells
of it, and the share of them that has to be right: healthy records 0.49 and less, but for what is as good as
when commissioned, effects that are there 0.5 to 1.1, and one weak one 0.32."""
SHARE = 0.25
"""Of what the first effect wins that a further one must win."""
FITTED = 6
"""Effects that are fitted again, each alone."""
WEAK = 8.0
"""Score up to which an effect has to foretell something."""
FORETOLD, GAINED = 0.4, 0.3
"""Share of its gain that it wins on blocks left out, or what it takes from the squares of the last part, all sensors
together, in squares of their noise: true weak effects of blind trials win 0.48 or 0.32 and more, false alarms 0.35 and
0.28 at most."""


def as_commissioned(network: Network, errors: Mapping[str, SensorError]) -> bool:
    """Whether the re-tuned twin is as good, where no fit saw it, as the twin file says of its commissioning.

    Of a twin that was never commissioned the thermometers' noise is asked for.
    """
    known = network.revision.error_after_K
    times = AS_GOOD if known else NEVER
    return bool(errors) and all(e.before <= times * max(known.get(name, 0.0), e.noise) for name, e in errors.items())


def as_under_another_load(network: Network, errors: Mapping[str, SensorError]) -> bool:
    """Whether the re-tuned twin leaves no more, where no fit saw it, than one as good as the twin file says may leave
    of a rig that moves more."""
    known = network.revision.error_after_K
    beyond = sum(max((e.before / e.noise) ** 2 - 1.0, 0.0) for e in errors.values())
    then = sum(max((known.get(name, 0.0) / e.noise) ** 2 - 1.0, 0.0) for name, e in errors.items())
    return then > 0.0 and beyond <= OTHER_LOAD * then


def of_lumping(finding: Finding, network: Network, errors: Mapping[str, SensorError]) -> bool:
    """Whether something late is in an answer where all that is left may be of a twin of mixed volumes under another
    load."""
    return any(e.candidate.lumped for e in finding.entries) and as_under_another_load(network, errors)


def imagined(gained: float, apart: float) -> bool:
    """Whether an effect is wrong about what it changes in the part that no fit saw (`HeldOut.foretold`)."""
    return apart > TELLS and gained < RIGHT * apart


def weak(finding: Finding) -> bool:
    """Whether the first effect wins so little that it has to foretell something."""
    while finding.shorter is not None:
        finding = finding.shorter
    return finding.fit is not None and finding.start - finding.fit.total < WEAK**2


def unconfirmed(finding: Finding, errors: Mapping[str, SensorError]) -> bool:
    """Whether weak effects foretell neither the blocks that were left out nor the part that no fit saw, or are not told
    from nothing by a twin that does not know what its structure leaves."""
    if not weak(finding):
        return False
    assert finding.fit is not None
    if any(abs(e.size) < SE90 * e.sd for e in finding.fit.entries):
        return True
    gain = finding.start - finding.fit.total
    left_out = sum(f.gain for f in finding.folds)
    late = sum((e.before**2 - e.after**2) / e.noise**2 for e in errors.values())
    return left_out < FORETOLD * gain and late < GAINED


def nothing(finding: Finding) -> Finding:
    """The finding without what was found."""
    return replace(finding, entries=(), fit=None, ranked=(), folds=(), ladder=finding.ladder[:1], beside=None)


def retuned_alone(off: Mapping[str, SensorError]) -> dict[str, SensorError]:
    """Errors on what no fit saw, with nothing added to the re-tuned twin."""
    return {name: replace(e, after=e.before, means=(*e.means[:2], e.means[1])) for name, e in off.items()}


def first_alone(finding: Finding, part: Part) -> Finding:
    """The finding with its first effect alone, where the others win too little beside it."""
    if len(finding.entries) < 2 or _fair(finding):
        return finding
    singles: dict[str, Entry] = {finding.entries[0].candidate.id: finding.entries[0]}
    for entry in part.entries:
        if len(singles) < FITTED:
            singles.setdefault(entry.candidate.id, entry)
    order = rank(fitted(part, [(entry,) for entry in singles.values()]), part.contest, finding.start)
    best = order[0].fit
    part.reset()
    folds = validate(part.contest, Model.of(part.basis.probe, best.entries), best)
    part.reset()
    return replace(
        finding, entries=best.entries, fit=best, ranked=order, folds=folds, ladder=finding.ladder[:2],
        beside=replace(finding.entries[1], gain=finding.ladder[1].best_z ** 2),
    )  # fmt: skip


def _fair(finding: Finding) -> bool:
    """Whether each further rung wins its share."""
    chi = [rung.chi for rung in finding.ladder]
    return all(b - c >= SHARE * (chi[0] - chi[1]) for b, c in zip(chi[1:], chi[2:], strict=False))
