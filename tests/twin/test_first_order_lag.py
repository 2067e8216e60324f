"""First-order lags of series, against their definition."""

from __future__ import annotations

import numpy as np
import pytest

from twin.first_order_lag import lagged, recursion


@pytest.mark.parametrize("count", [1, 2, 500])
@pytest.mark.parametrize("keep", [0.0, 0.3, 0.999])
def test_a_recursion_keeps_a_share_of_each_value(count: int, keep: float) -> None:
    terms = np.random.default_rng(1).normal(size=count)
    found = recursion(terms, keep)
    np.testing.assert_allclose(found, keep * np.concatenate([[0.0], found[:-1]]) + terms, atol=1e-13)


def test_a_lag_begins_at_rest_and_follows_a_step_exponentially() -> None:
    keep = np.exp(-5.0 / 60.0)
    np.testing.assert_allclose(lagged(np.full(40, 21.5), keep), 21.5)
    found = lagged(np.where(np.arange(40) >= 10, 1.0, 0.0), keep)
    assert not found[:10].any()
    np.testing.assert_allclose(found[10:], 1.0 - keep ** np.arange(1.0, 31.0))
