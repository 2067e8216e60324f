"""A heat exchanger without a healthy record, with a misfit that no law has: what is named nevertheless."""

from __future__ import annotations

import re

import numpy as np
import pytest

from twin.discovery.effects.catalogue import catalogue
from twin.discovery.growing.answer import diagnose_grown
from twin.discovery.growing.merit import mostly_explained
from twin.discovery.growing.superset.candidate_superset import CandidateSuperset
from twin.discovery.healthy.basis import Columns
from twin.kernel import simulate
from twin.network import Array, Network
from twin.revisions import with_elements
from twin.twinfile import parse

EXCHANGER = """
format = 1
name = "exchanger"
[inputs]
flow_pct = { nominal = 50.0, lower = 0.0, upper = 100.0 }
T_in_C = { nominal = 20.0, lower = 0.0, upper = 60.0 }
T_steam_C = { nominal = 120.0, lower = 90.0, upper = 180.0 }
[elements.water]
kind = "node"
capacitance = { value = 3000.0, lower = 100.0, upper = 50000.0, status = "tunable" }
[elements.supply]
kind = "flow"
path = ["water"]
inlet = "T_in_C"
pump = "flow_pct"
nominal = { value = 6.0 }
factor = { value = 1.0, status = "fixed" }
[elements.tube]
kind = "radiator"
node = "water"
fan = "flow_pct"
pump = "flow_pct"
ambient = "T_steam_C"
form = "outlet"
UA_100 = { value = 300.0, lower = 10.0, upper = 5000.0 }
fan_exponent = { value = 0.0, lower = 0.0, upper = 2.0, status = "fixed" }
flow_exponent = { value = 0.0, lower = -1.0, upper = 1.0, status = "fixed" }
[elements.T_out_C]
kind = "sensor"
node = "water"
columns = ["T_out_C"]
sigma = 0.05
"""


@pytest.fixture(scope="module")
def exchanger() -> Network:
    return parse(EXCHANGER)


def driven(least_pct: float = 30.0, seed: int = 1) -> tuple[Array, Array]:
    """Half an hour at four seconds, with the flow in steps."""
    t = np.arange(450) * 4.0
    flow = np.repeat(np.random.default_rng(seed).uniform(least_pct, 90.0, 30), 15)
    return t, np.column_stack([flow, np.full(len(t), 20.0), np.full(len(t), 120.0)])


def read(twin: Network, t: Array, u: Array, error: Array | float = 0.0, seed: int = 2) -> Columns:
    y = simulate(twin, t, u, np.array([60.0])) + np.random.default_rng(seed).normal(0.0, 0.05, (len(t), 1))
    return Columns(t, u, y + error)


def test_the_main_effect_is_named_and_nothing_beside_it_that_only_mends_its_form(exchanger: Network) -> None:
    t, u = driven()
    true = exchanger.with_values({"tube.fan_exponent": 0.5})
    clean = simulate(true, t, u, np.array([60.0]))
    found = diagnose_grown(exchanger, read(true, t, u, 0.5 * np.sin(clean)), most=2, beam=2)
    assert found.verdict == "effect found" and "structural error" in found.summary
    (effect,) = found.effects
    assert (effect.kind, effect.where) == ("heat_rejection", "water")
    assert effect.value == pytest.approx(0.5, abs=0.05)
    off = found.errors["T_out_C"]
    assert off.noise < off.after < 0.6 * off.before


def test_a_valve_that_opens_late_is_told_with_its_dead_band(exchanger: Network) -> None:
    late = with_elements(exchanger, {"valve": {"kind": "actuator", "column": "flow_pct", "offset": -22.0}})
    found = diagnose_grown(exchanger, read(late, *driven()), most=1)
    (effect,) = found.effects
    assert (effect.kind, effect.where, effect.driver, effect.unit) == ("actuator", "flow", "flow", "%")
    assert effect.value == pytest.approx(22.0, abs=1.0)
    assert re.search(r"delivers nothing up to a command of 2[12]", found.summary)


@pytest.mark.parametrize(
    ("after", "before", "mostly"),
    [(20.0, 41.0, True), (21.5, 41.0, False), (1.2, 1.0, True), (1.2, 0.9, True), (1.5, 1.0, False)],
)
def test_a_thermometer_that_stays_within_its_noise_refuses_no_effect(after: float, before: float, mostly: bool) -> None:
    """Mean squares over those of the noise, with the effects and without them."""
    assert mostly_explained(after, before) == mostly


def test_the_output_follows_a_power_of_the_command(exchanger: Network) -> None:
    t, u = driven()
    curved = with_elements(exchanger, {"valve": {"kind": "actuator", "column": "flow_pct", "exponent": 1.4}})
    straight = u.copy()
    straight[:, 0] = 100.0 * (u[:, 0] / 100.0) ** 1.4
    runs = simulate(curved, t, u, np.array([60.0])), simulate(exchanger, t, straight, np.array([60.0]))
    np.testing.assert_allclose(*runs, atol=1e-6)


def test_below_its_dead_band_an_actuator_delivers_nothing(exchanger: Network) -> None:
    valve = {"kind": "actuator", "column": "flow_pct", "offset": -22.0}
    t, u = driven(0.0)
    still = u.copy()
    still[:, 0] = np.maximum(u[:, 0], 22.0)
    assert u[:, 0].min() < 10.0
    late = with_elements(exchanger, {"valve": valve})
    np.testing.assert_allclose(*(simulate(late, t, x, np.array([60.0])) for x in (u, still)), atol=1e-9)


def test_a_thermometer_that_never_moves_is_no_candidate_of_one_that_does(exchanger: Network) -> None:
    assert any(c.sticks for c in catalogue(exchanger))
    superset = CandidateSuperset.of(exchanger, exchanger.tunables(None), 4.0, 1800.0, False)
    assert not any(c.sticks for c in superset.candidates)


def test_of_the_water_that_passes_as_a_plug_as_much_stays_mixed_as_flows_in_a_second(exchanger: Network) -> None:
    """A volume of nothing would need a step of nothing."""
    (plug,) = [c for c in catalogue(exchanger) if c.kind == "delay" and "unmixed" in c.says]
    litres = exchanger.parameters["water.capacitance"].value / 4180.0
    assert litres - plug.upper == pytest.approx(6.0 / 60.0, rel=0.05)
