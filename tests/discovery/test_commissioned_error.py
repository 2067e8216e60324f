"""An error that no load makes that of a healthy rig is not adequate, however loud the twin was in health."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.discovery.conftest import Bench
from twin.commissioning import CommissionOptions, commission
from twin.discovery import diagnose
from twin.discovery.diagnosis import SensorError
from twin.discovery.evidence.commissioned import explains_too_little
from twin.discovery.healthy.basis import Columns


@pytest.mark.parametrize(
    ("before", "moved", "too_little"),
    [(0.3, 2.0, False), (1.1, 2.0, True), (0.9, 0.8, True), (0.15, 0.1, False), (float("nan"), 2.0, False)],
)
def test_an_error_is_held_against_health_and_against_a_constant(
    bench: Bench, before: float, moved: float, too_little: bool
) -> None:
    names = bench.network.sensor_names
    known = replace(bench.network.revision, error_after_K=dict.fromkeys(names, 0.1))
    network = replace(bench.network, revision=known)
    readings = 40.0 + moved * np.tile([[-1.0], [1.0]], (50, len(names)))
    errors = {name: SensorError(before, before, before, 0.02) for name in names}
    assert explains_too_little(network, errors, readings) == too_little


def test_a_twin_of_a_record_in_another_unit_calls_nothing_adequate(pair: Bench, pair_healthy: Columns) -> None:
    """Power in kW and in W: what the twin leaves in health passes for noise, which hides any error later."""
    small = replace(pair_healthy, inputs=pair_healthy.inputs * [1e-3, 1.0, 1.0, 1.0])
    fitted = commission(pair.network, small.time_s, small.inputs, small.measured, CommissionOptions(starts=1)).network
    found = diagnose(fitted, pair.record(8.0, seed=5), small)
    assert found.verdict != "adequate" and found.network is None
