"""Weighing by evidence: integrals against quadrature, and records with laws that no catalogue names."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from tests.discovery.conftest import HOUR, Bench
from twin.discovery.diagnosis import Diagnosis, Effect
from twin.discovery.effects.catalogue import with_columns
from twin.discovery.effects.laws import CandidateLaw
from twin.discovery.effects.shapes import Shape
from twin.discovery.engine import diagnose
from twin.discovery.evidence.marginal import log_bayes_of_sizes, log_mass
from twin.discovery.evidence.part import Part
from twin.discovery.evidence.priors import SPREAD
from twin.discovery.evidence.split_search import coinciding
from twin.discovery.healthy.basis import Columns, basis
from twin.discovery.records.grid import on_grid
from twin.discovery.refit.fitting import covariance_of
from twin.discovery.scoring.search import Entry
from twin.discovery.scoring.sweep import Courses
from twin.elements.candidates import Candidate
from twin.kernel import Kernel
from twin.network import Array
from twin.revisions import with_elements

LAW = CandidateLaw(Candidate("heat_source", "tank", "constant", "new", {}, "W", 20.0, 0.0, 900.0, ""), None, None)


def heated(bench: Bench, course: Callable[[Array], Array]) -> Columns:
    """Return sixteen hours of the loop with heat of a course, W by seconds, in its tank."""
    return acted_on(bench, lambda t, u: course(t), {"kind": "law_heat", "node": "tank", "gain": 1.0})


def acted_on(
    bench: Bench,
    course: Callable[[Array, Array], Array],
    *tables: Mapping[str, object],
    off_s: tuple[float, float] = (0.0, 0.0),
) -> Columns:
    """Return sixteen hours of the loop with laws that follow a course of seconds and inputs; the heater is off within
    two times."""
    network = with_columns(bench.network, ["hidden_x"])
    laws = {f"hidden_{i}": {**table, "driver": "hidden_x", "form": "linear"} for i, table in enumerate(tables)}
    network = with_elements(network, laws)
    t, u = bench.inputs(16.0, 1)
    u[(t >= off_s[0]) & (t < off_s[1]), 0] = 0.0
    start = np.array(bench.start_C)
    read, _ = Kernel(network, ()).trace(network.values, start, t, np.column_stack([u, course(t, u)]))
    noise = bench.network.sigma * np.random.default_rng(101).normal(0.0, 1.0, read[0].shape)
    return Columns(t, u, read[0] + noise)


def misread(bench: Bench, sensor: str, error: Callable[[Columns], Array]) -> Columns:
    """Return a record whose sensor is off by an error, K."""
    record = bench.record()
    measured = record.measured.copy()
    measured[:, bench.network.sensor_names.index(sensor)] += error(record)
    return replace(record, measured=measured)


def only(found: Diagnosis) -> Effect:
    assert found.verdict == "effect found"
    (effect,) = found.effects
    return effect


@pytest.mark.parametrize(("low", "high"), [(-1.0, 2.0), (3.0, 4.0), (-9.0, -8.0), (8.0, np.inf), (-np.inf, np.inf)])
def test_a_probability_between_bounds_is_that_of_the_normal_law(low: float, high: float) -> None:
    expected = norm.logcdf(-low) if high == np.inf and low > 0.0 else np.log(norm.cdf(high) - norm.cdf(low))
    assert float(log_mass(np.array(low), np.array(high))) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(("top", "bottom"), [(3.0, 1.5), (-4.0, 0.7), (0.2, 4.0), (60.0, 4.0)])
@pytest.mark.parametrize("bounds", [(-120.0, 120.0), (0.0, 120.0), (-0.5, 0.4)])
def test_the_evidence_of_a_size_is_its_integral(top: float, bottom: float, bounds: tuple[float, float]) -> None:
    law = Candidate("heat_source", "tank", "constant", "new", {}, "W", 0.4, *bounds, "gives off {value}")
    size = float(np.clip(top / bottom, *bounds))
    shift = 0.5 * top**2 / bottom

    def mean_with(width: float) -> float:
        prior = norm(0.0, width)
        inside = prior.cdf(bounds[1]) - prior.cdf(bounds[0])
        height, _ = quad(
            lambda x: np.exp(top * x - 0.5 * bottom * x**2 - shift) * prior.pdf(x) / inside, *bounds, points=[size]
        )
        return float(np.log(height)) + shift

    usual = SPREAD * law.typical
    # A size of a greater order has a prior of its own width, which is less likely by as much.
    expected = mean_with(usual)
    if abs(size) > usual:
        expected = max(expected, mean_with(abs(size)) - np.log(abs(size) / usual))
    found, told = log_bayes_of_sizes(law, np.array(top), np.array(bottom))
    assert float(found) == pytest.approx(expected, abs=1e-6)
    assert bounds[0] <= float(told) <= bounds[1]


def test_a_size_of_a_hundred_typical_ones_costs_a_few_nats_and_not_its_square() -> None:
    law = Candidate(
        "heat_loss", "tank", "temperature_difference", "new", {}, "W/K", 1.0, -200.0, 200.0, "loses {value}"
    )
    squares = np.full(2, 25.0)
    (usual, large), sizes = log_bayes_of_sizes(law, np.array([4.0, 100.0]) * squares, squares)
    assert sizes == pytest.approx([4.0, 100.0], rel=0.01)
    gained = 0.5 * 25.0 * (100.0**2 - 4.0**2)
    assert large - usual == pytest.approx(gained - 2.0 * np.log(100.0 / SPREAD), abs=1.0)


@pytest.mark.parametrize(
    "shape",
    [
        Shape("transient", 700.0, 1900.0),
        Shape("periodic", 130.0, 900.0, 0.3),
        Shape("periodic", 2230.0, 900.0, 0.3, into_s=100.0),
        Shape("pulse", 400.0, 250.0),
    ],
)
def test_block_means_of_what_ends_are_its_average(shape: Shape) -> None:
    edges = np.linspace(0.0, 6000.0, 31)
    fine = np.linspace(0.0, 6000.0, 600_001)
    mean = [shape.block_means(np.array([a, b]))[0] for a, b in zip(edges[:-1], edges[1:], strict=True)]
    point = shape.block_means(fine)
    assert np.allclose(mean, point.reshape(30, -1).mean(axis=1), atol=1e-6)


@pytest.mark.parametrize("hours", [2.0, 3.0])
def test_a_record_of_a_few_blocks_has_no_room_for_an_interval(
    brisk: Bench, brisk_healthy: Columns, hours: float
) -> None:
    """Samples ten minutes apart: two and three blocks of an hour."""
    every = slice(None, None, 120)
    record = brisk.record(hours * 3600.0 / HOUR)
    coarse = Columns(*(np.ascontiguousarray(x[every]) for x in (record.time_s, record.inputs, record.measured)))
    found = diagnose(brisk.network, coarse, brisk_healthy)
    assert all(e.shape != "transient" for e in found.effects)


def test_a_reading_that_follows_heater_power_is_named_and_adopted(pair: Bench, pair_healthy: Columns) -> None:
    def error(record: Columns) -> Array:
        return np.where(record.time_s > 4.0 * HOUR, 8e-4 * record.inputs[:, 0], 0.0)

    found = diagnose(pair.network, misread(pair, "T_tank_C", error), pair_healthy)
    effect = only(found)
    assert (effect.kind, effect.where, effect.driver, effect.unit) == ("sensor", "T_tank_C", "heater_power", "K/W")
    assert effect.value == pytest.approx(8e-4, rel=0.02) and effect.onset_s == pytest.approx(4.0 * HOUR, abs=HOUR / 30)
    assert found.network is not None
    (law,) = [e for e in found.network.elements if e.kind == "law_reading"]
    assert found.network.parameters[f"{law.name}.gain"].value == pytest.approx(8e-4, rel=0.02)


def test_heat_that_came_and_went_is_named_with_both_ends(pair: Bench, pair_healthy: Columns) -> None:
    record = heated(pair, lambda t: 80.0 * ((t > 5.0 * HOUR) & (t < 8.0 * HOUR)))
    effect = only(diagnose(pair.network, record, pair_healthy))
    assert (effect.kind, effect.where, effect.shape) == ("heat_source", "tank", "transient")
    assert effect.value == pytest.approx(80.0, rel=0.02)
    assert (effect.onset_s, effect.growth_s) == pytest.approx((5.0 * HOUR, 3.0 * HOUR), abs=HOUR / 30)


def test_heat_that_comes_back_is_named_with_its_period(slow_pair: Bench, slow_pair_healthy: Columns) -> None:
    record = heated(slow_pair, lambda t: 80.0 * ((t % 5400.0) < 1800.0))
    found = diagnose(slow_pair.network, record, slow_pair_healthy)
    effect = only(found)
    assert (effect.kind, effect.where, effect.driver) == ("heat_source", "tank", "periodic")
    # Its state at the record's end, on or off, would be a wrong twin.
    assert found.network is None and any("not added to the twin" in note for note in found.notes)
    assert effect.value == pytest.approx(80.0, rel=0.03) and effect.growth_s == pytest.approx(5400.0, rel=0.01)


def test_heat_that_begins_to_come_back_amid_a_turn_is_one_effect(slow_pair: Bench, slow_pair_healthy: Columns) -> None:
    """The turns, of 47 minutes, are not those of any coarse grid, and the first one is cut by the onset."""
    on, period = 1100.0, 2820.0
    onset = 8.0 * period + 400.0
    record = heated(slow_pair, lambda t: 90.0 * (t > onset) * ((t % period) < on))
    effect = only(diagnose(slow_pair.network, record, slow_pair_healthy))
    assert (effect.kind, effect.where, effect.driver) == ("heat_source", "tank", "periodic")
    assert effect.value == pytest.approx(90.0, rel=0.05) and effect.growth_s == pytest.approx(period, rel=0.005)
    assert effect.onset_s == pytest.approx(onset, abs=180.0)


def test_periods_are_tried_as_close_as_the_record_tells_them(pair: Bench, pair_healthy: Columns) -> None:
    record = pair.record(10.0, seed=8)
    grid = on_grid(pair.network, record.time_s, record.inputs, record.measured)
    courses = Courses.of(Part.of(basis(pair.network, pair_healthy, grid), grid).score_test)
    shapes, columns, of = courses.turns
    coarse = next(shapes for shapes, _ in courses.by_name if shapes[0].name == "periodic")
    rates = np.unique([1.0 / s.growth_s for s in shapes])
    assert np.diff(rates).max() <= 1.0 / (2.9 * grid.span_s)
    assert columns.shape[1] == len(shapes) == len(of) and {s.duty for s in shapes} == {s.duty for s in coarse}
    assert all(s.duty == coarse[i].duty for s, i in zip(shapes, of, strict=True))


def test_two_effects_with_the_same_turns_are_no_two_faults() -> None:
    def back(period_s: float, onset_s: float = 0.0) -> Entry:
        return Entry(LAW, Shape("periodic", onset_s, period_s), np.empty(0), 1.0, 0.1, 0.0)

    span = 30.0 * 3600.0
    assert coinciding((back(4000.0), back(4020.0, 1500.0)), span, 15.0) is not None
    assert coinciding((back(4000.0), back(5000.0)), span, 15.0) is None
    assert coinciding((back(0.4 * span), back(0.41 * span)), span, 15.0) is None


@pytest.mark.parametrize(("sensor", "since_h", "until_h"), [("T_heater_C", 5.0, 9.0), ("T_radiator_C", 5.0, 12.0)])
def test_a_thermometer_that_sticks_is_told_with_its_level(
    brisk: Bench, brisk_healthy: Columns, sensor: str, since_h: float, until_h: float
) -> None:
    """Whatever error of gain resembles it as long as its level is not known."""
    record = brisk.record(16.0, seed=4)
    j = brisk.network.sensor_names.index(sensor)
    measured = record.measured.copy()
    first, last = (int(np.searchsorted(record.time_s, hours * HOUR)) for hours in (since_h, until_h))
    level = float(measured[first - 12 : first, j].mean())
    noise = brisk.network.sigma[j] * np.random.default_rng(3).normal(0.0, 1.0, last - first)
    measured[first:last, j] = level + noise
    found = diagnose(brisk.network, replace(record, measured=measured), brisk_healthy)
    effect = only(found)
    assert (effect.kind, effect.where, effect.unit, effect.shape) == ("sensor", sensor, "1", "transient")
    assert effect.value == pytest.approx(1.0, abs=0.05) and effect.onset_s == pytest.approx(since_h * HOUR, abs=60.0)
    told = re.search(rf"{sensor} sticks at ([0-9.]+) degC", found.summary)
    assert told is not None and float(told[1]) == pytest.approx(level, abs=0.1) == effect.level


def test_a_thermometer_at_another_place_reads_all_of_its_temperature(brisk: Bench, brisk_healthy: Columns) -> None:
    """A share of 1 is all that there is, and no size on a bound."""
    record = brisk.record(16.0, seed=4)
    tank, radiator = (brisk.network.sensor_names.index(name) for name in ("T_tank_C", "T_radiator_C"))
    measured, other = record.measured.copy(), brisk.record(16.0, seed=4, noise=0.0).measured[:, tank]
    noise = measured[:, radiator] - brisk.record(16.0, seed=4, noise=0.0).measured[:, radiator]
    moved = record.time_s > 6.0 * HOUR
    measured[moved, radiator] = (other + noise)[moved]
    found = diagnose(brisk.network, replace(record, measured=measured), brisk_healthy)
    effect = only(found)
    assert (effect.kind, effect.where, effect.driver) == ("sensor", "T_radiator_C", "temperature_difference")
    assert effect.value == pytest.approx(1.0, abs=0.05)


def test_a_pulse_of_heat_is_told_by_its_energy(slow_pair: Bench, slow_pair_healthy: Columns) -> None:
    record = heated(
        slow_pair, lambda t: 4e5 / 300.0 * np.exp(-np.maximum(t - 6.2 * 3600.0, 0.0) / 300.0) * (t > 6.2 * 3600.0)
    )
    effect = only(diagnose(slow_pair.network, record, slow_pair_healthy))
    assert (effect.kind, effect.where, effect.shape) == ("heat_source", "tank", "pulse")
    # Water of 60 degC that comes into the tank, of which a record tells no more than its heat.
    tank_C = float(np.interp(6.2 * 3600.0, record.time_s, record.measured[:, slow_pair.network.nodes.index("tank")]))
    per_unit = {"W": 1.0, "kg/s": 4180.0 * (60.0 - tank_C)}[effect.unit]
    assert per_unit * effect.value * effect.growth_s == pytest.approx(4e5, rel=0.1)


def test_two_effects_are_named_and_no_third(brisk: Bench, brisk_healthy: Columns) -> None:
    record = brisk.record(10.0, changed=brisk.with_values(tank_loss__hA=8.5), onset_h=2.0)
    later = np.where(record.time_s >= 4.0 * HOUR, 0.5, 0.0)[:, None]
    error = later * np.eye(len(brisk.start_C))[brisk.network.sensor_names.index("T_heater_C")]
    found = diagnose(brisk.network, replace(record, measured=record.measured + error), brisk_healthy)
    assert {(e.kind, e.where) for e in found.effects} == {("heat_loss", "tank"), ("sensor", "T_heater_C")}


def test_heat_into_a_solid_that_is_read_is_one_effect(pair: Bench, pair_healthy: Columns) -> None:
    """The water shows all of the heat, and the thermometer 0.01 K more for each watt."""
    hot = pair.with_values(modules_power__power=80.0, T_modules_C__bias_K=0.8)
    found = diagnose(pair.network, pair.record(changed=hot, onset_h=3.0), pair_healthy)
    effect = only(found)
    assert (effect.kind, effect.where, effect.driver) == ("heat_source", "modules", "constant")
    assert effect.value == pytest.approx(80.0, rel=0.05) and "into their solid part" in effect.says
    assert found.network is not None
    assert {e.kind for e in found.network.elements} >= {"law_heat", "law_reading"}


def test_heat_into_a_solid_in_proportion_to_heater_power_is_one_effect(pair: Bench, pair_healthy: Columns) -> None:
    """Water alone that takes up heater power is an element; a solid that does is another law at the same place."""
    record = acted_on(
        pair,
        lambda t, u: u[:, 0] * (t > 3.0 * HOUR),
        {"kind": "law_heat", "node": "modules", "gain": 0.1},
        {"kind": "law_reading", "sensor": "T_modules_C", "gain": 0.001},
    )
    effect = only(diagnose(pair.network, record, pair_healthy))
    assert (effect.kind, effect.where, effect.driver) == ("heat_source", "modules", "heater_power")
    assert effect.value == pytest.approx(0.1, rel=0.05) and "of heater power into their solid part" in effect.says


def test_power_that_moves_from_one_place_to_another_is_one_effect(brisk: Bench, brisk_healthy: Columns) -> None:
    moved = {"kind": "law_heat", "node": "tank", "source": "radiator", "gain": 1.0}
    effect = only(diagnose(brisk.network, acted_on(brisk, lambda t, u: 90.0 * (t > 5.0 * HOUR), moved), brisk_healthy))
    assert (effect.kind, effect.where, effect.driver) == ("heat_transfer", "radiator", "constant")
    assert (
        effect.value == pytest.approx(-90.0, rel=0.03)
        and "The radiator gives" in effect.says
        and "to tank" in effect.says
    )


def test_an_onset_within_a_rest_of_the_heater_is_told_to_be_within_it(
    slow_pair: Bench, slow_pair_healthy: Columns
) -> None:
    """Heat that follows heater power can have begun at any moment of a rest, and at none before or after it."""
    began, rest_s = 6.0 * 3600.0, 1800.0
    law = {"kind": "law_heat", "node": "tank", "gain": 0.1}
    record = acted_on(slow_pair, lambda t, u: u[:, 0] * (t >= began), law, off_s=(began, began + rest_s))
    effect = only(diagnose(slow_pair.network, record, slow_pair_healthy))
    early, late = effect.onset_interval90_s
    assert began - 600.0 < early <= began and began + rest_s <= late < began + rest_s + 600.0


def test_of_what_lasts_for_seconds_the_energy_is_told_and_not_the_power(pair: Bench, pair_healthy: Columns) -> None:
    """The record shows how much heat came in; how strong and how long it was stays open."""
    t, u = pair.inputs(14.0, 6)
    first = int(np.searchsorted(t, 6.0 * HOUR))
    wrong = u.copy()
    wrong[first : first + 2, 0] += 1500.0
    read, _ = Kernel(pair.network, ()).trace(pair.network.values, np.array(pair.start_C), t, wrong)
    noise = pair.network.sigma * np.random.default_rng(9).normal(0.0, 1.0, read[0].shape)
    (heat,) = diagnose(pair.network, Columns(t, u, read[0] + noise), pair_healthy).effects
    assert heat.where in {"modules", "heater_power"} and heat.onset_s == pytest.approx(6.0 * HOUR, abs=60.0)
    low, high = heat.interval90
    assert high - low > 0.5 * abs(heat.value)


def test_a_direction_of_which_a_record_says_nothing_is_as_wide_as_its_size() -> None:
    """Strength and length of a short spell, told by their product alone, beside a tunable that is told well."""
    energy = np.array([1.0 / 1500.0, 0.0, 1.0])
    normal = np.zeros((4, 4))
    normal[0, 0], normal[1:, 1:] = 1e4, 1e14 * np.outer(energy, energy)
    sd = np.sqrt(np.diag(covariance_of(normal, np.array([1.0, 1500.0, 1.0, 1.0]), (1, 2, 3), 10.0)))
    assert sd[0] == pytest.approx(0.01) and 500.0 < sd[1] < 1500.0 and 0.3 < sd[3] < 1.0
