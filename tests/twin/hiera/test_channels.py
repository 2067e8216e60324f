"""The channel table of the loop: what it holds, how it is normalised, and which twins it refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.twin.hiera.records import NETWORK, features, made
from twin.calibrators.hiera_unet.data.channels import ROLES, table
from twin.calibrators.hiera_unet.data.regimes import HEAT_OFF, LOAD, REST, STARTUP, STEADY, UNKNOWN, regimes
from twin.calibrators.hiera_unet.data.signals import FORMULAS, flat_steps, past_mean, quick, slope, stuck
from twin.network import TwinFileError
from twin.twinfile import load

TABLE = table(NETWORK)


def test_every_channel_has_a_formula_and_a_role_and_names_are_unique():
    assert {c.formula for c in TABLE.channels} <= FORMULAS.keys()
    assert {c.role for c in TABLE.channels} == set(ROLES)
    assert len(set(TABLE.names)) == len(TABLE)


def test_groups_are_contiguous_and_add_up():
    order = [c.group for c in TABLE.channels]
    assert sum(TABLE.groups.values()) == len(TABLE)
    assert order == [g for g, size in TABLE.groups.items() for _ in range(size)]


def test_every_sensor_and_volume_has_reading_residual_and_balance():
    for sensor in NETWORK.sensor_names:
        assert {f"reading_{sensor}", f"residual_{sensor}", f"base_{sensor}"} <= set(TABLE.names)
    assert {f"balance_{node}" for node in NETWORK.nodes} <= set(TABLE.names)


def test_the_digest_tells_tables_apart_and_does_not_depend_on_parameter_values():
    other = NETWORK.with_values({"fins.UA_100": 33.0})
    assert table(other).digest == TABLE.digest
    assert replace(TABLE, channels=TABLE.channels[:-1]).digest != TABLE.digest


def test_a_twin_with_another_number_of_volumes_gets_a_table_of_its_own_size():
    six = table(load("profiles/twins/loop_six.toml"))
    assert len(six) > len(TABLE)
    assert six.digest != TABLE.digest


def test_a_twin_that_is_no_loop_is_refused_with_the_reason():
    with pytest.raises(TwinFileError, match="no input that begins with"):
        table(load("profiles/twins/tclab.toml"))


def test_values_have_the_size_of_one_and_do_not_depend_on_the_rig_s_size():
    frame = features().frame(made(1500), 1500, NETWORK.values)
    spread = np.abs(frame.x[200:]).mean(axis=0)
    assert (spread < 3.0).all()
    names = list(TABLE.names)
    assert 0.3 < frame.x[:, names.index("reading_T_heater_C")].mean() < 3.0


def test_means_look_back_only():
    values = np.arange(50.0)
    for formula in (lambda v: past_mean(v, 7), lambda v: quick(v, 60.0), lambda v: slope(v, 60.0)):
        later = values.copy()
        later[30:] += 100.0
        np.testing.assert_array_equal(formula(values)[:30], formula(later)[:30])


def test_a_slope_of_a_straight_line_is_its_slope():
    assert slope(0.5 * 5.0 * np.arange(60.0), 60.0)[20:] == pytest.approx(0.5)


def test_a_stuck_reading_is_told_from_its_beginning_even_between_gaps():
    values = np.random.default_rng(0).normal(size=(100, 2))
    values[40:90, 1] = values[40, 1]
    values[41:90:2, 1] = np.nan
    assert flat_steps(values)[88, 1] == 48
    told = stuck(values)
    assert told[40:89:2, 1].all()
    assert not told[:, 0].any()
    assert not told[:40, 1].any()


def test_regimes_follow_the_inputs():
    u = np.tile(NETWORK.nominal_inputs, (900, 1))
    u[:60, :2] = 0.0
    u[60:120, 0] = 0.0
    u[600:, 0] *= 0.8
    u[800:, 1] = np.nan
    u[800:, 0] = 0.0
    found = regimes(NETWORK, u)
    assert (found[:60] == REST).all()
    assert (found[60:120] == HEAT_OFF).all()
    assert (found[130:300] == STARTUP).all()
    assert (found[450:600] == STEADY).all()
    assert (found[600:660] == LOAD).all()
    assert (found[800:] == HEAT_OFF).all()
    assert (regimes(NETWORK, np.full((5, u.shape[1]), np.nan)) == UNKNOWN).all()
