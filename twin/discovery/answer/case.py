"""What a diagnosis is concluded from: a finding, and what it rests on."""

from __future__ import annotations

from dataclasses import dataclass

from twin.discovery.diagnosis import SensorError
from twin.discovery.effects.laws import Law
from twin.discovery.healthy.basis import Basis
from twin.discovery.places.localise import Course
from twin.discovery.planning.experiment import Limits
from twin.discovery.records.grid import Grid
from twin.discovery.records.readings import Stuck
from twin.discovery.scoring.contest import Contest
from twin.discovery.scoring.search import Entry
from twin.discovery.selection.ranking import Finding
from twin.discovery.thermometers.members import Members


@dataclass(frozen=True)
class Case:
    """A finding with everything that speaks for it or against it.

    Attributes:
        known: noise, prior and structure. whole: the contest over all of the record, `laws` its hypotheses, `lasting`
            what a scan of it found. split: row of `grid` from which no fit saw it. errors: per sensor, from there on.
        free: what an unknown at each site would have been, free from block to block, the likeliest first.
        usual: what is left of the re-tuned twin is what it has always left, so nothing is missing.
        doubted: an answer to less of the record was contradicted by the rest, so that this one has to leave nothing.
        single: thermometers that are one of several. still: those that stopped, and when.
        limits: of the rig, for the next experiment. later: records made since, by which the finding has been weighed.
        by_evidence: the finding is one of the search by evidence.
    """

    finding: Finding
    known: Basis
    whole: Contest
    laws: list[Law]
    lasting: list[Entry]
    grid: Grid
    split: int
    errors: dict[str, SensorError]
    free: tuple[Course, ...]
    usual: bool = False
    doubted: bool = False
    single: tuple[Members, ...] = ()
    still: tuple[Stuck, ...] = ()
    limits: Limits | None = None
    later: tuple[Grid, ...] = ()
    by_evidence: bool = False
