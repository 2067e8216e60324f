"""A room thermometer that reads wrong: in the sun, in the heater's exhaust. It acts wherever the room does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.discovery.conftest import HOUR, Bench
from twin.discovery import diagnose
from twin.discovery.healthy.basis import Columns, CommissionedRecord
from twin.network import Array
from twin.revisions import with_elements
from twin.twinfile import dump, parse


def read_wrong(bench: Bench, record: Columns, error_K: Array) -> Columns:
    """The record with an error in the column of the room."""
    inputs = record.inputs.copy()
    inputs[:, bench.network.input_columns.index("T_ambient_C")] += error_K
    return replace(record, inputs=inputs)


def test_a_room_thermometer_that_exaggerates_is_no_heat_at_the_radiator(pair: Bench, pair_healthy: Columns) -> None:
    record = pair.record(12.0, seed=4)
    room = record.inputs[:, pair.network.input_columns.index("T_ambient_C")]
    found = diagnose(pair.network, read_wrong(pair, record, 4.0 * np.maximum(room - 22.0, 0.0)), pair_healthy)
    first = found.effects[0]
    assert (first.kind, first.where, first.driver) == ("sensor", "T_ambient_C", "temperature")


def test_a_room_thermometer_in_the_exhaust_follows_the_heater(brisk: Bench, brisk_healthy: Columns) -> None:
    record = brisk.record(12.0, seed=5)
    power = record.inputs[:, brisk.network.input_columns.index("heater_power_W")]
    since = 3.0 * HOUR
    found = diagnose(brisk.network, read_wrong(brisk, record, 0.008 * power * (record.time_s >= since)), brisk_healthy)
    (first,) = found.effects
    assert (first.kind, first.where, first.driver) == ("sensor", "T_ambient_C", "heater_power")
    assert first.value == pytest.approx(0.008, rel=0.05) and first.onset_s == pytest.approx(since, abs=120.0)
    assert found.network is not None
    again = parse(dump(found.network))
    assert {"law_input", "actuator"} <= {e.kind for e in again.elements}


def test_a_twin_that_has_taken_up_an_error_of_the_room_is_diagnosed_again(pair: Bench, pair_healthy: Columns) -> None:
    own = with_elements(
        pair.network, {"actuator_of_T_ambient_C": {"kind": "actuator", "column": "T_ambient_C", "offset": -2.0}}
    )
    good = pair_healthy
    before = CommissionedRecord(good.time_s, good.inputs, good.measured, before=(pair.network,))
    record = pair.record(12.0)
    assert diagnose(own, read_wrong(pair, record, np.full(len(record.time_s), 2.0)), before).verdict == "adequate"
    (more,) = diagnose(own, read_wrong(pair, record, np.full(len(record.time_s), 3.0)), before).effects
    assert (more.kind, more.where) == ("sensor", "T_ambient_C") and more.value == pytest.approx(1.0, abs=0.1)
