"""A tenth more fan never warms the outlet, and a tenth less never cools it, whatever the calibration has learned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.tower.cell import Design, Inputs
from twin.tower.model import GLOBALS, CellModel, DesignPoint, Operation
from twin.tower.twin_file import BOUNDS

MODEL = CellModel(Design(250.0, 205.0, 1.47, 0.6, 45.0, 1.15), DesignPoint())
POINTS = 50
LEAST_FALL_K = 1.0
"""Water that hardly cools has no sign to get wrong."""


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), wide=st.floats(0.0, 2.0))
def test_a_tenth_more_or_less_fan_moves_the_outlet_the_right_way(seed: int, wide: float) -> None:
    rng = np.random.default_rng(seed)
    constants = np.array([one.mean + wide * one.sd * rng.uniform(-1, 1) for one in GLOBALS])
    slow = np.zeros((POINTS, 5))
    for j, name in enumerate(("fill", "air", "uniformity", "bias")):
        slow[:, j] = rng.uniform(-BOUNDS[name], 0.3 * BOUNDS[name], POINTS)
    wet = rng.uniform(-3.0, 27.0, POINTS)
    t_in = np.maximum(wet + rng.uniform(4.0, 22.0, POINTS), 8.0)
    u = Inputs(
        t_in,
        rng.uniform(150.0, 290.0, POINTS),
        rng.uniform(0.33, 0.95, POINTS),
        wet + rng.uniform(0.5, 9.0, POINTS),
        wet,
        np.full(POINTS, 99.0),
    )
    at = Operation(
        u,
        np.zeros(POINTS),
        rng.uniform(0.0, 10.0, POINTS),
        rng.uniform(0.0, 360.0, POINTS),
        rng.uniform(0.0, 1.0, POINTS),
    )

    def outlet(share: float) -> np.ndarray:
        return MODEL.outlet(replace(at, inputs=replace(u, speed=share * u.speed)), slow, constants)

    usual = outlet(1.0)
    cools = t_in - usual > LEAST_FALL_K
    assert (outlet(1.1)[cools] < usual[cools]).all() and (outlet(0.9)[cools] > usual[cools]).all()
