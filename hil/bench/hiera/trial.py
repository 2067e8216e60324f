"""Benchmark `hil bench hiera`: calibrators on rigs that no network has seen: swarm, least squares, filter, network."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from hil.bench.hiera import cases
from hil.bench.hiera import tables as drawn
from hil.bench.hiera.cases import HieraCase
from hil.bench.hiera.contestants import CaseInputs, Contestant, commissioned, roster, sheet
from hil.bench.hiera.score import HieraScore, score
from hil.bench.measure import ReportTable
from hil.bench.peers import Absent
from hil.training import features_of
from twin.calibrators.hiera_unet import Family, Features

LOST = (0.10, 0.25)
"""Shares of the channels that are hidden from all contestants."""
CALIBRATING = 900_001
"""Offset of seeds for the cases that calibrate constant intervals."""


@dataclass(frozen=True, slots=True)
class HieraSize:
    """Size of the benchmark: seeds; simulated and virtual cases for each seed; rigs; trackers by name, all if empty.
    `lost_every`: number of cases for each one with lost channels. `calibrating`: simulated cases that set constant
    intervals; of virtual ones a third as many, as in the score.

    `lost_every`: of so many cases one is given with channels lost too. `calibrating`: simulated cases that set constant
    intervals; of virtual ones a third as many, as in what is scored.
    """

    seeds: tuple[int, ...] = (0, 1, 2)
    simulated: int = 30
    virtual: int = 10
    rigs: tuple[str, ...] = cases.RIGS
    trackers: tuple[str, ...] = ()
    strangers: tuple[str, ...] = cases.STRANGERS
    lost: tuple[float, ...] = LOST
    lost_every: int = 1
    calibrating: int = 6


FORWARDS = ("small", "full")
"""Configurations whose causal forward pass is timed."""
FULL = HieraSize(simulated=16, virtual=6, lost_every=7, calibrating=12)
QUICK = HieraSize(seeds=(0,), simulated=3, virtual=2, rigs=("simulated", "virtual"), lost=(0.25,))

Results = dict[str, list[HieraScore]]
"""Contestant -> its scores, one for each case."""


@dataclass(frozen=True)
class HieraResults:
    """Results on all cases, with channels lost, and on the cases that set constant intervals. `lost`: by share; 0 has
    the same cases whole.

    `lost`: by share; 0 has the same cases whole.
    """

    whole: Results
    lost: dict[float, Results]
    calibrating: Results
    threshold_K: float


def measure(
    size: HieraSize, seed: int, data: Path, say: Callable[[float, str], None], network: Path | None = None
) -> tuple[tuple[ReportTable, ...], tuple[str, ...]]:
    """Return the tables, and a line for everything left out.

    Parameters
    ----------
    seed
        Added to those of `size`.
    data
        Folder with the stranger rigs.
    say
        Called with each stage.
    network
        Card of a trained ensemble; without, the network takes no part.
    """
    features = features_of()
    family = Family(features.network, features.deviations)
    contestants, left_out = dict(roster(size.trackers)), []
    if network is not None:
        from hil.bench.hiera.network import contestants as with_network

        contestants |= with_network(network, features)
    else:
        left_out.append("network: name the card of a trained one with --network")
    everything = HieraResults({}, {share: {} for share in (0.0, *size.lost)}, {}, features.network.rules.calibrated_K)
    third = -(-size.calibrating // 3)
    total = len(size.seeds) * (size.simulated + size.virtual) + len(size.strangers) + size.calibrating + third
    done = 0
    setting = (
        cases.simulated(family, seed + CALIBRATING, size.calibrating),
        cases.virtual(features, seed + CALIBRATING, third),
    )
    for case in chain(*setting):
        say(done / total, "calibrating intervals")
        _judge(features, case, contestants, everything.calibrating, everything.threshold_K)
        done += 1
    try:
        for case in _cases(size, seed, features, family, data):
            say(min(done / total, 1.0), f"{case.rig}, seed {case.seed}: {case.name}")
            _judge(features, case, contestants, everything.whole, everything.threshold_K)
            if case.rig != "stranger" and done % size.lost_every == 0:
                for name, scores in everything.whole.items():
                    everything.lost[0.0].setdefault(name, []).append(scores[-1])
                for share in size.lost:
                    fewer = cases.hidden(case, share, done)
                    _judge(features, fewer, contestants, everything.lost[share], everything.threshold_K)
            done += 1
    except Absent as why:
        left_out.append(str(why))
    timed: tuple[ReportTable, ...] = ()
    if network is not None:
        from hil.bench.hiera.latency import latency

        timed = drawn.forwards(latency(config) for config in FORWARDS)
    return (*drawn.tables(everything, size.rigs), *timed), tuple(left_out)


def _cases(size: HieraSize, seed: int, features: Features, family: Family, data: Path) -> Iterator[HieraCase]:
    for own in size.seeds:
        if "simulated" in size.rigs:
            yield from cases.simulated(family, seed + own, size.simulated)
        if "virtual" in size.rigs:
            yield from cases.virtual(features, seed + own, size.virtual)
    if "stranger" in size.rigs:
        yield from cases.strangers(features, data, size.strangers)


def _judge(
    features: Features, case: HieraCase, contestants: dict[str, Contestant], into: Results, threshold_K: float
) -> None:
    given: CaseInputs = sheet(features, case)
    plain = commissioned(features, given)
    for name, contestant in contestants.items():
        into.setdefault(name, []).append(score(given, contestant(features, given), plain, threshold_K))
