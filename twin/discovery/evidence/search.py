"""Search by evidence: single effects, then sets of them in a beam, then fits of the likeliest as real elements."""

from __future__ import annotations

import copy
import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from twin.discovery.diagnosis import Rung
from twin.discovery.effects.laws import CandidateLaw
from twin.discovery.evidence.hypotheses import Class, Found, Hypothesis, Place, Prior, apart, class_of, place
from twin.discovery.evidence.marginal import form_quadratic, joint, log_widths, widths
from twin.discovery.evidence.part import Part, at_another_level, continued, fitted, gains, slower
from twin.discovery.evidence.priors import CLAIM, FAULT, UNLISTED
from twin.discovery.evidence.scan import STEADY, logsumexp, refined, scan
from twin.discovery.places.localise import WALK_PER_BLOCK
from twin.discovery.refit.fitting import AGAIN, Fit
from twin.discovery.scoring.score_tests import ScoreTest
from twin.discovery.scoring.search import Entry
from twin.discovery.scoring.sweep import LAST_SHARE
from twin.elements.candidates import INTERMITTENT

LEADING = 24
"""Single effects that are tried as members of a pair; a prototype missed true pairs with five."""
MOST_EFFECTS = 3
"""Effects in a set at most. A judgement: each further one is a twentieth as likely (`FAULT`)."""
BESIDE = 6
"""Further effects that are tried with each."""
PER_CLASS = 3
"""Leading laws of one class: their driver is determined by fits."""
AMBIGUOUS, LEADS = 10.0, 0.02
"""Log odds behind the best, and that share of them, within which an unfinished fit is continued."""
FITTED, NEXT, MOST_FITTED = 6, 3, 9
"""Hypotheses that are fitted as real elements at first, then in one batch, and in all: an unfitted leader is fitted
next."""

MOST_LATE = 4
"""Classes of lags and delays that are fitted: those with the largest linear gain."""
SLOWER = (1.7, 1.3, 1.1)
"""Ratios of time constants that are tried in turn around the likeliest of the catalogue's, which are a factor of 3
apart; the first is repeated while it gains."""
NEARER = (0.04, 0.02, 0.01, 0.005, 0.0025)
"""Shares by which the level of a limit is moved in turn; each is repeated while it gains. A judgement: from a third of
the distance of two levels that are tried down to a form error."""
NEARLY_EXPLAINED = 0.8
"""Share of the fall of the squares by an answer that leaves no more than noise, which a nonlinear effect has by one
simulation before its fit. A judgement: a fit from a factor of two of the right size gains the rest."""
BEGUN = 3
"""Rounds of a fit after which its squares are comparable."""


def searched(part: Part, say: Callable[[str], None] = lambda _: None, given: Sequence[tuple[Entry, ...]] = ()) -> Found:
    """Return the hypotheses of a part of a record with their posterior odds.

    Args:
        given: effects that a shorter part showed; a longer one may hide an effect that is nonlinear in its size.
    """
    score_test = part.score_test
    laws: list[CandidateLaw] = [*part.laws, *part.open_candidates]
    prior = Prior(part.laws, part.open_candidates)
    part.reset()
    say("re-tuning")
    ((retuned, _),) = fitted(part, [()])
    part.reset()
    say("scanning by evidence")
    scanned = sorted([*part.scanned, *scan(score_test, part.open_candidates)], key=lambda e: -e.log_bayes)
    first = [refined(score_test, e) for e in leading(scanned, prior)]
    level = sorted((_set(part, (e,), prior) for e in first), key=lambda h: -h.odds)
    misfit = score_test.misfit
    found = [h for group in given if (h := refitted(part, group, prior, misfit)) is not None]
    for count in range(1, MOST_EFFECTS + 1):
        if not level or level[0].odds < (CLAIM if count > 1 else 0.0):
            break
        say(f"fitting {min(len(level), FITTED)} hypotheses of {count} effect{'s' if count > 1 else ''}")
        found = _fitted(part, found, level, misfit)
        explained = _explained(found, score_test)
        if count == 1:
            found = with_nonlinear(part, found, prior, misfit, NEARLY_EXPLAINED if explained else 0.0)
        if explained:
            # Many levels of a limit leave no more than noise, each with another share.
            limited = any(e.candidate.is_limit for e in found[0].entries)
            found = _retimed(part, found, prior, misfit) if limited else found
            break
        found = _retimed(part, found, prior, misfit)
        if _explained(found, score_test):
            break
        if count < MOST_EFFECTS:
            level = _grown(part, [h for h in found if len(h.entries) == count], prior, laws)
    part.reset()
    # Where the tunables bend, re-tuning alone comes to other squares than to first order.
    nothing = 0.5 * (misfit - retuned.total)
    found = [replace(h, log_bayes=h.log_bayes - nothing) for h in found]
    unlisted = {place: odds - nothing for place, odds in log_odds_unlisted(part).items()}
    return Found(tuple(found), scanned, retuned, unlisted)


def refitted(part: Part, group: tuple[Entry, ...], prior: Prior, misfit: float) -> Hypothesis | None:
    """Return effects that were found in another part of the record, fitted in this one; None if there are none."""
    if not group:
        return None
    part.know(e.candidate for e in group if all(e.candidate.id != law.candidate.id for law in part.open_candidates))
    laws = {law.candidate.id: law for law in (*part.open_candidates, *part.laws)}
    entries = tuple(replace(e, law=laws[e.candidate.id]).refreshed(part.score_test) for e in group)
    ((fit, _),) = fitted(part, [entries])
    return replace(_with_fit(part, replace(_set(part, entries, prior), entries=entries), fit, misfit), settled=True)


def _explained(found: list[Hypothesis], score_test: ScoreTest) -> bool:
    """Return True where the likeliest hypothesis is fitted and leaves no more than noise."""
    return found[0].fit is not None and found[0].fit.chi <= score_test.expected


def leading(entries: list[Entry], prior: Prior) -> list[Entry]:
    """Return the likeliest entries: some of each class, one of each candidate and shape, and one of each transient
    claim.
    """
    entries = sorted(entries, key=lambda e: -(e.log_bayes + prior.of(e)))
    taken: Counter[object] = Counter()
    found: list[Entry] = []
    for entry in entries:
        claim = entry.label, entry.shape.name
        if taken[claim] and entry.shape.name in INTERMITTENT:
            continue
        # What changes twice resembles a law of some driver; by itself its own law may come behind those.
        steady = class_of(entry), entry.candidate.driver in STEADY
        room = taken[class_of(entry)] < PER_CLASS or (steady[1] and not taken[steady])
        if room and not (found and entry.log_bayes <= 0.0):
            taken[class_of(entry)] += 1
            taken[steady] += 1
            taken[claim] += 1
            found.append(entry)
        if len(found) == LEADING:
            break
    return found


def _set(part: Part, entries: tuple[Entry, ...], prior: Prior) -> Hypothesis:
    """Return a set of effects with its linear evidence."""
    together = joint(part.score_test, entries)
    sized = tuple(replace(e, size=float(s)) for e, s in zip(entries, together.sizes, strict=True))
    log_bayes = together.log_bayes + sum(e.log_occam for e in entries)
    log_prior = sum(prior.of(e) for e in entries)
    return Hypothesis(sized, log_prior, log_bayes, together.quadratic, together.form_error, together.log_width)


def _grown(part: Part, known: list[Hypothesis], prior: Prior, laws: Sequence[CandidateLaw]) -> list[Hypothesis]:
    """Return the leading sets extended by one more effect, by falling odds."""
    grown: dict[object, Hypothesis] = {}
    for rank, one in enumerate(known[: LEADING if len(known[0].entries) == 1 else FITTED]):
        beside = joint(part.score_test, _at_first_order(part, one))
        others = [law for law in laws if apart(law.candidate, one.entries)]
        scanned = scan(part.score_test, others, beside, transient=rank < PER_CLASS)
        for entry in leading(scanned, prior)[:BESIDE]:
            if entry.log_bayes + prior.of(entry) <= 0.0:
                break
            hypothesis = _set(part, (*_at_first_order(part, one), refined(part.score_test, entry, beside)), prior)
            grown.setdefault(_key(hypothesis), hypothesis)
    likeliest = sorted(grown.values(), key=lambda h: -h.odds)[: 2 * LEADING]
    near = _near(likeliest)
    settled = [
        _set(part, _settled(part, h.entries[:-1], h.entries[-1]), prior) if h.odds > near else h for h in likeliest
    ]
    return sorted(settled, key=lambda h: -h.odds)


def _near(hypotheses: Sequence[Hypothesis]) -> float:
    """Return the log odds above which a hypothesis is continued beside the likeliest, the first one."""
    best = hypotheses[0].odds if hypotheses else 0.0
    return best - AMBIGUOUS - LEADS * abs(best)


def _at_first_order(part: Part, h: Hypothesis) -> tuple[Entry, ...]:
    """Return the effects of a hypothesis with the vectors of their shapes in the part's score test."""
    return tuple(e.refreshed(part.score_test) for e in h.entries)


def _settled(part: Part, known: tuple[Entry, ...], entry: Entry) -> tuple[Entry, ...]:
    """Return effects with the onsets of the known ones refined after a further one has joined them."""
    settled = list(known)
    for i, one in enumerate(known):
        if one.shape.onset_s > 0.0:
            others = (*settled[:i], *settled[i + 1 :], entry)
            settled[i] = refined(part.score_test, one, joint(part.score_test, others))
    return (*settled, entry)


def _key(h: Hypothesis) -> tuple[object, ...]:
    return tuple(sorted((e.candidate.id, e.shape.name) for e in h.entries))


def _fitted(part: Part, known: list[Hypothesis], level: list[Hypothesis], misfit: float) -> list[Hypothesis]:
    """Return all hypotheses by falling odds, with the leading ones fitted as real elements.

    First some with different claims are fitted, then each unfitted leader.
    """
    found, done = [*known, *level], 0
    leaders = sorted((h for h in level if h.odds > 0.0), key=lambda h: -_promise(h, known))
    batch = _varied(leaders)[: FITTED // len(level[0].entries)] if level else []
    while batch and done < MOST_FITTED:
        done += len(batch)
        for (fit, _), h in zip(fitted(part, [h.entries for h in batch], BEGUN), batch, strict=True):
            found[found.index(h)] = _with_fit(part, h, fit, misfit)
        found.sort(key=lambda h: -h.odds)
        found = _settled_fits(part, found, misfit)
        best = max((h.odds for h in found if h.fit is not None), default=-math.inf)
        batch = [h for h in _by_promise(found) if h.fit is None and h in level and _promise(h, found) > best][:NEXT]
    return found


def _promise(h: Hypothesis, found: list[Hypothesis]) -> float:
    """Return the log odds that a hypothesis may reach by a fit: others of the same claim, or of a part of it, gained as
    much by theirs. What one of them has lost, another need not lose.
    """
    if h.fit is not None:
        return h.odds
    own = Counter(h.labels)
    gained = (f.gained for f in found if f.fit is not None and Counter(f.labels) <= own)
    return h.odds + max((0.0, *gained))


def _by_promise(found: list[Hypothesis]) -> list[Hypothesis]:
    return sorted(found, key=lambda h: -_promise(h, found))


def _settled_fits(part: Part, found: list[Hypothesis], misfit: float) -> list[Hypothesis]:
    """Return the hypotheses with the fits of the leading ones continued until they converge."""
    while True:
        fits = [h for h in found if h.fit is not None]
        open_ones = [h for h in fits if h.fit is not None and not h.fit.done and not h.settled]
        near = [h for h in open_ones if h.odds > _near(fits)][:NEXT]
        if not near:
            return found
        for new, h in zip(continued(part, [h.fit for h in near if h.fit is not None]), near, strict=True):
            found[found.index(h)] = replace(_with_fit(part, h, new, misfit), settled=True)
        found.sort(key=lambda h: -h.odds)


def _varied(hypotheses: list[Hypothesis]) -> list[Hypothesis]:
    """Return the first hypothesis of each claim, then the others."""
    first: dict[object, Hypothesis] = {}
    for h in hypotheses:
        first.setdefault(h.labels, h)
    return [*first.values(), *(h for h in hypotheses if h is not first[h.labels])]


def _with_fit(part: Part, h: Hypothesis, fit: Fit, misfit: float) -> Hypothesis:
    """Return a hypothesis with the evidence of its fit."""
    own = copy.copy(part.score_test)
    own.take(fit.residual, fit.moved)
    entries = tuple(e.refreshed(own) for e in fit.entries)
    sizes = np.array([e.size for e in entries])
    unusual = float(((sizes / widths(np.array([e.candidate.typical for e in entries]), sizes)) ** 2).sum())
    quadratic = misfit - fit.total - unusual + form_quadratic(own, entries, h.form_error)
    # A wider prior costs its width twice: as a rarer order, and as a lower density within it.
    larger = log_widths([e.candidate for e in entries], sizes) - h.log_width
    won = 0.5 * (quadratic - h.quadratic) - 2.0 * larger
    return replace(
        h,
        entries=fit.entries,
        fit=fit,
        quadratic=quadratic,
        log_bayes=h.log_bayes + won,
        log_width=h.log_width + larger,
        gained=h.gained + won,
    )


def with_nonlinear(
    part: Part, found: list[Hypothesis], prior: Prior, misfit: float, least: float = 0.0
) -> list[Hypothesis]:
    """Return the hypotheses with lags, delays and large losses of flow, fitted from a large size.

    Args:
        least: share of the likeliest one's fall of the squares that they have by a simulation before they are fitted.
    """
    first = found[0].fit if found else None
    onset = found[0].entries[0].shape.onset_s if found else 0.0
    # The fit of a lost flow from its linear size, which may be more than all, tells little.
    known = {e.candidate.id for h in found if h.fit is not None for e in h.entries if not e.candidate.total_loss}
    near = _promising(e for _, e in part.secants) + _promising(e for _, e in part.large_losses)
    entries = [e for e in part.nonlinear_starts(onset) if e.candidate.id not in known and class_of(e) in near]
    gained = np.array(gains(part, entries))
    enough = least * (0.0 if first is None else misfit - first.total)
    lead = [i for i in np.argsort(-gained, kind="stable")[: 2 * FITTED] if gained[i] >= enough]
    begun = fitted(part, [(entries[i],) for i in lead], BEGUN)
    better = [(f, e) for f, (e,) in begun if misfit - f.total > max(2.0 * CLAIM, enough)]
    better.sort(key=lambda g: g[0].total)
    late = [_with_fit(part, replace(_set(part, (e,), prior), entries=(e,)), fit, misfit) for fit, e in better[:FITTED]]
    if not late and enough > 0.0:
        return found
    every = sorted(_once([*found, *late], part.score_test.step_s), key=lambda h: -h.odds)
    return _settled_fits(part, every, misfit) if every else []


def _once(hypotheses: Iterable[Hypothesis], step_s: float) -> list[Hypothesis]:
    """Return the hypotheses, of fits of one law that came to the same size and onset the likelier alone."""
    kept: list[Hypothesis] = []
    for h in sorted(hypotheses, key=lambda h: -h.odds):
        if not any(_same(h, other, step_s) for other in kept):
            kept.append(h)
    return kept


def _same(one: Hypothesis, other: Hypothesis, step_s: float) -> bool:
    """Return True if two fits of one effect each came to the same law, size and onset."""
    if one.fit is None or other.fit is None or len(one.entries) > 1 or one.labels != other.labels:
        return False
    (a,), (b,) = one.entries, other.entries
    alike = a.candidate.id == b.candidate.id and a.shape.name == b.shape.name
    return alike and abs(a.shape.onset_s - b.shape.onset_s) <= step_s and abs(a.size - b.size) <= max(a.sd, b.sd)


def _promising(entries: Iterable[Entry]) -> list[Class]:
    """Return the classes of greatest linear gain, if that allows a claim."""
    gained: dict[Class, float] = {}
    for e in entries:
        if e.gain > 2.0 * CLAIM:
            gained[class_of(e)] = max(gained.get(class_of(e), 0.0), e.gain)
    return sorted(gained, key=lambda each: -gained[each])[:MOST_LATE]


def _retimed(part: Part, found: list[Hypothesis], prior: Prior, misfit: float) -> list[Hypothesis]:
    """Return the hypotheses with slow, limited or periodic effects of different claims fitted at other time constants,
    levels and onsets.
    """
    near = _near(found)
    slow = [h for h in found if h.fit is not None and h.odds > near and any(map(_is_retimed, h.entries))]
    first: dict[object, Hypothesis] = {}
    for h in slow:
        first.setdefault(h.labels, h)
    tried = list(found)
    for h in [*first.values()][:NEXT]:
        tried += _of_other_times(part, h, prior, misfit)
    return _settled_fits(part, sorted(tried, key=lambda h: -h.odds), misfit) if first else found


def _is_retimed(entry: Entry) -> bool:
    return entry.candidate.slower is not None or entry.candidate.is_limit or entry.shape.name == "periodic"


def _of_other_times(part: Part, best: Hypothesis, prior: Prior, misfit: float) -> list[Hypothesis]:
    """Return fits of a hypothesis at other time constants, levels and onsets of its effects."""
    tried: list[Hypothesis] = []

    def fit_each(i: int, entries: list[Entry]) -> None:
        nonlocal best, tried
        assert best.fit is not None  # only fitted hypotheses are tried at other times
        groups = [(*best.entries[:i], entry, *best.entries[i + 1 :]) for entry in entries]
        new = [
            _with_fit(part, replace(_set(part, group, prior), entries=group), fit, misfit)
            for fit, group in fitted(part, groups, AGAIN, best.fit.moved)
        ]
        tried += new
        best = max((best, *new), key=lambda h: h.odds)

    for i, entry in enumerate(best.entries):
        while entry.shape.name == "periodic" and (other := _turned(part, best, i)) is not None:
            before = best
            fit_each(i, [other])
            if best is before:
                break
        for share in NEARER if entry.candidate.is_limit else ():
            while True:
                before = best
                moved_by = (1.0 + share, 1.0 - share)
                fit_each(i, [o for f in moved_by if (o := at_another_level(part, best.entries[i], f)) is not None])
                if best is before:
                    break
        if entry.candidate.slower is None:
            continue
        for share in SLOWER:
            while True:
                before = best
                fit_each(i, [o for f in (share, 1.0 / share) if (o := slower(part, best.entries[i], f)) is not None])
                if share < SLOWER[0] or best is before:
                    break
        # When it came in is told within its time constant only.
        now = best.entries[i]
        reach_s = now.candidate.slow_s if now.shape.onset_s > 0.0 else 0.0
        moved = [now.shape.onset_s + f * reach_s for f in (-1.0, -0.5, 0.5, 1.0)]
        last_s = LAST_SHARE * part.grid.span_s
        shapes = [replace(now.shape, onset_s=t) for t in moved if reach_s and 0.0 < t < last_s]
        fit_each(i, [replace(now, shape=shape).refreshed(part.score_test) for shape in shapes])
    return tried


def _turned(part: Part, h: Hypothesis, i: int) -> Entry | None:
    """Return the effect `i` of a fitted hypothesis with the likeliest first period, linearised about the fit.

    None if that is the one it has. A fit changes an onset by less than a period.
    """
    assert h.fit is not None
    own = copy.copy(part.score_test)
    others = tuple(e.refreshed(own) for k, e in enumerate(h.entries) if k != i)
    this = h.entries[i].refreshed(own)
    own.take(h.fit.residual + own.signatures(this.vector[None])[:, 0] * this.size, h.fit.moved)
    found = refined(own, this, joint(own, others) if others else None)
    moved_s = abs(found.shape.onset_s - this.shape.onset_s)
    return found.refreshed(part.score_test) if moved_s > own.step_s else None


def log_odds_unlisted(part: Part) -> dict[Place, float]:
    """Return the log odds of one unknown quantity, free in each block, by its place."""
    free = part.free
    at: dict[Place, list[float]] = {}
    for course in free:
        at.setdefault(place(course.where, course.signature == "sensor"), []).append(course.log_evidence)
    share = math.log(FAULT * UNLISTED) - math.log(len(free) * len(WALK_PER_BLOCK)) if free else 0.0
    return {place: logsumexp(np.array(found)) + share for place, found in at.items()}


def ladder_of(part: Part, reported: Hypothesis | None, scanned: Sequence[Entry]) -> tuple[Rung, ...]:
    """Return the misfit as commissioned and with the reported effects, each with the best next score."""
    score_test = part.score_test
    best = max((e.z for e in scanned[:LEADING]), default=0.0)
    rungs = [Rung("as commissioned", score_test.misfit / max(score_test.count, 1), best)]
    if reported is not None and reported.fit is not None:
        what = " + ".join(f"{e.candidate.kind} at {e.candidate.where}" for e in reported.entries)
        left = scan(score_test, part.laws, joint(score_test, _at_first_order(part, reported)), transient=False)
        rungs.append(Rung(what, reported.fit.chi, max((e.z for e in left[:LEADING]), default=0.0)))
    return tuple(rungs)
