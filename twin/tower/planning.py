"""Proposal of the next step test: the one that lowers the condition number of a day most, within a limit on the outlet.

A test is a staircase of fan speed and of water flow about the present operating point, as plants run it: seven steps of
75 minutes. The load stays, so the inlet follows the outlet.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.tower.cell import CellDeviations, Design, Inputs, solve_cell
from twin.tower.identify import Identifiability, cell_sensitivities, identifiability

STEPS, STEP_MIN = 7, 75.0
BLOCK_MIN = 15.0
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
    kappa: float = -1.3,
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
    """
    minutes = 1440.0 / max(len(day.t_in), 1)
    base = cell_sensitivities(design, day, sensors, at, kappa)
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
            rows = cell_sensitivities(design, test, sensors, at, kappa)
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
