"""Effects added one by one, each the best of the finalists after a joint fit, until nothing more is to be gained."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from twin.discovery.diagnosis import Rung
from twin.discovery.effects.catalogue import LATE
from twin.discovery.effects.shapes import EARLY_S
from twin.discovery.refit.fitting import Fit, look_at
from twin.discovery.refit.model import Model
from twin.discovery.refit.validation import validate
from twin.discovery.scoring.contest import Contest
from twin.discovery.scoring.equivalence import width
from twin.discovery.scoring.search import Entry, possible, scan, together
from twin.discovery.selection.part import Part, ended, finalists, fitted, timed, varied
from twin.discovery.selection.ranking import MOMENT_S, Finding, Ranked, enough, piled_up, rank, stand, unusual
from twin.discovery.selection.weighing import weigh

SECOND_SHARE, EXACT_SHARE = 0.06, 0.003
"""A further effect must win this share of the first one's gain, since an effect is seldom of quite the form assumed, or
that one where the first ones have no form to be wrong in (an error of reading that is there at once, or heat that is
and follows what is measured), or where it comes in at a time of its own."""
BESIDE_SHARE, SLOW_SHARE = 0.25, 0.1
"""The same where what is slow is joined by heat in its own place, which its first temperature asks for alone, or where
two that have a form come in at one moment, as one thing of another form does; and where what is slow comes second (a
lumped twin is full of it, more or less so wherever the rig works)."""
_EXACT = ("heat_source", "heat_loss")
_FORMED = (*LATE, "time_of_day")
"""Drivers of effects that bring a form of their own."""
MOST_EFFECTS = 3
MORE_LEFT, MORE_SHARE = 4.0, 0.1
"""Misfit that the answer may leave in a later record, over what noise alone leaves, or of what there was: its steps
are harsher than those that the noise was learned from."""
BEGUN, FAR = 3, 1.2
"""Rounds in which a fit of what is late comes within this many times another's squares, if it ever does: water that is
late explains at once what nothing else can."""
NOTHING_YET = 0.5
"""Thresholds, squared, by which such a fit may then be worse than none, to be gone on with, and by which it has to be
better where it has come down to less than what is typical."""
FORMED = 2.0
"""Misfit, over what noise leaves, that may be of an effect's own form (`of_own_form`)."""
EXCHANGES, EXCHANGED = 2, 3
"""Rounds in which effects may give way to others, and how many are tried in the place of each."""
PAIRED = 8
"""Single effects that are tried as one of a pair."""


def search(part: Part, say: Callable[[str], None], second_share: float = SECOND_SHARE) -> Finding:
    """Add effects one by one, each the best of the finalists after a joint fit, until nothing more is to be gained.

    Args:
        second_share: of the first effect's gain, what a further one has to win at most.
    """
    probe, contest, threshold = part.basis.probe, part.contest, part.threshold
    say("re-tuning")
    nothing = unaided(part)
    ladder = list(nothing.ladder)
    start_chi = ladder[0].chi
    chosen: tuple[Entry, ...] = ()
    best: Fit | None = None
    entries, first_gain = part.entries, 0.0
    beside: Entry | None = None
    climbed: list[tuple[Fit, tuple[Ranked, ...]]] = []
    pushed = False
    while entries and (entries[0].z >= threshold or pushed):
        beside = entries[0]
        small = share_needed((*chosen, beside), chosen, second_share) * first_gain
        little = best is not None and beside.gain < small and enough(best.chi, start_chi, contest)
        done = best is not None and (little or all_told(best, contest))
        if len(chosen) == MOST_EFFECTS or (done and not pushed):
            break
        worth = finalists(entries, chosen)
        if not worth:
            break
        groups: list[tuple[Entry, ...]] = [(*chosen, e) for e in worth]
        if len(chosen) == 1:
            groups += _pairs(part)
        say(f"fitting {len(groups)} hypotheses")
        start = ladder[0].chi * contest.count
        trials = fitted(part, groups)
        if not chosen and start - min(f.total for f, _ in trials) < threshold**2:
            # A law at measured temperatures may promise what its element does not keep, and hide what would.
            others = [e for e in part.entries if e.z >= threshold and all(e is not f for f in worth)]
            more = finalists(others, ())
            say(f"fitting {len(more)} more, and what is late")
            trials += fitted(part, [(e,) for e in more])
            # That may promise nothing at all: water that comes a minute later is as warm in the long run.
            trials += _late(part, part.late(entries[0].shape.onset_s), min(f.total for f, _ in trials))
        if best is not None and enough(best.chi, start_chi, contest):
            # What is well explained is not explained twice: a second effect at the same place would bend the first.
            trials = [t for t in trials if stand(t[0], contest)]
            if not trials:
                break
        order = rank(trials, contest, start)
        if best is None and not enough(order[0].fit.chi, start_chi, contest):
            # A hose of some litres is no multiple of what a little more of it does.
            hoses = [e for e in part.late(entries[0].shape.onset_s) if e.candidate.kind == "delay"]
            order = rank([*trials, *_late(part, hoses, order[0].fit.total)], contest, start)
        winner = order[0].fit
        if best is None and start - winner.total - unusual(winner.entries) < threshold**2:
            order = _hidden(part, start)
            if not order:
                break
            winner = order[0].fit
        if best is not None:
            small = share_needed(winner.entries, chosen, second_share) * first_gain
            back = pushed and winner.away < threshold**2
            need = threshold**2 if back or not enough(best.chi, start_chi, contest) else max(threshold**2, small)
            if best.total - winner.total < need:
                # A law at measured temperatures may promise what no element keeps.
                beside = winner.entries[-1] if best.total - winner.total >= threshold**2 else None
                break
            say("exchanging effects")
            order = _exchanged(part, trials, order, start)
            winner = order[0].fit
        finer = [*timed(part, winner, chosen), *ended(part, winner, chosen)]
        if finer:
            say("trying other times")
            order = rank([*((r.fit, r.entries) for r in order), *finer], contest, start)
            winner = order[0].fit
            part.know(e.candidate for e in winner.entries)
        best, chosen, beside = winner, winner.entries, None
        climbed.append((winner, order))
        if not first_gain:
            first_gain = max(ladder[0].chi * contest.count - winner.total, 1.0)
        entries, told = _left(part, best)
        ladder.append(told)
        # What acts all along, the tunables may take on, but not without leaving what commissioning knows of them.
        pushed = best.away > threshold**2
    while len(climbed) > 1 and (fewer := _pruned(part, climbed, start)) is not None:
        climbed[-2:] = [fewer]
        ladder[-2:] = [_left(part, fewer[0])[1]]
    formed = len(climbed) > 1 and of_own_form(climbed[-2][0], climbed[-1][0], contest, SECOND_SHARE * first_gain)
    if formed:
        del climbed[-1], ladder[-1]
        beside = None
    if climbed:
        say("leaving out blocks of time")
    found = replace(nothing, ladder=tuple(ladder))
    shorter: Finding | None = None
    for rung, (fitted_best, order) in enumerate(climbed, start=2):
        part.reset()
        folds = validate(contest, Model.of(probe, fitted_best.entries), fitted_best)
        shorter = replace(
            found, entries=fitted_best.entries, fit=fitted_best, ranked=order, folds=folds, ladder=tuple(ladder[:rung]),
            shorter=shorter,
        )  # fmt: skip
    part.reset()
    return found if shorter is None else replace(shorter, beside=beside, formed=formed)


def unaided(part: Part) -> Finding:
    """The finding of no effect: re-tuning alone."""
    part.reset()
    ((retuned, _),) = fitted(part, [()])
    part.reset()
    contest = part.contest
    return Finding(
        entries=(),
        fit=None,
        retuned=retuned,
        ranked=(),
        scanned=tuple(part.entries),
        start=contest.misfit,
        count=contest.count,
        ladder=(Rung("as commissioned", contest.misfit / max(contest.count, 1), part.best_z),),
        contest=contest,
        state=part.state,
        null=part.null,
    )


def _late(part: Part, entries: list[Entry], best: float) -> list[tuple[Fit, tuple[Entry, ...]]]:
    """Fits of what is late, but for what comes nowhere near the best, or a lumped twin may leave as much of all along.

    Args:
        best: weighted squares that another hypothesis leaves.
    """

    def usual(entry: Entry) -> bool:
        return entry.shape.onset_s <= EARLY_S and abs(entry.size) < entry.candidate.lumped

    begun = fitted(part, [(e,) for e in entries], BEGUN)
    little, none = NOTHING_YET * part.threshold**2, part.contest.misfit

    def hopeless(found: Fit) -> bool:
        (entry,) = found.entries
        small = abs(entry.size) < entry.candidate.typical
        return found.total > min(FAR * best, none - little if small else none + little)

    near = [(f, group) for f, group in begun if not hopeless(f)]
    found = [*(t for t in near if t[0].done), *fitted(part, [group for f, group in near if not f.done])]
    return [(f, group) for f, group in found if not usual(f.entries[0])]


def _hidden(part: Part, start: float) -> tuple[Ranked, ...]:
    """Pairs of effects that hide each other, ranked: together they win what neither does alone; none where none do.

    No more than noise may be left: of what a lumped twin leaves, two effects fit more than one does.
    """
    trials = [(found, pair) for found, pair in fitted(part, _pairs(part)) if found.chi <= part.contest.expected]
    order = rank(trials, part.contest, start) if trials else ()
    if order and start - order[0].fit.total - unusual(order[0].fit.entries) < 2.0 * part.threshold**2:
        return ()
    return order


def _left(part: Part, best: Fit) -> tuple[list[Entry], Rung]:
    """What scores beside the effects of a fit, and the rung that they are."""
    part.reset()
    at = best
    if best.away > part.threshold**2:
        # Far from commissioning, slopes of there mislead; what is missing is where the tunables would not have to move.
        start = part.state[: len(best.state)]
        at = replace(best, moved=np.zeros_like(best.moved), values=part.basis.probe.network.values, state=start)
    look_at(part.contest, Model.of(part.basis.probe, best.entries), at)
    entries = varied(scan(part.contest, part.laws, np.stack([e.placed(part.contest) for e in best.entries])))
    entries.sort(key=lambda e: -e.gain)
    what = " + ".join(f"{e.candidate.kind} at {e.candidate.where}" for e in best.entries)
    return entries, Rung(what, best.chi, entries[0].z if entries else 0.0)


def _pruned(
    part: Part, climbed: list[tuple[Fit, tuple[Ranked, ...]]], start: float
) -> tuple[Fit, tuple[Ranked, ...]] | None:
    """The best fit with an effect fewer than the last, and its ranking, where that does as well; None where none does.

    What was found first may stand for what the others say better.
    """
    (_, before), (best, _) = climbed[-2:]
    rest = [(*best.entries[:i], *best.entries[i + 1 :]) for i in range(len(best.entries))]
    order = rank([*((r.fit, r.entries) for r in before), *fitted(part, rest)], part.contest, start)
    found = order[0].fit
    return (found, order) if found.total - best.total < part.threshold**2 else None


def of_own_form(before: Fit, best: Fit, contest: Contest, little: float) -> bool:
    """Whether the last effect of a fit only mends the form of one before it: it wins little, there was little to win,
    and it may not stand beside that (`piled_up`: of its place, and of its moment where they leave no more than noise).
    """
    piled = not stand(best, contest) and stand(before, contest)
    return piled and before.total - best.total < little and before.chi <= FORMED * contest.expected


def all_told(found: Fit, contest: Contest) -> bool:
    """Whether no further effect is asked for: there are as many as may be, or two that leave no more than noise."""
    count = len(found.entries)
    return count == MOST_EFFECTS or (count == MOST_EFFECTS - 1 and found.chi <= contest.expected)


def _exact(entry: Entry) -> bool:
    c = entry.candidate
    return entry.shape.name == "step" and (c.kind == "sensor" or (c.kind in _EXACT and c.driver not in _FORMED))


def share_needed(entries: tuple[Entry, ...], chosen: tuple[Entry, ...], second_share: float) -> float:
    """Of the first effect's gain, what entries that are not among the `chosen` have to win beside those that are."""
    before = {e.candidate.id for e in chosen}
    known = [e for e in entries if e.candidate.id in before]
    further = [e for e in entries if e.candidate.id not in before]
    pairs = [(e, k) for k in known for e in further]
    slow = any(k.candidate.driver in LATE and k.candidate.where == e.candidate.where for e, k in pairs)
    if slow or any(_at_once(e, k) and not (_exact(e) and _exact(k)) for e, k in pairs):
        return max(second_share, BESIDE_SHARE)
    if second_share > 0.0 and any(e.candidate.driver == "history" for e in further):
        return max(second_share, SLOW_SHARE)
    own = all(_exact(k) or _apart(e, k) for e, k in pairs)
    return min(second_share, EXACT_SHARE) if own else second_share


def _apart(entry: Entry, other: Entry) -> bool:
    """Whether an effect comes in at once, at a time of its own, so that it stands for no error of form of the other.

    Not what is late: what a lumped twin leaves shows when the load first moves.
    """
    own = entry.shape.name == "step" and entry.shape.onset_s > EARLY_S and entry.candidate.driver not in LATE
    return own and abs(entry.shape.onset_s - other.shape.onset_s) > EARLY_S


def _at_once(entry: Entry, other: Entry) -> bool:
    """Whether two effects come in at one moment in the midst of a record."""
    first_s, last_s = sorted((entry.shape.onset_s, other.shape.onset_s))
    return first_s > EARLY_S and last_s - first_s < MOMENT_S


def weighed(finding: Finding, first: Part, later: list[Part]) -> tuple[Finding, tuple[str, ...]]:
    """The finding with its hypotheses ranked by all records, and what is to be said of the later ones.

    What is said of the answer itself, its score and the blocks left out, stays that of the first record.
    """
    weighed = weigh(finding.ranked, later, finding.contest.grid.span_s)
    for part in later:
        part.reset()
    order = rank(
        [(w.fit, w.fit.entries) for w in weighed], finding.contest, finding.start + sum(p.contest.misfit for p in later)
    )
    at = next(i for i, w in enumerate(weighed) if w.fit is order[0].fit)
    best = finding.ranked[at].fit
    notes = [
        f"with the answer, later record {number} still leaves {chi:.2f} of misfit where noise alone leaves "
        f"{part.contest.expected:.2f}; there is more in it, so diagnose that record by itself"
        for number, (chi, part) in enumerate(zip(weighed[at].chis, later, strict=True), start=1)
        if chi > max(MORE_LEFT * part.contest.expected, MORE_SHARE * part.contest.chi)
    ]
    same = best is finding.fit
    folds = finding.folds if same else validate(first.contest, Model.of(first.basis.probe, best.entries), best)
    first.reset()
    return replace(
        finding, ranked=order, fit=best, entries=best.entries, folds=folds, beside=finding.beside if same else None
    ), tuple(notes)


def _exchanged(
    part: Part, trials: list[tuple[Fit, tuple[Entry, ...]]], order: tuple[Ranked, ...], start: float
) -> tuple[Ranked, ...]:
    """The ranking once each effect of the best group was put to the vote again, the others being known.

    The first effect was chosen while the second was missing, and may have stood for a part of it.
    """
    tried = {_key(group) for _, group in trials}
    for _ in range(EXCHANGES):
        best, groups = order[0].fit, []
        for i in range(len(best.entries)):
            rest = (*best.entries[:i], *best.entries[i + 1 :])
            taken = {e.candidate.id for e in rest}
            part.reset()
            given = np.stack([e.placed(part.contest) for e in rest])
            found = varied(scan(part.contest, part.laws, given))
            found = sorted((e for e in found if e.candidate.id not in taken), key=lambda e: -e.gain)
            near = [e for e in found if e.gain > found[0].gain - max(10.0 * width(found[0].gain), 40.0)]
            groups += [(*rest[:i], part.closest(e, given), *rest[i:]) for e in near[:EXCHANGED]]
        new = {_key(g): g for g in groups if _key(g) not in tried and not piled_up(g, clean=True)}
        tried |= set(new)
        trials = [*trials, *(t for t in fitted(part, list(new.values())) if stand(t[0], part.contest))]
        order = rank(trials, part.contest, start)
        if order[0].fit is best:
            break
    return order


def _key(group: tuple[Entry, ...]) -> frozenset[tuple[str, str, int]]:
    """What makes a start different from another: which effects, in what shapes, since which hour."""
    return frozenset((e.candidate.id, e.shape.name, round(e.shape.onset_s / 3600.0)) for e in group)


def _pairs(part: Part) -> list[tuple[Entry, ...]]:
    """The best pairs that do not build on the best single effect, which may stand for the two of them."""
    firsts: dict[tuple[str, str], Entry] = {}
    for entry in part.entries:
        firsts.setdefault((entry.candidate.kind, entry.candidate.where), entry)
    part.reset()
    found: list[tuple[float, tuple[Entry, ...]]] = []
    for first in list(firsts.values())[:PAIRED]:
        seconds = scan(part.contest, part.laws, first.vector[None])[:3]
        many = next((k for k, s in enumerate(seconds) if s.candidate.near is not None), None)
        if many is not None:
            seconds[many] = part.closest(seconds[many], first.vector[None])
        for second in seconds:
            again = scan(part.contest, [first.law], second.vector[None])[:1]
            pair, fitted = together(part.contest, (again[0] if again else first, second))
            if possible(pair) and not piled_up(pair, clean=True):
                found.append((fitted.gain, pair))
    found.sort(key=lambda f: -f[0])
    return [pair for _, pair in found[:3]]
