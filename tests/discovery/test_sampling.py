"""A healthy record that is sampled seldom, beside a reference that was sampled often."""

from __future__ import annotations

import numpy as np
import pytest

from tests.discovery.conftest import Bench
from twin.discovery import diagnose
from twin.discovery.healthy.basis import Columns


@pytest.mark.parametrize("every", [7, 25])
def test_a_healthy_rig_that_is_sampled_seldom_is_adequate(bench: Bench, healthy: Columns, every: int) -> None:
    """Loads change between two samples, and nothing tells when."""
    full, rows = bench.record(seed=5), slice(3, None, every)
    seldom = Columns(*(np.ascontiguousarray(x[rows]) for x in (full.time_s, full.inputs, full.measured)))
    assert diagnose(bench.network, seldom, healthy).verdict == "adequate"
