"""Effects added one by one, each the best of the finalists after a joint fit, until nothing more is to be gained."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twin.discovery.basis import Basis, free_run
from twin.discovery.contest import Contest
from twin.discovery.diagnosis import Fold, Rung
from twin.discovery.equivalence import width
from twin.discovery.fitting import Fit, fit
from twin.discovery.grid import Grid
from twin.discovery.laws import Law
from twin.discovery.model import Model
from twin.discovery.null import FALSE_ALARMS, Null, null_scores
from twin.discovery.probe import Run
from twin.discovery.ranking import Finding, Ranked, enough, piled_up, rank
from twin.discovery.search import Entry, possible, refine, scan, together
from twin.discovery.validation import validate
from twin.discovery.weighing import weigh
from twin.network import Array

FINALISTS = 8
SECOND_SHARE = 0.06
"""A further effect must win this share of the first one's gain: a large effect is never of quite the form assumed."""
MOST_EFFECTS = 3
MORE_LEFT, MORE_SHARE = 4.0, 0.1
"""Misfit that the answer may leave in a later record, over what noise alone leaves, or of what there was: its steps
are harsher than those that the noise was learned from."""
PAIRED = 8
"""Single effects that are tried as one of a pair."""


@dataclass
class Part:
    """A part of a record, ready to be searched."""

    basis: Basis
    grid: Grid
    state: Array
    run: Run
    contest: Contest
    laws: list[Law]
    entries: list[Entry]

    @classmethod
    def of(cls, known: Basis, grid: Grid) -> Part:
        state, run, _, _ = free_run(known.probe, grid)
        contest = Contest(known.probe, grid, state, run, known.noise, known.prior)
        found = known.book.laws(grid, run)
        entries = [refine(contest, e) for e in _varied(scan(contest, found, None, known.structure))]
        entries.sort(key=lambda e: -e.gain)
        return cls(known, grid, state, run, contest, found, entries)

    @property
    def best_z(self) -> float:
        return self.entries[0].z if self.entries else 0.0

    @cached_property
    def null(self) -> Null:
        return null_scores(self.contest, self.laws)

    @property
    def threshold(self) -> float:
        return self.null.quantile(FALSE_ALARMS)

    def reset(self) -> None:
        self.contest.look_at(self.run)


def search(part: Part, say: Callable[[str], None], second_share: float = SECOND_SHARE) -> Finding:
    """Add effects one by one, each the best of the finalists after a joint fit, until nothing more is to be gained.

    Args:
        second_share: of the first effect's gain, what a further one has to win.
    """
    network, contest, threshold = part.basis.probe.network, part.contest, part.threshold
    ids = part.basis.probe.scaling.ids
    start_chi = contest.misfit / max(contest.count, 1)
    ladder = [Rung("as commissioned", start_chi, part.best_z)]
    part.reset()
    say("re-tuning")
    retuned = fit(contest, Model.of(network, (), ids), part.state)
    part.reset()
    chosen: tuple[Entry, ...] = ()
    best: Fit | None = None
    ranked: tuple[Ranked, ...] = ()
    entries, first_gain = part.entries, 0.0
    while entries and entries[0].z >= threshold and len(chosen) < MOST_EFFECTS:
        small = second_share * first_gain
        if best is not None and entries[0].gain < small and enough(best.chi, start_chi, contest):
            break
        finalists = _finalists(entries, chosen)
        if not finalists:
            break
        groups: list[tuple[Entry, ...]] = [(*chosen, e) for e in finalists]
        if len(chosen) == 1:
            groups += _pairs(part)
        say(f"fitting {len(groups)} hypotheses")
        start = ladder[0].chi * contest.count
        trials = _fitted(part, groups)
        if not chosen and start - min(f.total for f, _ in trials) < threshold**2:
            # A law at measured temperatures may promise what its element does not keep, and hide what would.
            others = [e for e in part.entries if e.z >= threshold and all(e is not f for f in finalists)]
            more = _finalists(others, ())
            say(f"fitting {len(more)} more")
            trials += _fitted(part, [(e,) for e in more])
        if best is not None and enough(best.chi, start_chi, contest):
            # What is well explained is not explained twice: a second effect at the same place would bend the first.
            trials = [t for t in trials if not piled_up(t[0].entries)]
            if not trials:
                break
        order = rank(trials, contest, start)
        winner = order[0].fit
        if best is None and start - winner.total < threshold**2:
            break
        if best is not None:
            need = threshold**2 if not enough(best.chi, start_chi, contest) else max(threshold**2, small)
            if best.total - winner.total < need:
                break
        best, ranked, chosen = winner, order, winner.entries
        if not first_gain:
            first_gain = max(ladder[0].chi * contest.count - winner.total, 1.0)
        part.reset()
        again = fit(contest, Model.of(network, chosen, ids), part.state, rounds=2)
        given = np.stack([e.placed(contest) for e in again.entries])
        entries = _varied(scan(contest, part.laws, given, part.basis.structure))
        entries.sort(key=lambda e: -e.gain)
        ladder.append(
            Rung(
                " + ".join(f"{e.candidate.kind} at {e.candidate.where}" for e in chosen),
                best.chi,
                entries[0].z if entries else 0.0,
            )
        )
    folds: tuple[Fold, ...] = ()
    if best is not None:
        say("leaving out blocks of time")
        folds = validate(contest, Model.of(network, best.entries, ids), best)
    part.reset()
    return Finding(
        entries=chosen,
        fit=best,
        retuned=retuned,
        ranked=ranked,
        scanned=tuple(part.entries),
        start=ladder[0].chi * contest.count,
        count=contest.count,
        ladder=tuple(ladder),
        contest=contest,
        state=part.state,
        null=part.null,
        folds=folds,
        beside=entries[0] if chosen and entries and entries[0].z >= threshold else None,
    )


def weighed(finding: Finding, first: Part, later: list[Part]) -> tuple[Finding, tuple[str, ...]]:
    """The finding with its hypotheses ranked by all records, and what is to be said of the later ones.

    What is said of the answer itself, its score and the blocks left out, stays that of the first record.
    """
    network, ids = first.basis.probe.network, first.basis.probe.scaling.ids
    weighed = weigh(finding.ranked, later, network, ids, finding.contest.grid.span_s)
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
    folds = finding.folds if same else validate(first.contest, Model.of(network, best.entries, ids), best)
    first.reset()
    return replace(
        finding, ranked=order, fit=best, entries=best.entries, folds=folds, beside=finding.beside if same else None
    ), tuple(notes)


def _fitted(part: Part, groups: list[tuple[Entry, ...]]) -> list[tuple[Fit, tuple[Entry, ...]]]:
    """Each group of effects fitted, from the commissioned values."""
    network, ids = part.basis.probe.network, part.basis.probe.scaling.ids
    trials = []
    for group in groups:
        part.reset()
        trials.append((fit(part.contest, Model.of(network, group, ids), part.state), group))
    return trials


def _pairs(part: Part) -> list[tuple[Entry, ...]]:
    """The best pairs that do not build on the best single effect, which may stand for the two of them."""
    firsts: dict[tuple[str, str], Entry] = {}
    for entry in part.entries:
        firsts.setdefault((entry.candidate.kind, entry.candidate.where), entry)
    part.reset()
    found: list[tuple[float, tuple[Entry, ...]]] = []
    for first in list(firsts.values())[:PAIRED]:
        seconds = scan(part.contest, part.laws, first.vector[None], part.basis.structure)[:3]
        for second in seconds:
            again = scan(part.contest, [first.law], second.vector[None])[:1]
            pair, fitted = together(part.contest, (again[0] if again else first, second))
            if possible(pair) and not piled_up(pair):
                found.append((fitted.gain, pair))
    found.sort(key=lambda f: -f[0])
    return [pair for _, pair in found[:3]]


def _varied(entries: list[Entry]) -> list[Entry]:
    """The best entries of a scan, one of each candidate and shape."""
    best: dict[tuple[str, str], Entry] = {}
    for entry in entries:
        best.setdefault((entry.candidate.id, entry.shape.name), entry)
    return list(best.values())[: 5 * FINALISTS]


def _finalists(entries: list[Entry], chosen: tuple[Entry, ...]) -> list[Entry]:
    """The entries worth a fit: the best of each candidate and shape, near the top by gain."""
    found: list[Entry] = []
    taken = {e.candidate.id for e in chosen}
    seen: set[tuple[str, str]] = set()
    places: dict[tuple[str, str], int] = {}
    for entry in entries:
        key = (entry.candidate.id, entry.shape.name)
        place = (entry.candidate.kind, entry.candidate.where)
        if key in seen or entry.candidate.id in taken:
            continue
        if entry.gain < entries[0].gain - max(width(entries[0].gain) * 10.0, 40.0) and len(found) >= 3:
            break
        if places.get(place, 0) >= 4:
            continue
        seen.add(key)
        places[place] = places.get(place, 0) + 1
        found.append(entry)
        if len(found) == FINALISTS:
            break
    # What grows is only believed where the same thing all at once does worse.
    for grown in [e for e in found if e.shape.name != "step"]:
        at_once = [e for e in entries if e.candidate.id == grown.candidate.id and e.shape.name == "step"]
        if at_once and at_once[0] not in found:
            found.append(at_once[0])
    return found
