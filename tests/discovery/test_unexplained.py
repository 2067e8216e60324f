"""What no candidate can be: what it is like, and the curve that is offered for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.discovery.conftest import HOUR, STEP_S, Bench
from twin.discovery import engine
from twin.discovery.answer.assessed_finding import AssessedFinding
from twin.discovery.answer.verdict import conclude
from twin.discovery.diagnosis import Course, Diagnosis, SensorError
from twin.discovery.engine import diagnose
from twin.discovery.evidence.held_out import contradicted
from twin.discovery.healthy.basis import Columns
from twin.discovery.places.localise import describe
from twin.kernel import Kernel


def test_water_that_flows_less_for_a_time_is_named_with_its_end(brisk: Bench, brisk_healthy: Columns) -> None:
    """A step, its opposite and a bend imitate a little less flow to within noise."""
    share = 0.95
    less = brisk.record(14.0, changed=brisk.with_values(circuit__factor=share), onset_h=4.0, until_h=8.0)
    found = diagnose(brisk.network, less, brisk_healthy)
    assert found.verdict in ("effect found", "ambiguous") and found.network is None
    (gone,) = found.effects
    assert (gone.kind, gone.where, gone.driver, gone.shape) == ("flow", "loop", "constant", "transient")
    assert gone.value == pytest.approx(share - 1.0, rel=0.05)
    assert gone.onset_s == pytest.approx(4.0 * HOUR, abs=HOUR / 12)
    assert gone.growth_s == pytest.approx(4.0 * HOUR, abs=HOUR / 12)
    assert "from 30 min to 1 h 0" in found.summary and "no longer" in found.summary
    # A pump that turns slower for a time is the same water.
    assert {(a.kind, a.where) for a in found.indistinguishable} <= {("flow", "loop"), ("actuator", "pump_speed")}


def test_a_heater_left_on_for_some_seconds_is_told_with_its_heat(brisk: Bench, brisk_healthy: Columns) -> None:
    hot = brisk.with_element("hot", {"kind": "heat_source", "node": "heater", "power": 700.0})
    found = diagnose(
        brisk.network, brisk.record(12.0, changed=hot, onset_h=5.0, until_h=5.0 + 20.0 / HOUR), brisk_healthy
    )
    (effect,) = found.effects
    assert (effect.kind, effect.where, effect.driver) == ("heat_source", "heater", "constant")
    assert effect.onset_s == pytest.approx(5.0 * HOUR, abs=30.0)
    assert effect.value * effect.growth_s == pytest.approx(700.0 * 20.0, rel=0.15)
    assert (
        f"for {effect.growth_s:.0f} s, and no longer; {effect.value * effect.growth_s / 1e3:.3g} kJ in all"
        in effect.says
    )


def test_what_lasts_is_not_said_to_have_ended(brisk: Bench, brisk_healthy: Columns) -> None:
    more = brisk.with_element("leak", {"kind": "heat_source", "node": "tank", "power": {"value": 40.0}})
    found = diagnose(brisk.network, brisk.record(14.0, changed=more, onset_h=5.0), brisk_healthy)
    assert found.verdict in ("effect found", "ambiguous")
    assert (found.effects[0].kind, found.effects[0].where) == ("heat_source", "tank")


def test_an_answer_that_the_held_out_part_contradicts_is_withdrawn(bench: Bench) -> None:
    """Squares count where the answer predicts a difference; what the twin leaves elsewhere does not contradict."""

    def off(before: float, after: float, usual: float = 0.0, moved: float = 0.5) -> SensorError:
        return SensorError(before, before, after, 0.05, (before, before, after), usual, moved)

    network, (one, other) = bench.network, bench.network.sensor_names[:2]
    assert contradicted({one: off(0.5, 0.4)}, network)
    assert not contradicted({one: off(2.0, 0.2)}, network)
    assert not contradicted({one: off(0.1, 0.1)}, network)  # within three times the noise
    assert not contradicted({one: off(2.0, 0.1), other: off(0.1, 0.2)}, network)
    # A drift of one sensor, while a new load leaves all of them off: told by that sensor alone.
    assert not contradicted({one: off(0.63, 0.41), other: off(0.42, 0.41, moved=0.02)}, network)
    assert contradicted({one: off(0.68, 0.66, moved=0.2), other: off(0.42, 0.1, moved=0.02)}, network)
    assert not contradicted({one: off(0.68, 0.68, moved=0.01)}, network)  # nothing predicted there
    # Where the rig moves more, its twin is usually off by more.
    assert not contradicted({one: off(0.5, 0.4, usual=0.3)}, network)
    assert contradicted({one: off(0.5, 0.4, usual=0.2)}, network)
    assert not contradicted({one: off(0.5, 0.4, usual=0.2, moved=0.1)}, network)  # no more than the usual error


def test_what_shows_in_the_held_out_part_alone_is_found(brisk: Bench, brisk_healthy: Columns) -> None:
    """A loss that grows from the beginning, seen at the end: the fit is given more of the record, which is said."""
    grown = brisk.record(16.0, noise=1.0)
    sized = brisk.record(
        16.0, changed=brisk.with_values(tank_loss__hA=brisk.network.parameters["tank_loss.hA"].value + 1.0)
    )
    share = np.clip(grown.time_s / grown.time_s[-1], 0.0, 1.0)[:, None] ** 16
    record = replace(grown, measured=grown.measured + share * (sized.measured - grown.measured))
    found = diagnose(brisk.network, record, brisk_healthy)
    assert found.verdict != "adequate"
    assert any("kept out of the fit" in note for note in found.notes)


def test_a_reading_that_is_off_now_and_then_is_told_from_heat_and_from_flow(pair: Bench, pair_healthy: Columns) -> None:
    record = pair.record(14.0)
    hours, measured = record.time_s / HOUR, record.measured.copy()
    measured[((hours > 3) & (hours < 5)) | ((hours > 7) & (hours < 8)) | ((hours > 9) & (hours < 12)), 1] += 0.8
    found = diagnose(pair.network, replace(record, measured=measured), pair_healthy)
    assert found.verdict == "effect found" and found.network is None
    (effect,) = found.effects
    assert (effect.kind, effect.where, effect.shape) == ("sensor", "T_tank_C", "own course")
    assert found.description["signature"] == "sensor" and "nothing is adopted" in found.summary


def odd_record(bench: Bench) -> Columns:
    """Heat at middle speeds of the fan only: no law of the catalogue, but the fan foretells it."""
    numbers = zip((50.0, 60.0, 70.0, 85.0, 100.0), (0.0, 40.0, 90.0, 40.0, 0.0), strict=True)
    knots = {
        f"{name}_{k + 1}": {"value": v} for k, pair in enumerate(numbers) for name, v in zip("xq", pair, strict=True)
    }
    odd = {"kind": "empirical_heat", "node": "tank", "driver": "fan_speed_pct", **knots}
    return bench.record(20.0, seed=2, changed=bench.with_element("odd", odd))


@pytest.fixture(scope="module")
def odd(brisk: Bench, brisk_healthy: Columns) -> tuple[Diagnosis, AssessedFinding]:
    """Its diagnosis, and what that was concluded from."""
    cases: list[AssessedFinding] = []

    def heard(case: AssessedFinding, notes: tuple[str, ...]) -> Diagnosis:
        cases.append(case)
        return conclude(case, notes)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(engine, "conclude", heard)
        return diagnose(brisk.network, odd_record(brisk), brisk_healthy), cases[0]


def test_heat_beyond_what_an_effect_can_hold_is_a_question_of_units(
    odd: tuple[Diagnosis, AssessedFinding], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("twin.discovery.places.empirical.MOST_HEAT_W", 50.0)
    found = conclude(odd[1], ())
    assert (found.verdict, found.empirical) == ("unexplained", None)
    (said,) = [note for note in found.notes if "contradicts the twin" in note]
    assert "W are missing at tank" in said and said.endswith("is fan_speed_pct in the unit of its name?")


def test_a_curve_is_offered_for_heat_that_follows_something_in_an_odd_way(
    odd: tuple[Diagnosis, AssessedFinding],
) -> None:
    found = odd[0]
    assert found.verdict == "effect found" and found.network is None  # offered, not adopted
    (effect,) = found.effects
    assert (effect.kind, effect.where, effect.driver) == ("heat_source", "tank", "fan_speed")
    assert "on a curve of fan_speed_pct" in found.summary and "offered, not adopted" in found.summary
    curve = found.empirical
    assert curve is not None and (curve.node, curve.variable) == ("tank", "fan_speed_pct")
    at = np.interp((50.0, 70.0, 100.0), curve.knots, curve.heats)
    assert at == pytest.approx((0.0, 90.0, 0.0), abs=6.0)
    for before, after in curve.errors.values():
        assert after < 0.5 * before
    assert curve.network.parameters["unexplained_at_tank.q_3"].value == curve.heats[2]
    assert found.document()["empirical"]["follows"] == "fan_speed_pct"


def test_a_radiator_is_named_before_the_rooms_thermometer_where_nothing_known_fits(
    brisk: Bench, brisk_healthy: Columns
) -> None:
    """Somebody's sprinkler cools the air at the radiator, now and then: as if the room's thermometer read too high."""
    record, network = brisk.record(20.0), brisk.network
    room, hours = network.input_columns.index("T_ambient_C"), record.time_s / HOUR
    wet = sum(
        np.where((hours > a) & (hours < b), k, 0.0) for a, b, k in ((3, 4, 2), (6, 8.5, 4), (10, 10.8, 1), (13, 17, 3))
    )
    cooled = record.inputs.copy()
    cooled[:, room] -= wet
    runs = [
        Kernel(network, ()).trace(network.values, record.measured[0], record.time_s, u)[0][0]
        for u in (cooled, record.inputs)
    ]
    raised = replace(record, measured=record.measured + runs[0] - runs[1])
    found = diagnose(network, raised, brisk_healthy)
    assert found.verdict == "ambiguous" and found.effects[0].where == "radiator"
    assert {a.where for a in found.indistinguishable} <= {"radiator", "fan_speed", "T_ambient_C"}
    assert found.description["there"]["sensor"] == "T_ambient_C"


def _unknown(mean: np.ndarray) -> Course:
    n = len(mean)
    return Course("tank", "K", np.arange(n) / 10.0, mean, np.full(n, 0.02), 900.0, "sensor", "T_tank_C")


def test_what_comes_and_goes_begins_with_its_first_time() -> None:
    """A loose contact of a minute in every forty is no less there before its worst hours."""
    rng = np.random.default_rng(12)
    mean = 0.005 * rng.normal(size=140)
    mean[40::7] -= 1.0
    mean[120::7] -= 1.5
    told = describe(_unknown(mean), {}, 0.1)
    low, high = told["onset_interval_s"]
    assert low <= 40 * 360.0 <= high
    assert told["onset_s"] == pytest.approx(40 * 360.0, abs=7 * 360.0)


def test_what_varies_alike_throughout_has_no_onset() -> None:
    told = describe(_unknown(np.sin(np.arange(140) / 3.0)), {}, 0.1)
    assert told["onset_s"] == 0.0 and told["onset_interval_s"] == [0.0, 0.0]


def test_a_valve_that_opens_as_nothing_recorded_does_is_no_sure_error_of_a_thermometer(
    brisk: Bench, brisk_healthy: Columns
) -> None:
    """Water passes the radiator by another share in each quarter of an hour."""
    rng = np.random.default_rng(31)
    t, u = brisk.inputs(16.0, 1)
    edges = np.append(np.searchsorted(t, np.arange(5.0 * HOUR, 16.0 * HOUR, 0.5 * HOUR)), len(t) - 1)
    parts, state, begun = [], np.array(brisk.start_C), 0
    for k, last in enumerate(edges.tolist()):
        share = float(rng.uniform(0.0, 0.5)) if k else 0.0
        table = {"kind": "bypass", "around": ["radiator"], "fraction": share}
        network = brisk.with_element("valve", table) if k else brisk.network
        read, ends = Kernel(network, ()).trace(network.values, state, t[begun : last + 1], u[begun : last + 1])
        parts.append(read[0][: last - begun])
        state, begun = ends[0][: len(network.nodes)], last
    y = np.vstack(parts)
    noise = brisk.network.sigma * np.random.default_rng(9).normal(0.0, 1.0, y.shape)
    found = diagnose(brisk.network, Columns(t[: len(y)], u[: len(y)], y + noise), brisk_healthy)
    told = {(e.kind, e.where) for e in found.effects} | {(a.kind, a.where) for a in found.indistinguishable}
    assert ("flow", "radiator") in told or found.verdict == "unexplained"
    assert found.verdict != "effect found" or {(e.kind, e.where) for e in found.effects} == {("flow", "radiator")}


def test_what_comes_again_in_the_held_out_part_is_no_single_spell(pair: Bench, pair_healthy: Columns) -> None:
    """Heat for three irregular times, of which the fitted part has one: a spell of less loss there is not all of it."""
    t, u = pair.inputs(16.0, 3)
    leak = pair.with_element("leak", {"kind": "heat_source", "node": "tank", "power": 15.0})
    cuts = [int(hour * HOUR / STEP_S) for hour in (0.0, 6.0, 6.8, 12.7, 13.1, 14.6, 15.2)]
    parts, state = [], np.array(pair.start_C)
    for k, (begun, end) in enumerate(zip(cuts, [*cuts[1:], len(t) - 1], strict=True)):
        network = leak if k % 2 else pair.network
        read, ends = Kernel(network, ()).trace(network.values, state, t[begun : end + 1], u[begun : end + 1])
        parts.append(read[0][: end - begun])
        state = ends[0][: len(network.nodes)]
    y = np.vstack(parts)
    noise = pair.network.sigma * np.random.default_rng(9).normal(0.0, 1.0, y.shape)
    found = diagnose(pair.network, Columns(t[: len(y)], u[: len(y)], y + noise), pair_healthy)
    (effect,) = found.effects
    assert effect.shape == "own course" and effect.where == "tank"
    others = {(a.kind, a.where) for a in found.indistinguishable}
    assert ("heat_source", "tank") in {(effect.kind, effect.where)} | others
