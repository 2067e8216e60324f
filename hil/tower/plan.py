"""Plan of the next step test of a cell from its record and twin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hil.record import RecordError
from hil.tower.station import iso, read_cell
from twin.tower import (
    IDS,
    CellDeviations,
    Identifiability,
    StepTest,
    blocks_of,
    cell_of,
    design_of,
    minutes_of,
    plan_tests,
    value_of,
)
from twin.twinfile import load

FEWEST_BLOCKS = 36


@dataclass(frozen=True)
class StepTestPlan:
    """Step tests for a cell, best first, and what the day they start from tells without one."""

    cell: int
    day: str
    without: Identifiability
    tests: Sequence[StepTest]


def plan(record: Path, twin: Path, warmer: float) -> StepTestPlan:
    """Return the step tests of a cell, from the last day of the record on which it ran steadily for six hours.

    Raises
    ------
    RecordError, TwinFileError
        A file cannot be used, or there is no such day.
    """
    network = load(twin)
    cell = cell_of(network)
    read = read_cell(record, cell)
    design = design_of(network)
    minutes = minutes_of(read.time_s, read.columns, read.origin, design.m_w0, value_of(network, "cell.bypass_share"))
    blocks, _ = blocks_of(minutes)
    days = np.floor(blocks.time_s / 86400.0).astype(np.int64)
    there = [day for day in np.unique(days) if (days == day).sum() >= FEWEST_BLOCKS]
    if not there:
        raise RecordError(f"{read.path}: has no day with six steady hours; give a record in which the cell runs")
    rows = np.flatnonzero(days == there[-1])
    at = CellDeviations(*(value_of(network, IDS[name]) for name in ("fill", "air", "uniformity", "bias")))
    sensors = ["outlet"]
    if np.isfinite(blocks.log_power[rows]).any() and design.power > 0.0:
        sensors.append("fan")
    if "basin_C" in read.columns and np.isfinite(read.columns["basin_C"]).any():
        sensors.append("basin")
    without, tests = plan_tests(design, blocks.operation.inputs.take(rows), at, sensors, warmer)
    return StepTestPlan(cell, iso(float(there[-1]) * 86400.0)[:10], without, tests)
