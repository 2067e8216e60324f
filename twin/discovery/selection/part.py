"""A part of a record, ready to be searched, and which of its hypotheses are worth a fit."""

from __future__ import annotations

import copy
import itertools
from collections import Counter
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from twin.discovery.effects.catalogue import LATE
from twin.discovery.effects.laws import Law
from twin.discovery.effects.open_laws import OpenLaw, open_laws
from twin.discovery.effects.probe import Run, free_run
from twin.discovery.effects.shapes import EARLY_S, Shape
from twin.discovery.healthy.basis import Basis
from twin.discovery.records.grid import Grid
from twin.discovery.refit.fitting import AGAIN, ROUNDS, Fit, fit
from twin.discovery.refit.model import Model
from twin.discovery.scoring.contest import Contest
from twin.discovery.scoring.equivalence import width
from twin.discovery.scoring.null import FALSE_ALARMS, Null, null_scores
from twin.discovery.scoring.search import Entry, refine, scan
from twin.elements.base import Candidate
from twin.network import Array

FINALISTS = 8
SIDE_BY_SIDE = 4
"""Fits that run at once, where there are so many cores: kernels do without the interpreter's lock."""
SLOWER = (1.4, 1.2, 1.1)
"""Factors by which a time constant is tried longer and shorter, one after the other."""
ENDS = (0.6, 0.8, 0.93)
"""Shares of a record after which what rises to its end is tried as having ended."""
MUCH = 4.0
"""Typical sizes at which a fit of what is late begins."""
WORTH = 4.0
"""Gain that another form of the same thing must have over the catalogue's to be looked at."""


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
    fits: dict[tuple[object, ...], Fit] = field(default_factory=dict, repr=False)
    """What was fitted before, with and without what the twin knows of its structure: searches ask again."""
    forms: dict[Law, list[Law]] = field(default_factory=dict, repr=False)
    """Laws of the forms near another's, which searches come by again and again."""

    @classmethod
    def of(cls, known: Basis, grid: Grid) -> Part:
        state, run, _, _ = free_run(known.probe, grid)
        found = [*known.book.laws(grid, run), *known.book.laws(grid, run, known.book.put_in)]
        contest = known.contest(grid, state, run, found)
        entries = [refine(contest, e) for e in varied(scan(contest, found))]
        entries.sort(key=lambda e: -e.gain)
        return cls(known, grid, state, run, contest, found, entries)

    def sharpened(self) -> tuple[Candidate, ...]:
        """Of what comes in many forms, those that score better at each place than the catalogue's own."""
        best: dict[tuple[str, str, str], Entry] = {}
        for entry in self.entries:
            c = entry.candidate
            if c.near is not None:
                best.setdefault((c.kind, c.where, c.driver), entry)
        closest = [(first, self.closest(first)) for first in best.values()]
        return tuple(found.candidate for first, found in closest if found.gain > first.gain + WORTH)

    def closest(self, entry: Entry, given: Array | None = None) -> Entry:
        """Of what comes in many forms, the one that scores best.

        Args:
            given: vectors (e, sites, b) of effects that are already known.
        """
        while entry.candidate.near is not None:
            if entry.law not in self.forms:
                self.forms[entry.law] = self.basis.book.laws(self.grid, self.run, entry.candidate.near())
            better = scan(self.contest, self.forms[entry.law], given)
            if not better or better[0].gain < entry.gain:
                break
            entry = better[0]
        return entry

    def add(self, candidates: tuple[Candidate, ...]) -> None:
        """Take further candidates into the search."""
        if not candidates:
            return
        laws = self.basis.book.laws(self.grid, self.run, candidates)
        self.laws = [*self.laws, *laws]
        entries = [refine(self.contest, e) for e in varied(scan(self.contest, laws))]
        self.entries = sorted([*self.entries, *entries], key=lambda e: -e.gain)

    def know(self, candidates: Iterable[Candidate]) -> None:
        """Keep the laws of further candidates at hand, without looking for them."""
        known = {law.candidate.id for law in self.laws}
        further = {c.id: c for c in candidates if c.id not in known}
        named = tuple(c for c in further.values() if not c.column)
        sites = {law.site.column: law.site for law in self.opened}
        opened = [
            OpenLaw(c, sites[c.column], c.follows(self.grid.time, self.grid.inputs))
            for c in further.values()
            if c.column in sites and c.follows is not None
        ]
        self.laws = [*self.laws, *self.basis.book.laws(self.grid, self.run, named), *opened]

    @cached_property
    def opened(self) -> list[OpenLaw]:
        """Laws without a name: any input at every site."""
        return open_laws(self.basis.probe.network, self.grid, self.laws)

    def late(self, onset_s: float) -> list[Entry]:
        """Every law that is late, at several times a typical size, all along and since an onset.

        Of time constants every second one: between them `timed` looks, once one is worth it.
        """
        found = []
        slow: Counter[str] = Counter()
        for law in self.laws:
            c = law.candidate
            if c.driver in LATE and not c.begins:
                if c.slower is not None:
                    slow[c.where] += 1
                    if slow[c.where] % 2 == 0:
                        continue
                size = min(MUCH * c.typical, c.upper)
                for since in {0.0, onset_s if onset_s > EARLY_S else 0.0}:
                    entry = Entry(law, Shape("step", since), np.empty(0), size, 0.0, 0.0)
                    found.append(entry.refreshed(self.contest))
        return found

    @cached_property
    def plain(self) -> Contest | None:
        """The contest of a twin that does not know what its structure leaves; None where it knows of nothing."""
        known = self.basis
        if known.plain is None:
            return None
        return Contest(known.probe, self.grid, self.state, self.run, known.plain, known.prior)

    @property
    def best_z(self) -> float:
        return self.entries[0].z if self.entries else 0.0

    @cached_property
    def null(self) -> Null:
        return null_scores(self.contest, self.laws).raised(self.basis.wider)

    @property
    def threshold(self) -> float:
        return self.null.quantile(FALSE_ALARMS)

    def reset(self) -> None:
        self.contest.look_at(self.run)


def fitted(part: Part, groups: list[tuple[Entry, ...]], rounds: int = ROUNDS) -> list[tuple[Fit, tuple[Entry, ...]]]:
    """Each group of effects fitted, from the commissioned values, side by side; the part's contest is left alone."""
    keys = [(rounds, *_named(group)) for group in groups]
    new = {key: group for key, group in zip(keys, groups, strict=True) if key not in part.fits}
    with ThreadPoolExecutor(SIDE_BY_SIDE) as pool:
        found = pool.map(lambda g: _fit(part, part.contest, g, rounds=rounds), new.values())
        part.fits.update(zip(new, found, strict=True))
    return [(part.fits[key], group) for key, group in zip(keys, groups, strict=True)]


def continued(part: Part, found: list[Fit], rounds: int = ROUNDS) -> list[Fit]:
    """Fits gone on with from where they ended; what would have led no further stays as it is."""
    open_ones = [f for f in found if not f.done]
    with ThreadPoolExecutor(SIDE_BY_SIDE) as pool:
        new = pool.map(lambda f: _fit(part, part.contest, f.entries, f.moved, rounds), open_ones)
        by = {id(old): other for old, other in zip(open_ones, new, strict=True)}
    return [by.get(id(f), f) for f in found]


def plainly(part: Part, found: Fit) -> Fit:
    """A fit anew, from where it ended, by a twin that does not know what its structure leaves."""
    if part.plain is None:
        return found
    key = ("plain", *_named(found.entries))
    if key not in part.fits:
        part.fits[key] = _fit(part, part.plain, found.entries, found.moved, AGAIN)
    return part.fits[key]


def _named(group: tuple[Entry, ...]) -> tuple[object, ...]:
    return tuple((e.candidate.id, e.candidate.slow_s, e.shape, e.size) for e in group)


def _fit(
    part: Part, contest: Contest, group: tuple[Entry, ...], moved: Array | None = None, rounds: int = ROUNDS
) -> Fit:
    own = copy.copy(contest)
    own.look_at(part.run)
    return fit(own, Model.of(own.probe, group), part.state, moved, rounds)


def timed(part: Part, best: Fit, known: tuple[Entry, ...]) -> list[tuple[Fit, tuple[Entry, ...]]]:
    """A fit with other time constants of what is slow in it and not `known` before, nearer and nearer to the best."""
    found: list[tuple[Fit, tuple[Entry, ...]]] = []
    before = {e.candidate.where for e in known if e.candidate.slower}
    new = [i for i, e in enumerate(best.entries) if e.candidate.slower and e.candidate.where not in before]
    for i, share in itertools.product(new, SLOWER):
        others = [o for f in (share, 1.0 / share) if (o := _slower(part, best.entries[i], f)) is not None]
        found += fitted(part, [(*best.entries[:i], other, *best.entries[i + 1 :]) for other in others])
        best = min((best, *(f for f, _ in found)), key=lambda f: f.total)
    return found


def ended(part: Part, best: Fit, known: tuple[Entry, ...]) -> list[tuple[Fit, tuple[Entry, ...]]]:
    """A fit with what grows in it, and is not `known`, having ended before, where it leaves more than noise.

    A ramp that stops within a record's last hours is like one that does not but for those hours.
    """
    if best.chi <= part.contest.expected:
        return []
    before, groups = {e.candidate.id for e in known}, []
    for i, entry in enumerate(best.entries):
        shape, span = entry.shape, part.grid.span_s
        # One that eases off may stand for one that stopped.
        eases = shape.name == "saturating"
        if entry.candidate.id in before or not shape.grows or (shape.free(span) and not eases):
            continue
        reached = entry.size * shape.mean(span - 1.0, span)
        for growth_s in (share * span - shape.onset_s for share in ENDS):
            if growth_s > EARLY_S:
                ramp = replace(shape, name="ramp", growth_s=growth_s)
                stopped = replace(entry, shape=ramp, size=reached).refreshed(part.contest)
                groups.append((*best.entries[:i], stopped, *best.entries[i + 1 :]))
    return fitted(part, groups)


def _slower(part: Part, entry: Entry, factor: float) -> Entry | None:
    """The same of as much capacity with another time constant; None for what has none, or where it does nothing."""
    c = entry.candidate
    laws = part.basis.book.laws(part.grid, part.run, (c.slower(factor * c.slow_s),)) if c.slower else []
    if not laws:
        return None
    shape = replace(entry.shape, growth_s=laws[0].candidate.slow_s) if c.begins else entry.shape
    return replace(entry, law=laws[0], shape=shape, size=entry.size / factor)


def varied(entries: list[Entry]) -> list[Entry]:
    """The best entries of a scan, one of each candidate and shape."""
    best: dict[tuple[str, str], Entry] = {}
    for entry in entries:
        best.setdefault((entry.candidate.id, entry.shape.name), entry)
    return list(best.values())[: 5 * FINALISTS]


def finalists(entries: list[Entry], chosen: tuple[Entry, ...]) -> list[Entry]:
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
    for grown in [e for e in found if e.shape.grows]:
        at_once = [e for e in entries if e.candidate.id == grown.candidate.id and e.shape.name == "step"]
        if at_once and at_once[0] not in found:
            found.append(at_once[0])
    return found
