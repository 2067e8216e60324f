"""Actuators that deliver no more than a level: a heater at its current limit, a fan at the top of its converter."""

from __future__ import annotations

import pytest

from tests.discovery.conftest import Bench
from twin.discovery import diagnose
from twin.discovery.evidence.part import Part, within_commands
from twin.discovery.healthy.basis import Columns, CommissionedRecord, basis
from twin.discovery.records.grid import on_grid
from twin.revisions import with_elements
from twin.twinfile import dump, parse


@pytest.mark.parametrize(("column", "level"), [("heater_power_W", 730.0), ("fan_speed_pct", 60.0)])
def test_a_limit_is_found_with_its_level(brisk: Bench, brisk_healthy: Columns, column: str, level: float) -> None:
    limited = with_elements(
        brisk.network,
        {
            "drive": {"kind": "actuator", "column": column},
            "limit": {"kind": "limiter", "column": column, "share": 1.0, "offset": level},
        },
    )
    found = diagnose(brisk.network, brisk.record(12.0, changed=limited, onset_h=3.0), brisk_healthy)
    assert found.verdict == "effect found"
    (first,) = found.effects
    what = column.rsplit("_", 1)[0]
    assert (first.kind, first.where, first.driver) == ("actuator", what, what) and first.value == pytest.approx(
        1.0, abs=0.05
    )
    assert first.level == pytest.approx(level, rel=0.02) and found.document()["effects"][0]["level"] is not None
    assert found.network is not None
    values = parse(dump(found.network)).parameters
    share, offset = (values[f"limit_of_{column}.{name}"].value for name in ("share", "offset"))
    assert offset / share == pytest.approx(level, rel=0.02)


def test_a_twin_that_has_taken_up_a_limit_is_diagnosed_again(pair: Bench, pair_healthy: Columns) -> None:
    column = "heater_power_W"
    own = with_elements(
        pair.network,
        {
            f"actuator_of_{column}": {"kind": "actuator", "column": column},
            f"limit_of_{column}": {"kind": "limiter", "column": column, "share": 1.0, "offset": 730.0},
        },
    )
    good = pair_healthy
    before = CommissionedRecord(good.time_s, good.inputs, good.measured, before=(pair.network,))
    assert diagnose(own, pair.of(own).record(12.0), before).verdict == "adequate"
    (gone,) = diagnose(own, pair.record(12.0), before).effects
    assert (gone.kind, gone.where, gone.change) == ("actuator", "heater_power", "existing")
    assert gone.value == pytest.approx(-1.0, abs=0.05)


def test_a_limit_below_all_commands_of_a_running_heater_is_a_gain(pair: Bench, pair_healthy: Columns) -> None:
    """Whatever the heater reads while it is off."""
    record = pair.record(4.0)
    record.inputs[100:200, 0] = 0.0
    record.inputs[150:160, 0] = 3.0
    grid = on_grid(pair.network, record.time_s, record.inputs, record.measured)
    part = Part.of(basis(pair.network, pair_healthy, grid), grid)
    limit = next(c for c in part.basis.book.candidates if c.is_limit and c.where == "heater_power")
    assert limit.at_level is not None
    least = grid.inputs[grid.inputs[:, 0] > 100.0, 0].min()
    levels = (2.0, 0.9 * least, 1.1 * least, 5000.0)
    crossed = within_commands(part, map(limit.at_level, levels))
    assert [c.changes for c in crossed] == [limit.at_level(1.1 * least).changes]
