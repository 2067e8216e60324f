"""`hil bench bus` and `hil bench wire` at their smallest: what they compare, and that they judge what they measure."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from hil.bench.commands.bench import command as bench
from hil.bench.fuzz import wire
from hil.bench.loop import bus


def test_the_bus_is_measured_beside_others_and_pipelined_requests_are_answered_in_order():
    told: list[float] = []
    tables, skipped = bus.measure(bus.BusSize(slices=2, trips=20, steps=40, pipelined=50), 0, told.append)
    trips, lockstep, pipelined = tables
    names = [row[0] for row in trips.rows]
    assert names[:2] == ["raw socket, nothing checked", "ours, registers"]
    assert "pymodbus, asyncio" in names
    for stranger in ("pyModbusTCP", "libmodbus"):
        assert any(stranger in str(line) for line in (*names, *skipped))
    assert all(isinstance(cell, float) and cell > 0.0 for row in trips.rows for cell in row[1:])
    assert [row[2] for row in trips.rows if row[0] in trips.columns[2]] == [1.0]
    assert pipelined.rows == (("virtual rig", 50, 50, 50),)
    assert [row[0] for row in lockstep.rows] == [
        "ours, as in a run: on one processor with the rig",
        "ours, on processors of their own",
        "raw socket, nothing decoded or checked",
    ]
    assert told == sorted(told) and told[-1] == 1.0


def test_mutations_are_counted_by_kind_and_a_wrong_value_ends_with_exit_code_1(monkeypatch: pytest.MonkeyPatch):
    done = CliRunner().invoke(bench, ["wire", "--count", "51", "--json"])
    assert done.exit_code == 0, done.output
    tables = json.loads(done.stdout)["tables"]
    assert set(tables) == {"modbus", "rtu", "can"}
    for table in tables.values():
        assert sum(row[1] for row in table["rows"]) == 51
        assert table["columns"][-1] == "wrong" and not any(row[-1] for row in table["rows"])
    monkeypatch.setattr(wire, "mutate_rtu", lambda count, seed: {"twice": (count, 1, 0, 1)})
    assert CliRunner().invoke(bench, ["wire", "--count", "17", "--json"]).exit_code == 1
