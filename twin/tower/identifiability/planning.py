"""Proposal of the next step test: the one that lowers the condition number of a day most, within a limit on the outlet.

A test is a staircase of fan speed and of water flow about the present operating point, as plants run it: seven steps of
75 minutes. The load stays, so the inlet follows the outlet.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from twin.tower.air import Array
from twin.tower.cell import KAPPA, CellDeviations, Design, Inputs, solve_cell
from twin.tower.identifiability.identify import (
    Identifiability,
    cell_sensitivities,
    identifiability,
    weighed_sensitivities,
)
from twin.tower.model import DEVIATIONS, NAMES, CellModel, Operation
from twin.tower.twin_file import BOUNDS

STEPS, STEP_MIN = 7, 75.0
BLOCK_MIN = 15.0
STEP = 1e-3
"""Step of a deviation for a central difference: errors of its square are below 1e-5 of the slope."""
FAN, FLOW = (0.0, 0.1, 0.2, 0.3, 0.4), (0.0, 0.1, 0.2, 0.3)
"""Ranges of fan speed, share of full, and of flow, share of design, that are tried."""
LEAST_SPEED = 0.3
MOST_WARMER_K = 2.5
"""By which the outlet may rise during a test where the user gives no limit: half of a usual approach."""
FAN_PATTERN = np.array([0.0, -0.5, 0.5, 0.0, -0.5, 0.5, 0.0])
FLOW_PATTERN = np.array([0.0, 0.0, 0.0, -1.0, -1.0, -1.0, 0.0])
"""Steps as shares of the range. The fan moves in both halves, the flow only downwards and in one: all four pairs are
visited."""


@dataclass(frozen=True)
class StepTest:
    """A step test: range of fan and flow, its steps (7,), what the day with it tells, and the outlet's rise and fall,
    K."""

    fan: float
    flow: float
    speeds: tuple[float, ...]
    flows: tuple[float, ...]
    told: Identifiability
    warmer: float
    colder: float


def plan_tests(
    design: Design,
    day: Inputs,
    at: CellDeviations,
    sensors: Sequence[str],
    most_warmer: float = MOST_WARMER_K,
    kappa: float = KAPPA,
    rows_of: Callable[[Inputs], Array] | None = None,
) -> tuple[Identifiability, list[StepTest]]:
    """Return what a day tells without a test, and the tests within the limit, best first.

    Parameters
    ----------
    day
        Operating points of a usual day, evenly spaced.
    at
        Present deviations.
    sensors
        As in `cell_sensitivities`.
    rows_of
        Scaled sensitivities of operating points, such as `model_sensitivities` makes; None: those of the bare cell.
    """
    if rows_of is None:
        rows_of = partial(_bare, design, sensors, at, kappa)
    minutes = 1440.0 / max(len(day.t_in), 1)
    base = rows_of(day)
    without = identifiability(base, minutes)
    middle = Inputs(*(np.array([float(np.median(getattr(day, name)))]) for name in day.__dataclass_fields__))
    usual = float(solve_cell(middle, design, at).t_out[0])
    found = []
    for fan in FAN:
        for flow in FLOW:
            if fan == 0.0 and flow == 0.0:
                continue
            test = _test(design, middle, at, fan, flow)
            out = solve_cell(test, design, at).t_out
            rows = rows_of(test)
            # Rows of the day count at their spacing, those of the test at theirs.
            both = np.concatenate([base * np.sqrt(minutes / BLOCK_MIN), rows])
            told = identifiability(both, BLOCK_MIN)
            warmer, colder = float(out.max() - usual), float(usual - out.min())
            if warmer <= most_warmer:
                stairs = slice(int(STEP_MIN / BLOCK_MIN) - 1, None, int(STEP_MIN / BLOCK_MIN))
                found.append(
                    StepTest(
                        fan,
                        flow,
                        tuple(test.speed[stairs].tolist()),
                        tuple(test.m_w[stairs].tolist()),
                        told,
                        warmer,
                        colder,
                    )
                )
    return without, sorted(found, key=lambda one: one.told.condition)


def _bare(design: Design, sensors: Sequence[str], at: CellDeviations, kappa: float, u: Inputs) -> Array:
    return cell_sensitivities(design, u, sensors, at, kappa)


def model_sensitivities(
    model: CellModel, usual: Operation, at: Array, constants: Array, sensors: Sequence[str]
) -> Callable[[Inputs], Array]:
    """Return the function that gives scaled sensitivities (n * sensors, 4) of operating points, as a calibration's
    windows have them.

    Parameters
    ----------
    model
        Cell with its effects.
    usual
        Operating points (m,) whose medians of wind, neighbours, bypass and drivers are taken.
    at
        Slow deviations (5,).
    constants
        Of the model.
    sensors
        Among outlet, fan, basin.
    """

    middle = [float(np.median(getattr(usual, name))) for name in ("bypass", "wind", "wind_deg", "neighbours")]
    drivers = np.median(usual.patterns, axis=0, keepdims=True) if usual.patterns.size else np.zeros((1, 0))

    def rows(u: Inputs) -> Array:
        n = len(u.t_in)
        bypass, wind, direction, neighbours = (np.full(n, one) for one in middle)
        operation = Operation(u, bypass, wind, direction, neighbours, np.repeat(drivers, n, axis=0))
        jac = np.empty((n, len(DEVIATIONS)))
        for j in range(len(DEVIATIONS)):
            step = np.zeros(len(at))
            step[j] = STEP
            high, low = (model.reading(operation, np.tile(at + sign * step, (n, 1)), constants) for sign in (1.0, -1.0))
            jac[:, j] = (high - low) / (2.0 * STEP)
        kappa = float(constants[NAMES.index("kappa")])
        found = weighed_sensitivities(jac, np.full(n, "fan" in sensors), kappa, "basin" in sensors)
        return np.concatenate(found) * np.array([BOUNDS[name] for name in DEVIATIONS])

    return rows


def _test(design: Design, middle: Inputs, at: CellDeviations, fan: float, flow: float) -> Inputs:
    """Return the operating points of a test about the middle of a day, the load held."""
    repeat = int(STEP_MIN / BLOCK_MIN)
    centre = (
        float(np.clip(middle.speed[0], LEAST_SPEED + 0.5 * fan, 1.0 - 0.5 * fan)) if fan else float(middle.speed[0])
    )
    speed = np.repeat(np.clip(centre + fan * FAN_PATTERN, LEAST_SPEED, 1.0) if fan else np.full(STEPS, centre), repeat)
    m_w = np.repeat(middle.m_w[0] + design.m_w0 * flow * FLOW_PATTERN, repeat)
    n = len(speed)
    fall = float(middle.t_in[0] - solve_cell(middle, design, at).t_out[0]) * middle.m_w[0]
    t_in = np.full(n, float(middle.t_in[0]))
    fixed = [np.full(n, float(getattr(middle, name)[0])) for name in ("dry", "wet", "pressure")]
    for _ in range(30):
        out = solve_cell(Inputs(t_in, m_w, speed, *fixed), design, at).t_out
        t_in = t_in + 0.8 * (fall / m_w - (t_in - out))
    return Inputs(t_in, m_w, speed, *fixed)
