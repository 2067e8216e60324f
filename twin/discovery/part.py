"""A part of a record, ready to be searched, and which of its hypotheses are worth a fit."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from twin.discovery.basis import Basis
from twin.discovery.contest import Contest
from twin.discovery.equivalence import width
from twin.discovery.fitting import Fit, fit
from twin.discovery.grid import Grid
from twin.discovery.laws import Law
from twin.discovery.model import Model
from twin.discovery.null import FALSE_ALARMS, Null, null_scores
from twin.discovery.probe import Run, free_run
from twin.discovery.search import Entry, refine, scan
from twin.elements.base import Candidate
from twin.network import Array

FINALISTS = 8
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

    @classmethod
    def of(cls, known: Basis, grid: Grid) -> Part:
        state, run, _, _ = free_run(known.probe, grid)
        found = known.book.laws(grid, run)
        contest = Contest(known.probe, grid, state, run, known.noise, known.prior, known.structure, found)
        entries = [refine(contest, e) for e in varied(scan(contest, found))]
        entries.sort(key=lambda e: -e.gain)
        return cls(known, grid, state, run, contest, found, entries)

    def sharpened(self) -> tuple[Candidate, ...]:
        """Of what comes in many forms, those that score better at each place than the catalogue's own."""
        best: dict[str, Entry] = {}
        for entry in self.entries:
            if entry.candidate.near is not None:
                best.setdefault(entry.candidate.where, entry)
        found = []
        for first in best.values():
            closest, top = first.candidate, first.gain
            while closest.near is not None:
                laws = self.basis.book.laws(self.grid, self.run, closest.near())
                better = scan(self.contest, laws)
                if not better or better[0].gain < top:
                    break
                closest, top = better[0].candidate, better[0].gain
            if top > first.gain + WORTH:
                found.append(closest)
        return tuple(found)

    def add(self, candidates: tuple[Candidate, ...]) -> None:
        """Take further candidates into the search."""
        if not candidates:
            return
        laws = self.basis.book.laws(self.grid, self.run, candidates)
        self.laws = [*self.laws, *laws]
        entries = [refine(self.contest, e) for e in varied(scan(self.contest, laws))]
        self.entries = sorted([*self.entries, *entries], key=lambda e: -e.gain)

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


def fitted(part: Part, groups: list[tuple[Entry, ...]]) -> list[tuple[Fit, tuple[Entry, ...]]]:
    """Each group of effects fitted, from the commissioned values."""
    trials = []
    for group in groups:
        part.reset()
        trials.append((fit(part.contest, Model.of(part.contest.probe, group), part.state), group))
    return trials


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
    for grown in [e for e in found if e.shape.name != "step"]:
        at_once = [e for e in entries if e.candidate.id == grown.candidate.id and e.shape.name == "step"]
        if at_once and at_once[0] not in found:
            found.append(at_once[0])
    return found
