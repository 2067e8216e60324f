"""A conductance that somebody wrote as a law, such as a valve of cooling water, may change as any other."""

from __future__ import annotations

import pytest

from tests.discovery.conftest import Bench
from twin.discovery import diagnose
from twin.network import Network
from twin.twinfile import parse

VALVE: dict[str, object] = {
    "kind": "law_conductance",
    "node": "tank",
    "ambient": "T_ambient_C",
    "of": "modules",
    "form": "dead_band",
    "gain": 4.0,
    "reference": 0.0,
    "width": 34.0,
}
"""Cooling by a valve that opens from 34 degC on."""
BATH = """
format = 1
name = "bath"
[inputs]
T_water_C = { nominal = 14.0 }
T_ambient_C = { nominal = 22.0 }
[elements.bath]
kind = "node"
capacitance = 1000.0
[elements.coil]
kind = "law_conductance"
node = "bath"
ambient = "T_water_C"
size = 2.0
[elements.T_bath_C]
kind = "sensor"
node = "bath"
columns = ["T_bath_C"]
"""
LOSS = '[elements.loss]\nkind = "ambient_loss"\nnode = "bath"\nhA = 1.0\n'


def test_a_valve_that_cools_less_is_named(pair: Bench) -> None:
    valved = pair.of(pair.with_element("valve", VALVE))
    stuck = valved.record(16.0, seed=4, changed=valved.with_values(valve__gain=2.4), onset_h=5.0)
    (effect,) = diagnose(valved.network, stuck, valved.record(10.0, seed=7)).effects
    assert (effect.kind, effect.where) == ("heat_loss", "tank") and effect.value == pytest.approx(-0.4, abs=0.01)
    assert effect.says.startswith("The tank has 40") and "of the conductance" in effect.says


@pytest.mark.parametrize(("text", "room"), [(BATH, "T_water_C"), (BATH + LOSS, "T_ambient_C")])
def test_cooling_water_is_the_room_only_where_nothing_else_is(text: str, room: str) -> None:
    network: Network = parse(text)
    assert network.room == room
