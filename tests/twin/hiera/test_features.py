"""From records with all their faults to windows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.twin.hiera.records import NETWORK, SIGMA_K, deviation, features, made
from twin.calibrators.hiera_unet.context_fit.evidence import estimate
from twin.calibrators.hiera_unet.data.channels import table
from twin.calibrators.hiera_unet.data.features import Features
from twin.calibrators.hiera_unet.data.parameters import Deviations
from twin.calibrators.hiera_unet.data.series import STEP_S, ResampledSeries, series
from twin.calibrators.hiera_unet.data.windows import CONTEXT, TARGET
from twin.network import TwinFileError
from twin.steady import steady_state
from twin.twinfile import parse

N = 1500
FIRST = CONTEXT - TARGET


@pytest.fixture(scope="module")
def record():
    return made(N)


@pytest.fixture(scope="module")
def frame(record):
    return features().frame(record, N, NETWORK.values)


def columns(record) -> dict[str, np.ndarray]:
    found = {c: record.inputs[:, j] for j, c in enumerate(NETWORK.input_columns)}
    for j, sensor in enumerate(NETWORK.sensors):
        found |= dict.fromkeys(sensor.measured, record.measured[:, j])
    return found


def test_the_base_of_a_healthy_rig_predicts_the_target(frame):
    assert np.sqrt(np.mean((frame.base - frame.target) ** 2)) < 1.5 * SIGMA_K


def test_the_residuals_of_a_healthy_rig_are_noise(frame):
    names = list(features().table.names)
    for sensor in NETWORK.sensor_names:
        assert np.abs(frame.x[100:, names.index(f"residual_{sensor}")]).max() < 1.0


def test_the_state_does_not_use_the_target(record, frame):
    shifted = record.measured.copy()
    shifted[N - TARGET :] += 7.0
    other = features().frame(replace(record, measured=shifted), N, NETWORK.values)
    np.testing.assert_array_equal(other.state, frame.state)
    np.testing.assert_array_equal(other.base, frame.base)


def test_no_channel_looks_ahead(record, frame):
    """What comes after a step changes nothing before it, so a causal network stays causal."""
    at = FIRST + 40
    later = replace(record, measured=record.measured.copy(), inputs=record.inputs.copy())
    later.measured[N - CONTEXT + at :] += 3.0
    later.inputs[N - CONTEXT + at :] *= 0.7
    other = features().frame(later, N, NETWORK.values)
    np.testing.assert_array_equal(other.x[:at], frame.x[:at])
    np.testing.assert_array_equal(other.m[:at], frame.m[:at])
    np.testing.assert_array_equal(other.regime[:at], frame.regime[:at])


def test_the_state_follows_a_rig_that_has_changed():
    moved = made(N, deviation(modules_power__power=0.4), onset=700)
    found = features().frame(moved, N, NETWORK.values)
    true = moved.measured[N - TARGET - 2 : N - TARGET + 3].mean(axis=0)
    assert found.state[: len(NETWORK.nodes)] == pytest.approx(true, abs=0.1)


def test_a_lost_sensor_is_masked_and_its_state_keeps_the_last_that_was_known(record, frame):
    silent = record.measured.copy()
    silent[N - CONTEXT + 300 :, 3] = np.nan
    found = features().frame(replace(record, measured=silent), N, NETWORK.values)
    names = list(features().table.names)
    k = names.index("reading_T_tank_C")
    assert not found.m[301:, k].any()
    assert (found.x[301:, k] == 0.0).all()
    assert found.x[-1, names.index("stale_T_tank_C")] > 0.9
    assert found.state == pytest.approx(frame.state, abs=0.1)


def test_a_stuck_sensor_does_not_drag_the_state_along(record, frame):
    stuck = record.measured.copy()
    stuck[N - CONTEXT + 600 :, 3] = stuck[N - CONTEXT + 600, 3]
    found = features().frame(replace(record, measured=stuck), N, NETWORK.values)
    assert found.state == pytest.approx(frame.state, abs=0.15)


def test_a_lost_input_keeps_its_last_value_however_long_ago_that_was(record):
    lost = record.inputs.copy()
    lost[40:, 0] = np.nan
    found = features().frame(replace(record, inputs=lost), N, NETWORK.values)
    assert (found.held[:, 0] == record.inputs[39, 0]).all()
    assert not found.m[:, list(features().table.names).index("level_heater_power_W")].any()


def test_a_record_without_anything_is_finite_and_masked(record):
    empty = replace(record, inputs=np.full_like(record.inputs, np.nan), measured=np.full_like(record.measured, np.nan))
    found = features().frame(empty, N, NETWORK.values)
    assert np.isfinite(found.x).all() and np.isfinite(found.base).all() and np.isfinite(found.state).all()
    names = list(features().table.names)
    assert not found.m[:, [names.index(f"reading_{s}") for s in NETWORK.sensor_names]].any()


def test_a_window_that_begins_before_the_record_is_masked_there(record):
    end = 700
    found = features().frame(record, end, NETWORK.values)
    assert not found.m[: CONTEXT - end].any()
    assert found.m[CONTEXT - end + 60 :].mean() > 0.8
    assert np.sqrt(np.mean((found.base - found.target) ** 2)) < 2.0 * SIGMA_K


def test_a_record_at_one_hertz_comes_out_as_at_the_network_s_own_step(record):
    time = np.arange(N * 5, dtype=np.float64)
    fine = {name: np.interp(time, record.time, values) for name, values in columns(record).items()}
    for c in NETWORK.input_columns:
        fine[c] = np.repeat(columns(record)[c], 5)
    made_of = series(NETWORK, time, fine)
    assert len(made_of) == N
    assert made_of.inputs == pytest.approx(record.inputs)
    found = features().frame(made_of, N, NETWORK.values)
    assert np.sqrt(np.mean((found.base - found.target) ** 2)) < 1.5 * SIGMA_K


def test_gaps_and_irregular_stamps_stay_gaps(record):
    keep = np.ones(N, dtype=bool)
    keep[400:460] = False
    jitter = np.random.default_rng(0).uniform(-1.0, 1.0, N)
    jitter[0] = 0.0
    part = {name: values[keep] for name, values in columns(record).items()}
    found = series(NETWORK, (record.time + jitter)[keep], part)
    assert np.isnan(found.measured[401:459]).all()
    assert np.isfinite(found.measured[:399]).mean() > 0.9


def test_a_record_that_is_too_short_or_lacks_a_column_is_refused(record):
    whole = columns(record)
    with pytest.raises(TwinFileError, match="less than one step"):
        series(NETWORK, np.array([0.0]), {name: values[:1] for name, values in whole.items()})
    with pytest.raises(TwinFileError, match="correct its stamps"):
        series(NETWORK, np.array([0.0, 1e9]), {name: values[:2] for name, values in whole.items()})
    with pytest.raises(TwinFileError, match="fan_speed_pct"):
        series(NETWORK, record.time, {k: v for k, v in whole.items() if k != "fan_speed_pct"})


def test_the_clock_is_zero_where_the_record_does_not_tell_the_time(record, frame):
    assert not frame.clock.any()
    told = features().frame(replace(record, hour=6.0, day=10.0), N, NETWORK.values)
    start = (N - CONTEXT) * STEP_S / 3600.0
    assert told.clock[0, 0] == pytest.approx(np.cos(2.0 * np.pi * (6.0 + start) / 24.0))
    assert np.abs(told.clock).max() <= 1.0


THREE = """
format = 1
name = "three"

[inputs]
heater_power_W = { nominal = 2000.0, lower = 0.0, upper = 5000.0, unit = "W" }
pump_speed_pct = { nominal = 100.0, lower = 0.0, upper = 100.0, unit = "%" }
fan_speed_pct = { nominal = 80.0, lower = 0.0, upper = 100.0, unit = "%" }
T_ambient_C = { nominal = 25.0, lower = -40.0, upper = 60.0, unit = "degC" }

[elements]
boiler = { kind = "node", capacitance = 8000.0 }
cooler = { kind = "node", capacitance = 6000.0 }
store = { kind = "node", capacitance = 90000.0 }
ring = { kind = "flow", path = ["boiler", "cooler", "store"], pump = "pump_speed_pct", nominal = 9.0 }
fins = { kind = "radiator", node = "cooler", fan = "fan_speed_pct", pump = "pump_speed_pct", UA_100 = 150.0 }
shell = { kind = "ambient_loss", node = "store", hA = 6.0 }
element = { kind = "heat_source", node = "boiler", driver = "heater_power_W" }
T_out_C = { kind = "sensor", node = "boiler", columns = ["T_out_C"] }
T_store_C = { kind = "sensor", node = "store", columns = ["T_store_C"] }

[sets.tracked]
members = ["fins.UA_100", "shell.hA", "element.factor"]
"""


def test_another_loop_with_a_volume_that_nothing_reads_gets_windows_of_its_own():
    """Nothing here knows the shipped loop's four volumes, its sensors or its size."""
    network = parse(THREE)
    deviations = Deviations.of(network, "tracked")
    own = Features(network, table(network), deviations)
    n, rng = 1500, np.random.default_rng(0)
    inputs = np.tile(network.nominal_inputs, (n, 1))
    inputs[500:, 0] *= 0.8
    inputs[900:, 2] *= 0.7
    time = np.arange(n) * STEP_S
    values = deviations.full(np.array([-0.3, 0.0, 0.0]), network.values)
    clean = own.kernel.trace(values, steady_state(network, inputs[0], values), time, inputs)[0][0]
    readings = clean + SIGMA_K * rng.standard_normal(clean.shape)
    found = own.frame(ResampledSeries(time, inputs, readings, np.full(readings.shape, np.nan)), n, network.values)
    assert found.x.shape == (CONTEXT, len(own.table)) and found.base.shape == (TARGET, 2)
    assert not found.m[:, list(own.table.names).index("balance_cooler")].any()
    assert 0.2 < np.abs(found.x[:, list(own.table.names).index("reading_T_out_C")]).mean() < 5.0
    fit = estimate(own, found, network.values)
    assert fit.theta[0] == pytest.approx(-0.3, abs=0.03)
