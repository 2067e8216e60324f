"""A part of a record, ready to be searched, and which of its hypotheses are worth a fit."""

from __future__ import annotations

import copy
from collections import Counter
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from twin.discovery.diagnosis import Course
from twin.discovery.effects.catalogue import LATE
from twin.discovery.effects.laws import CandidateLaw, temperatures
from twin.discovery.effects.open_laws.laws import OpenLaw, law_on_record, open_laws
from twin.discovery.effects.probe import FreeRun, free_run
from twin.discovery.effects.shapes import EARLY_S, Shape
from twin.discovery.evidence.priors import SPREAD
from twin.discovery.evidence.scan import scan
from twin.discovery.healthy.basis import Basis
from twin.discovery.places.localise import courses
from twin.discovery.places.sites import sites_of
from twin.discovery.records.grid import Grid
from twin.discovery.refit.fitting import AGAIN, ROUNDS, Fit, fit, simulated
from twin.discovery.refit.model import Model
from twin.discovery.scoring.score_tests import ScoreTest
from twin.discovery.scoring.search import Entry
from twin.elements.candidates import Candidate
from twin.network import Array

SIDE_BY_SIDE = 4
"""Fits that run at once, where there are so many cores: kernels do without the interpreter's lock."""
NEGLIGIBLE = 1e-12
"""Squares of an effect, in those of noise, below which it does nothing."""
MUCH = 4.0
"""Typical sizes at which a fit of what is late begins."""


@dataclass
class Part:
    """A part of a record, ready to be searched."""

    basis: Basis
    grid: Grid
    state: Array
    run: FreeRun
    score_test: ScoreTest
    laws: list[CandidateLaw]
    fits: dict[tuple[object, ...], Fit] = field(default_factory=dict, repr=False)
    """What was fitted before, with and without what the twin knows of its structure: searches ask again."""

    @classmethod
    def of(cls, known: Basis, grid: Grid) -> Part:
        state, run, _, _ = free_run(known.probe, grid)
        book = known.book
        found = [law for only in (None, book.put_in, book.passing) for law in book.laws(grid, run, only)]
        return cls(known, grid, state, run, known.score_test(grid, state, run, found), found)

    def add(self, candidates: tuple[Candidate, ...]) -> None:
        """Take further candidates into the search."""
        if not candidates:
            return
        self.laws = [*self.laws, *self.basis.book.laws(self.grid, self.run, candidates)]

    def know(self, candidates: Iterable[Candidate]) -> None:
        """Keep the laws of further candidates at hand, without looking for them."""
        known = {law.candidate.id for law in self.laws}
        further = {c.id: c for c in candidates if c.id not in known}
        named = tuple(c for c in further.values() if not c.is_open)
        sites = {law.site.column: law for law in self.opened} | {law.site.name: law for law in self.opened}
        opened = [
            law_on_record(self.basis.probe.network, sites[at], c, self.grid, self._known)
            for c in further.values()
            if (at := c.column or str(c.adopts.get("site", ""))) in sites
        ]
        self.laws = [*self.laws, *self.basis.book.laws(self.grid, self.run, named), *opened]

    @cached_property
    def scanned(self) -> list[Entry]:
        """The likeliest onset of each named law in each of its shapes, by falling evidence."""
        return scan(self.score_test, self.laws)

    @cached_property
    def free(self) -> tuple[Course, ...]:
        """An unknown quantity at each site, free from block to block, the likeliest first."""
        return courses(self.score_test, sites_of(self.basis.probe.network, self.score_test, self.laws), SPREAD)

    @cached_property
    def opened(self) -> list[OpenLaw]:
        """Laws without a name: any input or temperature at every site."""
        return open_laws(self.basis.probe.network, self.grid, self.laws, self._known)

    @cached_property
    def _known(self) -> Array:
        """Node temperatures (n, k), degC, that laws are evaluated on."""
        return temperatures(self.basis.probe.network, self.grid, self.run)

    def late(self, onset_s: float) -> list[Entry]:
        """Every law that is late, at several times a typical size, all along and since an onset.

        Of time constants every second one.
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
                    found.append(entry.refreshed(self.score_test))
        return found

    @cached_property
    def plain(self) -> ScoreTest | None:
        """The score test of a twin that does not know what its structure leaves; None where it knows of nothing."""
        known = self.basis
        if known.plain is None:
            return None
        return ScoreTest(known.probe, self.grid, self.state, self.run, known.plain, known.prior)

    def reset(self) -> None:
        self.score_test.look_at(self.run)


def fitted(
    part: Part, groups: list[tuple[Entry, ...]], rounds: int = ROUNDS, moved: Array | None = None
) -> list[tuple[Fit, tuple[Entry, ...]]]:
    """Each group of effects fitted, side by side; the part's score test is left alone.

    Args:
        moved: (q + s * k,) of tunables and state from where the fits begin, by default the commissioned values. Where a
            fit of the same effects with other times ended the minimum is near, and a few rounds find it.
    """
    begun = b"" if moved is None else moved.tobytes()
    keys = [(rounds, begun, *_named(group)) for group in groups]
    new = {key: group for key, group in zip(keys, groups, strict=True) if key not in part.fits}
    with ThreadPoolExecutor(SIDE_BY_SIDE) as pool:
        found = pool.map(lambda g: _fit(part, part.score_test, g, moved, rounds), new.values())
        part.fits.update(zip(new, found, strict=True))
    return [(part.fits[key], group) for key, group in zip(keys, groups, strict=True)]


def gains(part: Part, entries: Sequence[Entry]) -> list[float]:
    """Return how far the squares fall with a share of each effect, as it is at its size, beside the tunables.

    Of what is not linear in its size this is the first step of a fit from there, at the cost of one simulation.
    """
    part.reset()
    score_test, at = copy.copy(part.score_test), part.basis.probe.network.values
    forms: dict[str, list[Entry]] = {}
    for entry in entries:
        forms.setdefault(entry.candidate.id, []).append(entry)

    def found(alike: list[Entry]) -> Array:
        count = len(alike)
        readings = simulated(
            Model.of(part.basis.probe, (alike[0],)),
            part.grid,
            np.tile(part.state, (count, 1)),
            np.tile(at, (count, 1)),
            np.array([[e.size] for e in alike]),
            tuple((e.shape,) for e in alike),
        )
        _, gram, score = score_test.beside_tunables((score_test.residual - score_test.residuals_of(readings)).T)
        return np.asarray(np.maximum(score, 0.0) ** 2 / np.maximum(np.diag(gram), NEGLIGIBLE))

    with ThreadPoolExecutor(SIDE_BY_SIDE) as pool:
        gained = dict(zip(forms, map(list, pool.map(found, forms.values())), strict=True))
    return [float(gained[entry.candidate.id].pop(0)) for entry in entries]


def continued(part: Part, found: list[Fit], rounds: int = ROUNDS) -> list[Fit]:
    """Fits gone on with from where they ended; what would have led no further stays as it is."""
    open_ones = [f for f in found if not f.done]
    with ThreadPoolExecutor(SIDE_BY_SIDE) as pool:
        new = pool.map(lambda f: _fit(part, part.score_test, f.entries, f.moved, rounds), open_ones)
        by = {id(old): other for old, other in zip(open_ones, new, strict=True)}
    return [by.get(id(f), f) for f in found]


def slower(part: Part, entry: Entry, factor: float) -> Entry | None:
    """Return an effect of as much capacity with another time constant; None for what has none, or where it does
    nothing."""
    c = entry.candidate
    laws = part.basis.book.laws(part.grid, part.run, (c.slower(factor * c.slow_s),)) if c.slower else []
    if not laws:
        return None
    shape = replace(entry.shape, growth_s=laws[0].candidate.slow_s) if c.begins else entry.shape
    return replace(entry, law=laws[0], shape=shape, size=entry.size / factor).refreshed(part.score_test)


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
    part: Part, score_test: ScoreTest, group: tuple[Entry, ...], moved: Array | None = None, rounds: int = ROUNDS
) -> Fit:
    own = copy.copy(score_test)
    own.look_at(part.run)
    return fit(own, Model.of(own.probe, group), part.state, moved, rounds)
