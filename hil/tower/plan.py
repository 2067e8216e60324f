"""Plan of the next step test of a cell from its record and twin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hil.record import RecordError
from hil.tower.calibration import priors_of, site_of
from hil.tower.station import iso, read_cell, read_notes
from twin.tower import (
    DAY_S,
    IDS,
    MOST_CONDITION,
    Array,
    CellDeviations,
    CellModel,
    Identifiability,
    StepTest,
    blocks_of,
    cell_of,
    design_of,
    effects_of,
    minutes_of,
    model_sensitivities,
    plan_tests,
    site_pressure_of,
    value_of,
)
from twin.twinfile import load

FEWEST_BLOCKS = 36


@dataclass(frozen=True)
class StepTestPlan:
    """Step tests for a cell, best first, and what the day they start from tells without one.

    `until`: end of that day, UTC. `enough`: the best test makes the deviations identifiable.
    """

    cell: int
    until: str
    without: Identifiability
    tests: Sequence[StepTest]

    @property
    def enough(self) -> bool:
        """True if the best test brings the condition below its limit."""
        return bool(self.tests) and self.tests[0].told.condition <= MOST_CONDITION


def plan(record: Path, twin: Path, warmer: float) -> StepTestPlan:
    """Return the step tests of a cell, from the last 24 hours of the record in which it ran steadily for six.

    Raises
    ------
    RecordError, TwinFileError
        A file cannot be used, or there is no such day.
    """
    network = load(twin)
    cell = cell_of(network)
    read = read_cell(record, cell)
    design, share, effects = design_of(network), value_of(network, "cell.bypass_share"), effects_of(network)
    minutes = minutes_of(read.time_s, read.columns, read.origin, design.m_w0, share, effects, site_pressure_of(network))
    blocks, _ = blocks_of(minutes)
    end = _last_day(blocks.time_s)
    if end is None:
        raise RecordError(f"{read.path}: has no day with six steady hours; give a record in which the cell runs")
    rows = np.flatnonzero((blocks.time_s > end - DAY_S) & (blocks.time_s <= end))
    at = CellDeviations(*(value_of(network, IDS[name]) for name in ("fill", "air", "uniformity", "bias")))
    sensors = ["outlet"]
    if np.isfinite(blocks.log_power[rows]).any() and design.power > 0.0:
        sensors.append("fan")
    if "basin_C" in read.columns and np.isfinite(read.columns["basin_C"]).any():
        sensors.append("basin")
    notes = read_notes(record)
    model = CellModel(design, site_of(notes, share), effects)
    slow = np.array([at.fill - 1.0, at.air - 1.0, at.uniformity - 1.0, at.bias, 0.0], dtype=np.float64)
    constants, _ = priors_of(network, notes).constant()
    sensitivities = model_sensitivities(model, blocks.operation.take(rows), slow, constants, sensors)
    day = blocks.operation.inputs.take(rows)
    without, tests = plan_tests(design, day, at, sensors, warmer, rows_of=sensitivities)
    return StepTestPlan(cell, iso(end), without, tests)


def _last_day(block_s: Array) -> float | None:
    """Return the end of the last day, as the calibration's windows have it, with six steady hours; None without one."""
    for end in block_s[::-1]:
        if ((block_s > end - DAY_S) & (block_s <= end)).sum() >= FEWEST_BLOCKS:
            return float(end)
    return None
