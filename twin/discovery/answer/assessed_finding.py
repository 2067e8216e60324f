"""Finding of a search with the evidence for and against it, from which the verdict is concluded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from twin.discovery.diagnosis import SensorError
from twin.discovery.effects.laws import CandidateLaw
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
    """Finding with the evidence for and against it.

    Attributes:
        known: noise, prior and structure. whole: the score test over all of the record.
        split: row of `grid` at which the held-out segment begins. errors: per sensor, over the held-out segment.
        free: posterior course of an unknown quantity at each site, free in each block, the likeliest first.
        laws: candidate effects on this record.
        usual: the re-tuned twin's error is the usual one, so no effect is missing.
        single: thermometers whose mean is one sensor. still: stuck thermometers, and when.
        limits: of the rig, for the next experiment. later: records made since, by which the hypotheses were ranked
            again.
    """

    finding: Finding
    known: Basis
    whole: ScoreTest
    grid: Grid
    split: int
    errors: dict[str, SensorError]
    free: tuple[Course, ...]
    laws: Sequence[CandidateLaw] = ()
    usual: bool = False
    single: tuple[Members, ...] = ()
    still: tuple[Stuck, ...] = ()
    limits: Limits | None = None
    later: tuple[Grid, ...] = ()
