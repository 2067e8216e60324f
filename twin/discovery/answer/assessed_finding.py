"""Data that a diagnosis is concluded from: a finding and its evidence."""

from __future__ import annotations

from dataclasses import dataclass

from twin.discovery.diagnosis import SensorError
from twin.discovery.evidence.finding import Finding
from twin.discovery.healthy.basis import Basis
from twin.discovery.places.localise import Course
from twin.discovery.planning.experiment import Limits
from twin.discovery.records.grid import Grid
from twin.discovery.records.stuck_readings import Stuck
from twin.discovery.scoring.score_tests import ScoreTest
from twin.discovery.thermometers.members import Members


@dataclass(frozen=True)
class AssessedFinding:
    """A finding with everything that speaks for it or against it.

    Attributes:
        known: noise, prior and structure. whole: the score test over all of the record.
        split: row of `grid` from which no fit saw it. errors: per sensor, from there on.
        free: what an unknown at each site would have been, free from block to block, the likeliest first.
        usual: what is left of the re-tuned twin is what it has always left, so nothing is missing. beyond: inputs go
            far beyond the healthy record's range, and the twin leaves no more than it may leave there in health.
        single: thermometers that are one of several. still: those that stopped, and when.
        limits: of the rig, for the next experiment. later: records made since, by which the finding has been weighed.
    """

    finding: Finding
    known: Basis
    whole: ScoreTest
    grid: Grid
    split: int
    errors: dict[str, SensorError]
    free: tuple[Course, ...]
    usual: bool = False
    beyond: bool = False
    single: tuple[Members, ...] = ()
    still: tuple[Stuck, ...] = ()
    limits: Limits | None = None
    later: tuple[Grid, ...] = ()
