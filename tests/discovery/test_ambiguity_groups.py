"""Entries of the catalogue that no input separates, against runs of the real elements."""

from __future__ import annotations

import numpy as np
import pytest

from tests.discovery.conftest import Bench
from tests.discovery.plans import run, steady
from tests.discovery.test_records import TWINS
from twin.discovery.effects.ambiguity_groups import ambiguity_groups, compute_ambiguity_groups, exciting_inputs
from twin.discovery.effects.catalogue import catalogue
from twin.discovery.engine import diagnose
from twin.discovery.healthy.basis import Columns
from twin.kernel import simulate
from twin.twinfile import load

FINS, FAN = ("heat_rejection", "radiator", "constant"), ("actuator", "fan_speed", "constant")
PUMP, FLOW = ("actuator", "pump_speed", "constant"), ("flow", "loop", "constant")


def test_a_pump_and_its_flow_are_one_and_a_source_and_a_thermometer_are_two(bench: Bench) -> None:
    found = compute_ambiguity_groups(bench.network)
    groups = [set(g) for g in found.groups]
    assert any({PUMP, FLOW} <= g for g in groups)
    assert any({FINS, FAN} <= g for g in groups)
    together = {x for g in groups for x in g}
    assert ("sensor", "T_tank_C", "constant") not in together
    assert ("heat_source", "tank", "constant") not in together
    assert set(together) <= {(c.kind, c.where, c.driver) for c in catalogue(bench.network)}
    assert ambiguity_groups(bench.network) == ambiguity_groups(bench.network) == found  # from the cache too


def test_what_is_called_alike_is_alike_in_the_readings(bench: Bench) -> None:
    """A pump that delivers 3 % less and a flow factor that is 3 % less, under the richest inputs."""
    network, grid = bench.network, exciting_inputs(bench.network)
    slow = bench.with_element("slip", {"kind": "actuator", "column": "pump_speed_pct", "gain": {"value": 0.97}})
    less = bench.with_values(circuit__factor=0.97)
    state = network.initial_state(np.full((6, len(network.sensors)), np.nan))
    read = [simulate(n, grid.time, grid.inputs, state) for n in (network, slow, less)]
    effect = np.abs(read[1] - read[0]).max()
    assert effect > 0.1 and np.abs(read[2] - read[1]).max() < 0.02 * effect


def test_water_that_comes_in_is_varied_too() -> None:
    """A moving inlet shows what a steady one hides: delay, metal and loss of the water that passes."""
    unseen = {label[:2] for label in compute_ambiguity_groups(load(TWINS / "heated_pipe_mixed.toml")).undetectable}
    assert not {(kind, "water") for kind in ("delay", "thermal_mass", "heat_loss")} & unseen
    assert ("sensor", "T_ambient_C") in unseen


def test_an_answer_names_its_group(bench: Bench, healthy: Columns) -> None:
    record = run(bench.network, steady(8.0), bench.with_values(circuit__factor=0.9), 3.0)
    found = diagnose(bench.network, record, healthy)
    said = {(e.kind, e.where) for e in found.effects} | {(a.kind, a.where) for a in found.indistinguishable}
    assert {FLOW[:2], PUMP[:2]} <= said
    assert any("any record of this rig" in text and "pump_speed" in text for text in found.blind_spots)


@pytest.mark.parametrize("piped", [False, True])
def test_a_twin_may_seem_to_lack_a_little_hose_and_less_where_it_knows_its_pipes(bench: Bench, piped: bool) -> None:
    hose = {"kind": "pipe", "to": "modules", "volume": 1.5}
    found = catalogue(bench.with_element("hose", hose) if piped else bench.network)
    litres_per_s = bench.network.parameters["circuit.nominal"].value / 60.0
    delays = {c.lumped / litres_per_s for c in found if c.kind == "delay"}
    lags = {c.lumped for c in found if c.kind == "sensor" and c.driver == "rate_of_change"}
    assert {round(s, 6) for s in delays} == ({6.0} if piped else {20.0}) and lags == ({6.0} if piped else {25.0})
