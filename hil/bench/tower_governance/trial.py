"""The trial: stations simulated and calibrated one by one; finished ones are kept, so that it can be continued."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from drivers.virtual.tower import Simulated, simulate, write_station
from hil.bench.measure import ReportTable
from hil.bench.tower_governance.cases import (
    CLEAN_END,
    CLEAN_FIRST,
    CLEANED_CELL,
    CLEANING,
    HEALTHY_DAYS,
    RAMP_CELL,
    StationCase,
    TrialSize,
)
from hil.bench.tower_governance.known import (
    LEVEL,
    CellTrial,
    KnownState,
    Proposal,
    StationFolder,
    WindowError,
    calibrated_at,
    falls_below,
    says_loss,
    third_excited,
)
from hil.bench.tower_governance.tables import tables_of
from hil.bench.tower_stations import align_folder
from hil.files import replacing
from hil.tower import commission_cell, learn_healthy, path_beside, read_truth, write_healthy
from twin import save
from twin.tower import DAY_S

Say = Callable[[float, str], None]
PAGE_ALONE = ("hil/bench/tower_governance/figures.py", "hil/bench/tower_governance/tables.py")
"""Measured code that no kept station depends on."""


def measure(
    size: TrialSize, seed: int, work: Path, weather: Path | None, code: Mapping[str, str], say: Say
) -> tuple[ReportTable, ...]:
    """Return the tables of a trial.

    Parameters
    ----------
    work
        Folder that keeps finished stations.
    weather
        Folder of .epw and .tm2 files; a seeded generator stands in for missing ones.
    code
        Digests of the measured code by place: stations of other code are measured again.
    say
        Called with each stage.

    Raises
    ------
    OSError
        The folder cannot be written.
    RecordError, TwinFileError
        A station cannot be aligned, commissioned or calibrated.
    """
    cells: list[CellTrial] = []
    cost: list[tuple[StationCase, float, int]] = []
    cases = size.cases(seed)
    of_stations = {place: digest for place, digest in sorted(code.items()) if place not in PAGE_ALONE}
    for k, case in enumerate(cases):
        path = work / f"{case.name}_{case.seed}.json"
        identity = json.dumps([asdict(case), weather is not None, of_stations])
        found = read_trial(path, identity)
        if found is None:
            began = time.process_time()
            say(k / len(cases), f"station {case.name}: simulating")
            trial = try_station(case, work / case.name, weather, partial(say, k / len(cases)))
            found = trial, time.process_time() - began
            write_trial(path, identity, *found)
        cells += found[0]
        cost.append((case, found[1], len(found[0][0].known)))
    return tuple(tables_of(cells, cost))


def try_station(case: StationCase, place: Path, weather: Path | None, note: Callable[[str], None]) -> list[CellTrial]:
    """Return what was known of the cells of one station; its files lie in `place` until then."""
    made = simulate(case.design, len(case.cells), case.plan(weather))
    start_s = made.plan.start.timestamp()
    station = _folder(made, place, start_s)
    del made
    known = _Known(case, station, start_s, note)
    for before, day in zip((HEALTHY_DAYS, *case.nights[:-1]), case.nights, strict=True):
        known.calibrate(start_s + DAY_S * day, start_s + DAY_S * before)
    third_s = None
    if case.ramps:
        known.refine()
        third_s = known.after_cleaning()
    shutil.rmtree(place)
    return [
        CellTrial(
            case.name,
            case.design.station,
            cell,
            case.kind(cell),
            start_s,
            falls_below(station.truth[cell], "fill", LEVEL),
            third_s if case.kind(cell) == CLEANING else None,
            tuple(known.of(cell)),
        )
        for cell in case.cells
    ]


def _folder(made: Simulated, place: Path, start_s: float) -> StationFolder:
    """Write, align and commission a station; its twins learn the healthy days."""
    write_station(made, place, score=True)
    align_folder(place)
    twins = []
    for cell in range(1, made.recorded + 1):
        network, _, _ = commission_cell(cell, place / "datasheet.json", place / "commissioning.csv")
        twin = place / f"cell{cell}.toml"
        save(network, twin)
        healthy = learn_healthy(place / "record", network, (start_s, start_s + HEALTHY_DAYS * DAY_S))
        write_healthy(healthy, path_beside(twin, network))
        twins.append(twin)
    return StationFolder(place / "record", tuple(twins), place / "labels.csv", read_truth(place / "truth.parquet"))


class _Known:
    """Calibrations of a station by time."""

    def __init__(self, case: StationCase, station: StationFolder, start_s: float, note: Callable[[str], None]) -> None:
        self.case, self.station, self.start_s, self.note = case, station, start_s, note
        self.by_time: dict[float, dict[int, KnownState]] = {}

    def of(self, cell: int) -> list[KnownState]:
        """Return what was known of a cell, in the order of time."""
        return [self.by_time[time_s][cell] for time_s in sorted(self.by_time)]

    def calibrate(self, time_s: float, since_s: float) -> None:
        """Calibrate on the record up to a time, if that was not done."""
        if time_s not in self.by_time:
            self.note(f"station {self.case.name}: calibrating on day {(time_s - self.start_s) / DAY_S:.2f}")
            self.by_time[time_s] = calibrated_at(self.station, time_s, since_s)

    def refine(self) -> None:
        """Calibrate at each midnight between the first calibration that reports the loss and the one before it."""
        states = self.of(RAMP_CELL)
        first = next((k for k, one in enumerate(states) if says_loss(one)), 0)
        low, high = (states[max(k, 0)].time_s for k in (first - 1, first))
        for day in range(round((high - low) / DAY_S) - 1):
            at = low + DAY_S * (day + 1)
            self.calibrate(at, at)

    def after_cleaning(self) -> float | None:
        """Calibrate before the cleaning and at the end of the third excited window after it; return that time."""
        before = self.start_s + DAY_S * CLEAN_FIRST
        self.calibrate(before, before)
        third_s = third_excited(self.of(CLEANED_CELL), self.start_s + DAY_S * CLEAN_END)
        if third_s is not None:
            self.calibrate(third_s, third_s)
        return third_s


def write_trial(path: Path, identity: str, cells: list[CellTrial], cpu_s: float) -> None:
    """Keep the cells of a finished station, whole or not at all; raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as unfinished:
        content = {"identity": identity, "cpu_s": cpu_s, "cells": [asdict(one) for one in cells]}
        unfinished.write_text(json.dumps(content))


def read_trial(path: Path, identity: str) -> tuple[list[CellTrial], float] | None:
    """Return the cells of a finished station and its processor time; None where it is missing or another one."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["identity"] != identity:
            return None
        return [_cell(one) for one in content["cells"]], float(content["cpu_s"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _cell(content: dict[str, Any]) -> CellTrial:
    return CellTrial(**{**content, "known": tuple(_state(one) for one in content["known"])})


def _state(content: dict[str, Any]) -> KnownState:
    proposals = {key: {name: Proposal(**one) for name, one in content[key].items()} for key in ("present", "accepted")}
    return KnownState(
        content["time_s"],
        content["true"],
        **proposals,
        windows=tuple(
            WindowError(**{**one, "codes": tuple(one["codes"]), "of": tuple(one["of"])}) for one in content["windows"]
        ),
        excited_s=tuple((start, end) for start, end in content["excited_s"]),
        alarms=tuple((time_s, tuple(names)) for time_s, names in content["alarms"]),
    )
