"""Basin thermometers as second thermometers: what they teach of the outlets' errors, and what other water hides."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from twin.tower.estimates import DAY_S, Estimate
from twin.tower.model import SLOW
from twin.tower.shared_observations import Drain, with_basin

DAYS, FLOW_KG_S, VOLUME_M3, PRIOR_K = 12, 250.0, 210.0, 0.2
BIAS, TRUE_K, OFFSET_K = SLOW.index("bias"), (0.3, -0.1), 0.1
MINUTES = np.arange(DAYS * 1440)

Array = NDArray[np.float64]


def _posterior() -> Estimate:
    """Return a posterior of biases of mean 0 that hardly walk, nothing else known."""
    cells, none = 2 * DAYS, np.zeros(0)
    covariance = np.eye(cells * len(SLOW)) * 1e-6
    at = np.arange(cells) * len(SLOW) + BIAS
    covariance[np.ix_(at, at)] += PRIOR_K**2
    edges = np.arange(cells + 1) * 0.5 * DAY_S
    slow, rows = np.zeros((cells, len(SLOW))), np.zeros((0, len(SLOW)))
    return Estimate(
        edges, slow, none, covariance, (0.1, 0.03), none, none, np.zeros(0, dtype=np.intp), rows, 1.0, none, none
    )


def _biases(exchange_kg_s: float, difference_K: Array, *, with_supply: bool = True) -> tuple[Array, Array]:
    """Return means and standard deviations of the biases of two cells (2,), K, which run together and by turns beside
    another compartment that is warmer by `difference_K` (n,)."""
    flow = np.full((len(MINUTES), 2), FLOW_KG_S)
    flow[MINUTES // 720 % 3 == 1, 0] = 0.0
    flow[MINUTES // 720 % 3 == 2, 1] = 0.0
    water = 23.0 + np.column_stack([np.sin(MINUTES / 700.0), np.cos(MINUTES / 500.0)])
    other = 23.0 + difference_K
    basin, now = np.zeros(len(MINUTES)), 23.0
    for i, (own, t) in enumerate(zip(flow, water, strict=True)):
        now += 60.0 * (own @ (t - now) + exchange_kg_s * (other[i] - now)) / (1000.0 * VOLUME_M3)
        basin[i] = now
    sampled = MINUTES % 5 == 0
    drains = [Drain(flow[:, c], water[:, c] + TRUE_K[c], basin + OFFSET_K, sampled) for c in range(2)]
    supply = 0.5 * (basin + other) if with_supply else None
    made = [_posterior(), _posterior()]
    found = with_basin(made, drains, 60.0 * MINUTES, np.zeros(len(MINUTES)), VOLUME_M3, (), supply)
    return np.array([p.slow[:, BIAS].mean() for p in found]), np.array([p.sd()[:, BIAS].mean() for p in found])


@pytest.mark.parametrize("exchange_kg_s", [0.0, 250.0])
def test_water_of_another_compartment_is_no_error_of_a_thermometer(exchange_kg_s: float) -> None:
    mean, sd = _biases(exchange_kg_s, np.full(len(MINUTES), 3.0))
    assert (np.abs(mean - TRUE_K) < 2.0 * sd).all()


def test_a_thermometer_teaches_less_the_more_other_water_it_may_see() -> None:
    none, some, always = (
        _biases(exchange_kg_s, np.full(len(MINUTES), difference_K))[1]
        for exchange_kg_s, difference_K in ((0.0, 0.2), (250.0, 0.2), (250.0, 3.0))
    )
    assert (none < 0.9 * some).all() and (some < 0.95 * always).all()


def test_a_basin_of_one_compartment_needs_no_supply() -> None:
    mean, sd = _biases(0.0, np.zeros(len(MINUTES)), with_supply=False)
    assert (np.abs(mean - TRUE_K) < 2.0 * sd).all() and (sd < PRIOR_K).all()
