"""Columns of a file that are exchanged or in another unit, beside effects of a rig that resemble them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.discovery.conftest import Bench
from twin.discovery import column_mistakes
from twin.discovery.healthy.basis import Columns


@pytest.fixture
def record(brisk: Bench) -> Columns:
    return brisk.record(8.0)


def test_exchanged_columns_are_asked_about(brisk: Bench, brisk_healthy: Columns, record: Columns) -> None:
    heater, tank = (brisk.network.sensor_names.index(name) for name in ("T_heater_C", "T_tank_C"))
    measured = record.measured.copy()
    measured[:, [heater, tank]] = measured[:, [tank, heater]]
    (asked,) = column_mistakes(brisk.network, replace(record, measured=measured), brisk_healthy)
    assert asked.startswith("T_heater_C and T_tank_C look exchanged: read the other way round, the twin is off by 0.0")
    inputs = record.inputs.copy()
    inputs[:, [1, 2]] = inputs[:, [2, 1]]
    (asked,) = column_mistakes(brisk.network, replace(record, inputs=inputs))
    pump, fan = brisk.network.input_columns[1:3]
    assert asked.startswith(f"{pump} and {fan} look exchanged")


@pytest.mark.parametrize(("unit", "scale", "zero"), [("degrees Fahrenheit", 1.8, 32.0), ("kelvin", 1.0, 273.15)])
@pytest.mark.parametrize("column", ["T_tank_C", "T_ambient_C"])
def test_a_temperature_in_another_unit_is_asked_about(
    brisk: Bench, brisk_healthy: Columns, record: Columns, column: str, unit: str, scale: float, zero: float
) -> None:
    measured, inputs = record.measured.copy(), record.inputs.copy()
    if column in brisk.network.input_columns:
        values = inputs[:, brisk.network.input_columns.index(column)]
    else:
        values = measured[:, brisk.network.sensor_names.index(column)]
    values[:] = scale * values + zero
    (asked,) = column_mistakes(brisk.network, replace(record, measured=measured, inputs=inputs), brisk_healthy)
    assert asked.startswith(f"{column} looks like {unit}: read so, the twin is off by 0.0")


def test_plugs_exchanged_amid_a_record_are_asked_about(brisk: Bench, brisk_healthy: Columns, record: Columns) -> None:
    heater, tank = (brisk.network.sensor_names.index(name) for name in ("T_heater_C", "T_tank_C"))
    measured, since = record.measured.copy(), record.time_s >= 1800.0
    measured[since, heater], measured[since, tank] = record.measured[since, tank], record.measured[since, heater]
    (asked,) = column_mistakes(brisk.network, replace(record, measured=measured), brisk_healthy)
    assert asked.startswith(
        "from 30 min on, T_heater_C and T_tank_C look exchanged: read the other way round, the twin"
    )


def test_a_logger_that_is_set_to_another_unit_for_a_time_is_asked_about(brisk: Bench, record: Columns) -> None:
    tank = brisk.network.sensor_names.index("T_tank_C")
    measured, amid = record.measured.copy(), (record.time_s >= 600.0) & (record.time_s < 1800.0)
    measured[amid, tank] = 1.8 * measured[amid, tank] + 32.0
    (asked,) = column_mistakes(brisk.network, replace(record, measured=measured))
    assert asked.startswith("from 10 min to 30 min, T_tank_C looks like degrees Fahrenheit")


def test_readings_without_a_partner_do_not_make_an_exchange_longer(brisk: Bench, record: Columns) -> None:
    """Two short exchanges, and between them an error of one thermometer while the other one is dead."""
    heater, tank = (brisk.network.sensor_names.index(name) for name in ("T_heater_C", "T_tank_C"))
    measured = record.measured.copy()
    for rows in (slice(100, 150), slice(400, 450)):
        measured[rows, heater], measured[rows, tank] = record.measured[rows, tank], record.measured[rows, heater]
    measured[150:400, tank] = np.nan
    measured[150:400, heater] += 4.0
    assert not column_mistakes(brisk.network, replace(record, measured=measured))


def test_effects_of_a_rig_are_no_mistakes_of_its_file(brisk: Bench, brisk_healthy: Columns, record: Columns) -> None:
    assert not column_mistakes(brisk.network, record, brisk_healthy)
    heated = brisk.with_element("heat", {"kind": "heat_source", "node": "tank", "power": 300.0})
    assert not column_mistakes(brisk.network, brisk.record(8.0, changed=heated), brisk_healthy)
    for j in range(len(brisk.network.sensors)):
        for error in (3.0, -0.2 * record.measured[:, j]):
            measured = record.measured.copy()
            measured[:, j] += error
            assert not column_mistakes(brisk.network, replace(record, measured=measured), brisk_healthy)
            measured[: len(measured) // 2] = record.measured[: len(measured) // 2]
            assert not column_mistakes(brisk.network, replace(record, measured=measured), brisk_healthy)
    measured = np.full_like(record.measured, np.nan)
    measured[:, 0] = record.measured[:, 0]
    assert not column_mistakes(brisk.network, replace(record, measured=measured), brisk_healthy)
