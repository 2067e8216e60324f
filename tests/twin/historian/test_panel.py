"""Tests of the prediction of a tag by the others."""

import numpy as np
import pytest

from twin.historian.defects.panel import ROUNDS, RobustPredictor

Array = np.ndarray


def _by_weights(target: Array, matrix: Array) -> tuple[Array, float]:
    """Return the ridge prediction with Huber weights, all rows weighed anew in each round."""
    known = np.isfinite(target)
    a, centre = matrix[known], np.median(target[known])
    y, weight, sigma = target[known] - centre, np.ones(known.sum()), np.inf
    ridge = np.diag([1e-9] + [1e-3 * len(y)] * (matrix.shape[1] - 1))
    coefficients = np.zeros(matrix.shape[1])
    for _ in range(ROUNDS):
        coefficients = np.linalg.solve((a * weight[:, None]).T @ a + ridge, a.T @ (weight * y))
        off = np.abs(y - a @ coefficients)
        sigma = 1.4826 * float(np.median(off))
        weight = np.minimum(1.0, 1.5 * sigma / off)
    return centre + matrix @ coefficients, sigma


@pytest.mark.parametrize("missing", [0, 17])
def test_a_kept_product_predicts_as_rows_weighed_anew(missing: int) -> None:
    rng = np.random.default_rng(3)
    matrix = np.column_stack([np.ones(600), rng.normal(size=(600, 6))])
    predict = RobustPredictor(matrix)
    for _ in range(3):
        target = 40.0 + matrix @ rng.normal(size=7) + rng.standard_t(1.5, size=600)
        # Other rows are unknown each time, so that nothing of the target before may be left.
        target[rng.integers(0, 600, missing)] = np.nan
        found, sigma = predict(target)
        wanted, scatter = _by_weights(target, matrix)
        assert found == pytest.approx(wanted, abs=1e-9)
        assert sigma == pytest.approx(scatter, abs=1e-9)


def test_few_rows_predict_nothing() -> None:
    matrix = np.column_stack([np.ones(20), np.random.default_rng(0).normal(size=(20, 3))])
    found, sigma = RobustPredictor(matrix)(np.where(np.arange(20) < 7, 1.0, np.nan))
    assert np.isnan(found).all()
    assert sigma == np.inf
