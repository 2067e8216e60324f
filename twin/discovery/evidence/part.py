"""Part of a record prepared for the search, and the fits of its hypotheses."""

from __future__ import annotations

import copy
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from twin.discovery.diagnosis import Course
from twin.discovery.effects.catalogue import LATE
from twin.discovery.effects.laws import CandidateLaw, temperatures
from twin.discovery.effects.open_laws.laws import OpenLaw, laws_of, open_laws
from twin.discovery.effects.probe import FreeRun, free_run
from twin.discovery.effects.shapes import EARLY_S, Shape
from twin.discovery.evidence.priors import SPREAD
from twin.discovery.evidence.scan import scan, step_prior
from twin.discovery.healthy.basis import Basis
from twin.discovery.places.localise import courses
from twin.discovery.places.sites import sites_of
from twin.discovery.records.grid import Grid
from twin.discovery.refit.fitting import AGAIN, ROUNDS, Fit, fit, simulated
from twin.discovery.refit.model import Model
from twin.discovery.refit.variables import MOST_LOST
from twin.discovery.scoring.score_tests import ScoreTest
from twin.discovery.scoring.search import Entry
from twin.elements.candidates import Candidate
from twin.network import Array

SIDE_BY_SIDE = 4
"""Fits that run in parallel, given as many cores: kernels release the interpreter's lock."""
NEGLIGIBLE = 1e-12
"""Squares of an effect, relative to noise, below which it has no influence."""
STOOD = (0.03, 0.1, 0.3)
"""Shares of a record for which a thermometer that sticks may have stood still. A judgement: minutes to hours."""
LIMITED = (0.1, 0.3, 0.5, 0.7, 0.9)
"""Levels at which an actuator may be limited, as shares of the range of its command. Others are tried about the best.
"""
RUNS = 0.1
"""Share of its largest command from which an actuator counts as running. A judgement: less is standby, or a meter's
offset."""
MUCH, APART, SIZES = 4.0, 4.0, 3
"""Sizes at which the fit of a lag or delay may begin, in typical ones: the least, their ratio, and how many. For the
lag of an actuator they are 4 min, 16 min and an hour, its upper bound."""
LARGE_LOSSES = (0.5, MOST_LOST)
"""Shares of a flow with whose loss a fit may begin: without half of it a volume is twice as slow, without nine tenths
ten times."""
DEAD_APART_S = 150.0
"""Distance of the dead times at which a fit may begin, s, or the length of a block if that is longer. A response that
is delayed by one load step does not resemble one that is delayed by half of it. A judgement: it bounds their number."""


@dataclass
class Part:
    """Part of a record prepared for the search."""

    basis: Basis
    grid: Grid
    state: Array
    run: FreeRun
    score_test: ScoreTest
    laws: list[CandidateLaw]
    fits: dict[tuple[object, ...], Fit] = field(default_factory=dict, repr=False)
    """Cached fits, with and without the twin's known structure."""

    @classmethod
    def of(cls, known: Basis, grid: Grid) -> Part:
        state, run, _, _ = free_run(known.probe, grid)
        book = known.book
        levelled = tuple(at for c in book.candidates for at in _at_levels(c, known, grid, run))
        every = [law for law in book.laws(grid, run) if law.candidate.at_level is None]
        every += [law for only in (book.put_in, book.events, levelled) for law in book.laws(grid, run, only)]
        assumed = known.assumed(grid)
        found = [law for law in every if law.candidate.where not in assumed]
        laws = [*found, *_missing(known, grid, run, found)]
        return cls(known, grid, state, run, known.score_test(grid, state, run, laws), found)

    def add(self, candidates: tuple[Candidate, ...]) -> None:
        """Add further candidates to the search."""
        if not candidates:
            return
        self.laws = [*self.laws, *self.basis.book.laws(self.grid, self.run, candidates)]

    def know(self, candidates: Iterable[Candidate]) -> None:
        """Make the laws of further candidates available without searching for them."""
        known = {law.candidate.id for law in self.laws}
        further = {c.id: c for c in candidates if c.id not in known}
        named = tuple(c for c in further.values() if not c.is_open)
        others = laws_of(self.basis.probe.network, further.values(), self.open_candidates, self.grid, self._known)
        self.laws = [*self.laws, *self.basis.book.laws(self.grid, self.run, named), *others]

    @cached_property
    def scanned(self) -> list[Entry]:
        """Return the likeliest onset of each named law in each of its shapes, by falling evidence."""
        return scan(self.score_test, self.laws)

    @cached_property
    def free(self) -> tuple[Course, ...]:
        """Return the posterior courses of an unknown quantity at each site, free in each block, the likeliest first."""
        return courses(self.score_test, sites_of(self.basis.probe.network, self.score_test, self.laws), SPREAD)

    @cached_property
    def open_candidates(self) -> list[OpenLaw]:
        """Return the open laws: any input or temperature as driver, at every site."""
        return open_laws(self.basis.probe.network, self.grid, self.laws, self._known)

    @cached_property
    def _known(self) -> Array:
        """Return the node temperatures (n, k), degC, at which laws are evaluated."""
        return temperatures(self.basis.probe.network, self.grid, self.run)

    @cached_property
    def secants(self) -> list[tuple[CandidateLaw, Entry]]:
        """Return the lags and delays, each with the onset and the size of highest evidence.

        A lag is not linear in its size. Its response at each of several sizes, a factor of `APART` apart, is scanned as
        a law of its own, with that size as its typical one. A dead time has more of them. A mass has one such size, and
        several time constants, of which every second one is included.
        """
        made: list[tuple[CandidateLaw, CandidateLaw]] = []
        slow: Counter[str] = Counter()
        book, known = self.basis.book, {law.candidate.id for law in self.laws}
        late = [law for law in self.laws if law.candidate.driver in LATE and not law.candidate.begins]
        others = tuple(o for law in late if law.candidate.near is not None for o in law.candidate.near())
        late += book.laws(self.grid, self.run, tuple(o for o in others if o.id not in known))
        for law in late:
            c = law.candidate
            if c.slower is not None:
                slow[c.where] += 1
                if slow[c.where] % 2 == 0:
                    continue
            sizes = 1 if c.kind == "thermal_mass" else SIZES
            tried = {min(MUCH * c.typical * APART**k, c.upper) for k in range(sizes)}
            if any(name.endswith(".dead_time_s") for name in c.changes):
                apart_s = max(self.score_test.step_s, DEAD_APART_S)
                tried |= set(np.arange(apart_s, c.upper, apart_s).tolist())
            forms = tuple(replace(c, typical=size, shapes=("step",)) for size in sorted(tried))
            made += [(law, form) for form in book.laws(self.grid, self.run, forms)]
        law_of = {id(form): law for law, form in made}
        best: dict[str, tuple[CandidateLaw, Entry]] = {}
        for entry in scan(self.score_test, [form for _, form in made], transient=False):
            law = law_of[id(entry.law)]
            best.setdefault(law.candidate.id, (law, entry))
        return [*best.values()]

    @cached_property
    def large_losses(self) -> list[tuple[CandidateLaw, Entry]]:
        """Return losses of most of a flow, which act otherwise than those of a little, with their likeliest onset."""
        best: dict[str, Entry] = {}
        for entry in self.scanned:
            if entry.candidate.total_loss and entry.shape.name == "step":
                best.setdefault(entry.candidate.id, entry)
        every = [replace(e, size=share * e.candidate.total_loss) for e in best.values() for share in LARGE_LOSSES]
        return [(e.law, e) for e in every if e.candidate.lower <= e.size <= e.candidate.upper]

    def nonlinear_starts(self, onset_s: float) -> list[Entry]:
        """Return the lags and delays at the size of highest evidence: from the beginning, from an onset, and from the
        onset of their own evidence.

        What leads the search so far may be of another kind, and its onset is none of theirs.
        """
        found = []
        for law, entry in (*self.secants, *self.large_losses):
            own = entry.shape.onset_s
            apart = abs(own - onset_s) > self.score_test.step_s
            for since in {0.0, *(s for s in (onset_s, own if apart else onset_s) if s > EARLY_S)}:
                if since == 0.0 and math.isinf(law.candidate.lumped):
                    continue  # indistinguishable from the lag that a twin of mixed volumes lacks
                size = entry.size if law.candidate.total_loss else entry.candidate.typical
                # The onset has a prior as that of any step; its evidence is known where the scan found it.
                prior = step_prior(self.score_test, law.candidate, since)
                occam = entry.log_occam if since == own else prior
                begun = Entry(law, Shape("step", since), np.empty(0), size, 0.0, 0.0, log_occam=occam)
                found.append(begun.refreshed(self.score_test))
        return found

    @cached_property
    def plain(self) -> ScoreTest | None:
        """Return the score test of a twin without known structure; None if no structure is known."""
        known = self.basis
        if known.plain is None:
            return None
        return ScoreTest(known.probe, self.grid, self.state, self.run, known.plain, known.prior)

    def reset(self) -> None:
        self.score_test.look_at(self.run)


def _at_levels(candidate: Candidate, known: Basis, grid: Grid, run: FreeRun) -> list[Candidate]:
    """Return a law with a level of its own at the levels that this record suggests; none for other laws."""
    if candidate.at_level is None:
        return []
    if candidate.is_limit:
        low, high = _range_of_limited(known, grid, candidate)
        return [candidate.at_level(low + share * (high - low)) for share in LIMITED] if high > low else []
    stuck = _stuck_at(candidate, known, grid, run)
    return [] if stuck is None else [stuck]


def _range_of_limited(known: Basis, grid: Grid, candidate: Candidate) -> tuple[float, float]:
    """Return the least and the largest command of a limited actuator while it runs; at rest it shows no limit."""
    column = next(str(table["column"]) for table in candidate.adds.values())
    values = grid.inputs[:, known.probe.network.input_columns.index(column)]
    high = float(values.max())
    return float(values[values >= RUNS * high].min(initial=high)), high


def _stuck_at(candidate: Candidate, known: Basis, grid: Grid, run: FreeRun) -> Candidate | None:
    """Return a stuck thermometer with the level at which its reading stood still while the twin's moved; None without.

    Of the spans of lengths `STOOD`, it takes the one in which a constant reduces the twin's squared error most. The
    level is its median reading. The twin's mean error in a span does not count, as another effect may cause it.
    """
    if candidate.at_level is None:
        return None
    name = next(str(table["sensor"]) for table in candidate.adds.values())
    j = known.probe.network.sensor_names.index(name)
    good = np.isfinite(grid.measured[:, j])
    if not good.any():
        return None
    middle = float(grid.measured[good, j].mean())
    read = np.where(good, grid.measured[:, j] - middle, 0.0)
    off = np.where(good, grid.measured[:, j] - run.readings[:, j], 0.0)
    sums = np.zeros((len(read) + 1, 5))
    np.cumsum(np.stack([good, read, read**2, off, off**2], axis=1), axis=0, out=sums[1:])
    best, level_c = 0.0, None
    for share in STOOD:
        n = min(max(round(share * len(read)), 2), len(read))
        count, total, squares, of_twin, squares_of_twin = (sums[n:] - sums[:-n]).T
        gained = squares_of_twin - squares + (total**2 - of_twin**2) / np.maximum(count, 1.0)
        k = int(np.argmax(gained))
        if gained[k] > best:
            best, level_c = float(gained[k]), float(np.nanmedian(grid.measured[k : k + n, j]))
    return None if level_c is None else candidate.at_level(level_c)


def _missing(known: Basis, grid: Grid, run: FreeRun, laws: Sequence[CandidateLaw]) -> list[CandidateLaw]:
    """Return the laws of what the twin lacked already in health that are not among the candidates' own `laws`."""
    if known.missing is None:
        return []
    network, ids = known.probe.network, {law.candidate.id for law in laws}
    named = tuple(c for c in known.missing.candidates if c.id not in ids and not c.is_open)
    found = known.book.laws(grid, run, named)
    of_others = [c for c in known.missing.candidates if c.is_open]
    if not of_others:
        return found
    here = temperatures(network, grid, run)
    return [*found, *laws_of(network, of_others, open_laws(network, grid, laws, here), grid, here)]


def fitted(
    part: Part, groups: list[tuple[Entry, ...]], rounds: int = ROUNDS, moved: Array | None = None
) -> list[tuple[Fit, tuple[Entry, ...]]]:
    """Fit each group of effects, in parallel; the part's score test is unchanged.

    Args:
        moved: (q + s * k,) of tunables and state from which the fits begin, by default the commissioned values. The end
            of a fit of the same effects with other times is near the minimum, and a few rounds suffice from there.
    """
    begun = b"" if moved is None else moved.tobytes()
    keys = [(rounds, begun, *_named(group)) for group in groups]
    new = {key: group for key, group in zip(keys, groups, strict=True) if key not in part.fits}
    with ThreadPoolExecutor(SIDE_BY_SIDE) as pool:
        found = pool.map(lambda g: _fit(part, part.score_test, g, moved, rounds), new.values())
        part.fits.update(zip(new, found, strict=True))
    return [(part.fits[key], group) for key, group in zip(keys, groups, strict=True)]


def gains(part: Part, entries: Sequence[Entry]) -> list[float]:
    """Return the fall of the squares by a share of each effect at its size, with the tunables free.

    For an effect that is nonlinear in its size this is the first step of a fit, at the cost of one simulation.
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
    """Continue fits from their end points; fits that had converged are unchanged."""
    open_ones = [f for f in found if not f.done]
    with ThreadPoolExecutor(SIDE_BY_SIDE) as pool:
        new = pool.map(lambda f: _fit(part, part.score_test, f.entries, f.moved, rounds), open_ones)
        by = {id(old): other for old, other in zip(open_ones, new, strict=True)}
    return [by.get(id(f), f) for f in found]


def slower(part: Part, entry: Entry, factor: float) -> Entry | None:
    """Return an effect of the same capacity with another time constant; None if it has no time constant, no possible
    size with the other one, or no influence.
    """
    c = entry.candidate
    other = None if c.slower is None else c.slower(factor * c.slow_s)
    if other is None or other.lower >= other.upper:
        return None
    laws = part.basis.book.laws(part.grid, part.run, (other,))
    if not laws:
        return None
    shape = replace(entry.shape, growth_s=laws[0].candidate.slow_s) if c.begins else entry.shape
    return replace(entry, law=laws[0], shape=shape, size=entry.size / factor).refreshed(part.score_test)


def within_commands(part: Part, candidates: Iterable[Candidate]) -> tuple[Candidate, ...]:
    """Return candidates without limits that no command crosses: below all of them one is a gain, above them nothing."""

    def crossed(c: Candidate) -> bool:
        low, high = _range_of_limited(part.basis, part.grid, c)
        return c.level is not None and low < c.level < high

    return tuple(c for c in candidates if not c.is_limit or crossed(c))


def at_another_level(part: Part, entry: Entry, factor: float) -> Entry | None:
    """Return a limit at another level, with the same power missing at the highest command; None without influence."""
    c = entry.candidate
    assert c.at_level is not None and c.level is not None
    made = c.at_level(factor * c.level)
    _, high = _range_of_limited(part.basis, part.grid, c)
    laws = part.basis.book.laws(part.grid, part.run, within_commands(part, (made,)))
    if not laws or made.level is None:
        return None
    size = entry.size * (high - c.level) / (high - made.level)
    return replace(entry, law=laws[0], size=min(size, c.upper)).refreshed(part.score_test)


def plainly(part: Part, found: Fit) -> Fit:
    """Repeat a fit from its end point for a twin without known structure."""
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
