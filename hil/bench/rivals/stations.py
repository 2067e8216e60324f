"""Stations of the trial, one cell and a short record each, and their split into training, validation and test."""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.virtual.tower import DAYS_A_MONTH
from hil.training.tower import StationPlan, station_cells, table_of
from twin.calibrators.hiera_unet.model.config import HieraError
from twin.calibrators.hiera_unet.tower import CellTable

FIRST = {"train": 1, "validation": 8001, "test": 9001}
"""First seed of each split: no station is in two."""
MONTHS = 14.0
HEALTHY_D, PART_D = 23, 18
"""Days of the healthy record, and of the one later part that is simulated: its first 8 find the belief, then windows
begin."""
Say = Callable[[float, str], None]


@dataclass(frozen=True)
class ShortStation(StationPlan):
    """Station of the family of which the healthy record and one part, at a random time of its life, are simulated."""

    def segments(self) -> tuple[tuple[int, int], ...]:
        """Return the days [first, end) that are simulated."""
        days = round(self.months * DAYS_A_MONTH)
        begin = int(np.random.default_rng([self.seed, 11]).integers(HEALTHY_D, days - PART_D + 1))
        return (0, HEALTHY_D), (begin, begin + PART_D)


def stations_of(split: str, count: int) -> list[ShortStation]:
    """Return the stations of a split."""
    return [ShortStation("F", FIRST[split] + k, MONTHS, 1, True) for k in range(count)]


def in_turn(counts: dict[str, int]) -> Iterator[ShortStation]:
    """Return the stations of all splits so that each prefix has some of each, in proportion."""
    shares = [((k + 0.5) / n, one) for s, n in counts.items() for k, one in enumerate(stations_of(s, n))]
    return (one for _, one in sorted(shares, key=lambda pair: (pair[0], pair[1].seed)))


def simulate_missing(counts: dict[str, int], folder: Path, say: Say) -> float:
    """Simulate the stations that a folder lacks; return the processor seconds that this took.

    Raises
    ------
    HieraError
        A split would reach into the seeds of the next, or a station cannot be commissioned.
    """
    for split, following in itertools.pairwise(FIRST):
        if FIRST[split] + counts[split] > FIRST[following]:
            raise HieraError(f"{counts[split]} stations of the {split} split reach into the next; give fewer")
    folder.mkdir(parents=True, exist_ok=True)
    wanted = list(in_turn(counts))
    began = time.process_time()
    for k, one in enumerate(wanted):
        path = table_path(folder, one)
        if path.exists():
            continue
        say(k / len(wanted), f"simulating station {one.name}")
        try:
            (cell,) = station_cells(one)
        except ValueError as error:
            raise HieraError(f"station {one.name} cannot be commissioned ({error}); give another seed") from error
        table_of(cell, one.segments()).save(path)
    return time.process_time() - began


def table_path(folder: Path, station: ShortStation) -> Path:
    """Return the file of a station's windows."""
    return folder / f"{station.name}_1.npz"


def tables(folder: Path, split: str, count: int) -> list[CellTable]:
    """Return the tables of a split's stations that have a window.

    Raises
    ------
    HieraError
        A table is missing or of another format, or none has a window.
    """
    found = [CellTable.load(table_path(folder, one)) for one in stations_of(split, count)]
    kept = [one for one in found if one.valid.any()]
    if not kept:
        raise HieraError(f"{os.fspath(folder)}: no station of the {split} split has a window; simulate more")
    return kept
