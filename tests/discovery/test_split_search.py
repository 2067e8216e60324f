"""How much of a record the fits see, and which lesser effects are told."""

from __future__ import annotations

import numpy as np
import pytest

from tests.discovery.conftest import HOUR, Bench
from twin.discovery.engine import diagnose
from twin.discovery.evidence.part import Part, gains
from twin.discovery.evidence.search import searched
from twin.discovery.evidence.split_search import SplitSearch
from twin.discovery.healthy.basis import Columns, basis
from twin.discovery.records.grid import on_grid, sample_period
from twin.kernel import Kernel
from twin.revisions import with_elements

HEAT = {"kind": "heat_source", "node": "modules", "power": 15.0}
MASS = {"kind": "hidden_mass", "node": "tank", "conductance": 6.0, "capacity": 1.5e3}


def heat_then_mass(bench: Bench, heat_h: float, mass_h: float) -> Columns:
    """A record with heat in the modules since one hour, and in the tank, since another, a mass as warm as the tank."""
    t, u = bench.inputs(16.0, 3)
    hours = sorted({0.0, heat_h, mass_h})
    cuts = [*(int(np.searchsorted(t, h * HOUR)) for h in hours), len(t)]
    parts, state = [], np.array(bench.start_C)
    for hour, low, high in zip(hours, cuts[:-1], cuts[1:], strict=True):
        there = {"heat": HEAT} if hour >= heat_h else {}
        network = with_elements(bench.network, {**there, "mass": MASS} if hour >= mass_h else there)
        state = np.append(state, state[bench.network.nodes.index("tank")])[: len(network.nodes)]
        read, ends = Kernel(network, ()).trace(network.values, state, t[low : high + 1], u[low : high + 1])
        parts.append(read[0][: high - low])
        state = ends[0][: len(network.nodes)]
    y = np.vstack(parts)
    return Columns(t, u, y + bench.network.sigma * np.random.default_rng(5).normal(0.0, 1.0, y.shape))


def test_what_only_the_last_part_shows_beside_the_answer_is_told(brisk: Bench) -> None:
    """Of what begins after nine tenths the fit is given half."""
    record = brisk.record(16.0, changed=brisk.with_element("heat", HEAT), onset_h=3.0)
    j = brisk.network.sensor_names.index("T_tank_C")
    record.measured[record.time_s > 12.5 * HOUR, j] += 0.12
    found = diagnose(brisk.network, record, brisk.record(10.0, seed=7))
    assert {(e.kind, e.where) for e in found.effects} == {("heat_source", "modules"), ("sensor", "T_tank_C")}
    tank = next(e for e in found.effects if e.kind == "sensor")
    assert tank.value == pytest.approx(0.12, rel=0.1) and tank.onset_s == pytest.approx(12.5 * HOUR, abs=300.0)
    assert found.held_out_s[0] == pytest.approx(14.4 * HOUR, abs=120.0)
    assert any("the fit was given the record up to 1.8 h" in note for note in found.notes)


def test_a_second_effect_that_the_fit_would_see_the_first_minutes_of_is_seen_for_half_of_its_time(
    brisk: Bench, brisk_healthy: Columns
) -> None:
    """Heat begins at 87 % of the record, beside a thermometer that errs by far more: nine tenths show little of it."""
    warmed = brisk.with_element("heat", {**HEAT, "power": 60.0})
    record = brisk.record(16.0, changed=warmed, onset_h=13.9)
    record.measured[record.time_s > 9.8 * HOUR, brisk.network.sensor_names.index("T_tank_C")] += 1.1
    found = diagnose(brisk.network, record, brisk_healthy)
    assert {(e.kind, e.where) for e in found.effects} == {("heat_source", "modules"), ("sensor", "T_tank_C")}
    heat = next(e for e in found.effects if e.kind == "heat_source")
    assert heat.value == pytest.approx(60.0, rel=0.05) and heat.onset_s == pytest.approx(13.9 * HOUR, abs=10.0)


@pytest.mark.parametrize("mass_h", [7.0, 0.0])
def test_a_lesser_mass_is_told_beside_heat(pair: Bench, pair_healthy: Columns, mass_h: float) -> None:
    record = heat_then_mass(pair, 3.0, mass_h)
    grid = on_grid(pair.network, record.time_s, record.inputs, record.measured)
    split_search = SplitSearch.of(pair.network, record, basis(pair.network, pair_healthy, grid), grid, lambda _: None)
    told = searched(split_search.part(grid.part(0, int(0.75 * len(grid.time))))).reported
    assert told is not None
    assert {(e.candidate.kind, e.candidate.where) for e in told.entries} == {
        ("heat_source", "modules"),
        ("thermal_mass", "tank"),
    }


@pytest.mark.parametrize(("onset_h", "verdict"), [(6.0, "effect found"), (0.0, "adequate")])
def test_a_short_lag_is_told_where_it_came_in(bench: Bench, healthy: Columns, onset_h: float, verdict: str) -> None:
    """A lumped twin may seem to lack as much all along."""
    later = bench.with_values(T_heater_C__lag_s=15.0)
    found = diagnose(bench.network, bench.record(16.0, seed=4, changed=later, onset_h=onset_h), healthy)
    assert found.verdict == verdict
    assert [(e.kind, e.where, e.driver) for e in found.effects] == (
        [("sensor", "T_heater_C", "rate_of_change")] if found.effects else []
    )


@pytest.mark.parametrize("onset_h", [0.0, 5.0])
def test_a_hose_of_some_litres_is_found_though_its_score_promises_nothing(
    brisk: Bench, brisk_healthy: Columns, onset_h: float
) -> None:
    hose = brisk.with_element("hose", {"kind": "pipe", "to": "modules", "volume": 5.0})
    record = brisk.record(16.0, seed=6, changed=hose, onset_h=onset_h)
    grid = on_grid(brisk.network, record.time_s, record.inputs, record.measured)
    known = basis(brisk.network, brisk_healthy, grid, sample_period(record.time_s))
    found = searched(SplitSearch.of(brisk.network, record, known, grid, lambda _: None).part(grid)).reported
    assert found is not None
    (entry,) = found.entries
    assert (entry.candidate.kind, entry.candidate.where) == ("delay", "modules")
    assert entry.size == pytest.approx(5.0, rel=0.1)
    assert entry.shape.onset_s == pytest.approx(HOUR * onset_h, abs=HOUR / 4)


def test_much_of_a_bypass_is_tried_whatever_a_little_of_it_explains(pair: Bench, pair_healthy: Columns) -> None:
    """Modules without water are not only warmer, but slower; to first order they are warmer alone."""
    much = pair.with_element("bypass", {"kind": "bypass", "around": ["modules"], "fraction": 0.95})
    record = pair.record(12.0, seed=3, changed=much, onset_h=5.0)
    grid = on_grid(pair.network, record.time_s, record.inputs, record.measured)
    part = Part.of(basis(pair.network, pair_healthy, grid, sample_period(record.time_s)), grid)
    at_modules = [(law, e) for law, e in part.large_losses if law.candidate.where == "modules"]
    assert [e.size for _, e in at_modules] == pytest.approx([0.5, 0.9])
    begun = {e.shape.onset_s: e.log_occam for e in part.nonlinear_starts(4500.0) if e.candidate.where == "modules"}
    assert begun[4500.0] < begun[0.0] < 0.0  # any of many onsets is rarer than the beginning
    by_simulation = max(gains(part, [e for _, e in at_modules]))
    assert by_simulation > 1.1 * max(e.gain for _, e in at_modules)
    found = diagnose(pair.network, record, pair_healthy)
    (effect,) = found.effects
    assert (effect.kind, effect.where) == ("flow", "modules")
    assert effect.value == pytest.approx(0.95, abs=0.01)


def test_a_pump_that_loses_nearly_all_of_its_flow_is_named(pair: Bench, pair_healthy: Columns) -> None:
    """In a loop of two volumes the water that passes by the one is as lost as that which the pump no longer moves."""
    worn = pair.with_element("pump", {"kind": "actuator", "column": "pump_speed_pct", "gain": 0.12})
    record = pair.record(12.0, seed=3, changed=worn, onset_h=5.0)
    (effect,) = (found := diagnose(pair.network, record, pair_healthy)).effects
    assert (effect.kind, effect.where) in {("flow", "modules"), ("flow", "loop"), ("actuator", "pump_speed_pct")}
    assert abs(effect.value) == pytest.approx(0.88, abs=0.01)
    assert all(e.after < 1.15 * e.noise for e in found.errors.values())


@pytest.mark.parametrize("onset_h", [6.0, 0.0])
def test_without_a_healthy_record_what_is_late_is_told_only_where_it_came_in(pair: Bench, onset_h: float) -> None:
    """However large: how much of it a twin of mixed volumes leaves all along nobody has said."""
    later = pair.with_values(T_modules_C__lag_s=60.0)
    found = diagnose(pair.network, pair.record(16.0, seed=4, changed=later, onset_h=onset_h))
    told = {(e.kind, e.where, e.driver) for e in found.effects}
    assert (("sensor", "T_modules_C", "rate_of_change") in told) == (onset_h > 0.0)
