"""Records with something in them, or nothing: what the diagnosis says of each."""

import re
from dataclasses import replace

import numpy as np
import pytest

from tests.discovery.conftest import HOUR, Bench, stopped
from tests.same_questions import diagnose
from twin.discovery.engine import foresee
from twin.discovery.healthy.basis import Columns
from twin.discovery.records.standstill import standstill
from twin.kernel import Kernel
from twin.network import TwinFileError

HEATED = ("heat_source", "modules", "constant")


def test_a_healthy_record_is_adequate(pair: Bench, pair_healthy: Columns) -> None:
    found = diagnose(pair.network, pair.record(), pair_healthy)
    assert found.verdict == "adequate" and not found.effects and found.network is None
    assert all(e.after < 1.1 * e.noise for e in found.errors.values())


def test_what_is_usual_in_a_part_follows_how_much_the_rig_moves_there(pair: Bench, pair_healthy: Columns) -> None:
    steady = pair.record(16.0)
    found = diagnose(pair.network, steady, pair_healthy)
    assert all(0.3 * e.noise < e.usual < 3.0 * e.noise for e in found.errors.values())
    unknown = diagnose(pair.network, steady)
    assert all(e.usual == 0.0 for e in unknown.errors.values())


def test_heat_in_the_modules_is_named_sized_and_dated(slow_pair: Bench, slow_pair_healthy: Columns) -> None:
    record = slow_pair.record(changed=slow_pair.with_values(modules_power__power=120.0), onset_h=5.0)
    found = diagnose(slow_pair.network, record, slow_pair_healthy)
    (effect,) = found.effects
    assert found.verdict == "effect found"
    assert (effect.kind, effect.where, effect.driver, effect.change) == ("heat_source", "modules", "constant", "new")
    assert effect.value == pytest.approx(120.0, rel=0.05) and effect.interval90[0] < 120.0 < effect.interval90[1]
    assert abs(effect.onset_s - 5.0 * 3600.0) < 300.0
    assert "give off" in found.summary and "5 h 00 min" in found.summary
    # On the part that no fit saw, re-tuning alone does not do what the term does.
    worst = found.errors["T_modules_C"]
    assert worst.after < 1.15 * worst.noise < worst.before < worst.stale
    assert found.network is not None and found.network.parameters["modules_power.power"].value == effect.value


@pytest.mark.parametrize(
    ("law", "size", "said"), [("cubed", "power_100", "with its cube"), ("linear", "gain", "in proportion to it")]
)
def test_heat_that_follows_a_fan_is_told_in_its_own_form(
    pair: Bench, pair_healthy: Columns, law: str, size: str, said: str
) -> None:
    """Said in the other form, it would take a second cause to make up for what that one leaves."""
    table = {"kind": "heat_source", "node": "tank", "driver": "fan_speed_pct", "law": law}
    value = 45.0 if law == "cubed" else 0.45
    found = diagnose(
        pair.network, pair.record(16.0, 1, pair.with_element("belt", {**table, size: value})), pair_healthy
    )
    (effect,) = found.effects
    assert (effect.kind, effect.where, effect.driver, effect.unit) == ("heat_source", "tank", "fan_speed", "W")
    assert effect.value == pytest.approx(45.0, rel=0.1) and said in effect.says
    assert found.network is not None
    (added,) = [e for e in found.network.elements if e.name not in {o.name for o in pair.network.elements}]
    assert found.network.parameters[f"{added.name}.{size}"].value == pytest.approx(value, rel=0.1)


def test_a_moved_parameter_is_not_called_a_new_effect(pair: Bench, pair_healthy: Columns) -> None:
    record = pair.record(changed=pair.with_values(tank_loss__hA=8.5), onset_h=4.0)
    (effect,) = diagnose(pair.network, record, pair_healthy).effects
    assert (effect.kind, effect.where, effect.change) == ("heat_loss", "tank", "existing")
    assert effect.value == pytest.approx(6.0, rel=0.1)


def test_a_late_thermometer_is_never_early(pair: Bench, pair_healthy: Columns) -> None:
    """Re-tuning may ask for a negative lag; there is none."""
    record = pair.record(changed=pair.with_values(T_tank_C__lag_s=60.0))
    found = diagnose(pair.network, record, pair_healthy)
    (effect,) = found.effects
    assert (effect.kind, effect.where, effect.driver) == ("sensor", "T_tank_C", "rate_of_change")
    assert effect.value == pytest.approx(60.0, rel=0.15)


def test_a_heater_that_follows_late_is_named(pair: Bench, pair_healthy: Columns) -> None:
    """A lag is an element that remembers; its law is not that of the same element's gain."""
    late = pair.with_element("late", {"kind": "actuator", "column": "heater_power_W", "lag_s": {"value": 60.0}})
    (effect,) = diagnose(pair.network, pair.record(10.0, changed=late), pair_healthy).effects
    assert (effect.kind, effect.where, effect.driver) == ("actuator", "heater_power", "history")
    assert effect.value == pytest.approx(60.0, rel=0.15)


def test_what_is_there_from_the_beginning_is_not_left_to_tunables_beside_another_effect(
    bench: Bench, healthy: Columns
) -> None:
    """A small error of the heater's gain, which tunables far from commissioning would nearly take on.

    A heater that gives less than its reading says is one that takes up heat in proportion to it.
    """
    weaker = Bench(bench.with_values(heater_power__factor=0.99))
    record = weaker.record(seed=4, changed=weaker.with_values(modules_loss__hA=1.3), onset_h=2.0)
    found = diagnose(bench.network, record, healthy)
    sizes = {(e.kind, e.where): (e.value, e.onset_s) for e in found.effects}
    assert sizes.pop(("heat_loss", "modules")) == pytest.approx((0.3, 7200.0), rel=0.05)
    ((place, (gain, onset_s)),) = sizes.items()
    assert place in {("actuator", "heater_power"), ("heat_source", "heater")}
    assert gain == pytest.approx(-0.01, rel=0.1) and onset_s < 900.0


def test_beside_heat_that_is_there_at_once_a_lesser_effect_is_told(pair: Bench, pair_healthy: Columns) -> None:
    record = pair.record(changed=pair.with_values(modules_power__power=150.0), onset_h=3.0)
    j = pair.network.sensor_names.index("T_tank_C")
    error = np.where(record.time_s >= 6.0 * HOUR, 0.4, 0.0)[:, None] * np.eye(len(record.measured[0]))[j]
    found = diagnose(pair.network, replace(record, measured=record.measured + error), pair_healthy)
    assert {(e.kind, e.where) for e in found.effects} == {("heat_source", "modules"), ("sensor", "T_tank_C")}


def test_a_loss_that_changes_twice_is_told_twice(brisk: Bench, brisk_healthy: Columns) -> None:
    """As on a rig whose cooler is cleaned in two steps. The room was not measured but assumed."""
    network, room = brisk.network, brisk.network.input_columns.index("T_ambient_C")
    t, u = brisk.inputs(16.0, 4)
    u[:, room] = 22.0
    more = [network, *(network.with_values({"tank_loss.hA": hA}) for hA in (5.0, 9.0))]
    cuts = [0, *(int(np.searchsorted(t, hours * HOUR)) for hours in (4.0, 9.0)), len(t) - 1]
    state, read = np.array(brisk.start_C), []
    for rig, first, last in zip(more, cuts[:-1], cuts[1:], strict=True):
        y, ends = Kernel(rig, ()).trace(rig.values, state, t[first : last + 1], u[first : last + 1])
        read.append(y[0][: last - first])
        state = ends[0][: len(network.nodes)]
    measured = np.vstack(read)
    measured += network.sigma * np.random.default_rng(1).normal(0.0, 1.0, measured.shape)
    still = brisk_healthy.inputs.copy()
    still[:, room] = 22.0
    y, _ = Kernel(network, ()).trace(network.values, brisk_healthy.measured[0], brisk_healthy.time_s, still)
    known = y[0] + network.sigma * np.random.default_rng(2).normal(0.0, 1.0, y[0].shape)
    found = diagnose(
        network,
        Columns(t[: len(measured)], u[: len(measured)], measured),
        replace(brisk_healthy, inputs=still, measured=known),
    )
    assert [(e.kind, e.where) for e in found.effects] == 2 * [("heat_loss", "tank")]
    sizes = sorted((e.onset_s / HOUR, e.value) for e in found.effects)
    before = network.parameters["tank_loss.hA"].value
    assert sizes[0] == pytest.approx((4.0, 5.0 - before), rel=0.02)
    assert sizes[1] == pytest.approx((9.0, 4.0), rel=0.02)
    assert found.network is not None and found.network.parameters["tank_loss.hA"].value == pytest.approx(9.0, rel=0.02)
    assert all(a.where != "T_ambient_C" for a in (*found.indistinguishable, *found.alternatives))


def test_two_things_at_one_moment_are_one_cause_that_no_law_describes(brisk: Bench, brisk_healthy: Columns) -> None:
    both = brisk.with_values(modules_power__power=150.0, T_tank_C__bias_K=2.0)
    found = diagnose(brisk.network, brisk.record(changed=both, onset_h=3.0), brisk_healthy)
    assert found.verdict == "unexplained" and found.network is None
    assert any(re.search("both begin at 2[23] min: one cause that no law", note) for note in found.notes)


def test_what_one_leaves_at_its_own_beginning_may_be_its_form(brisk: Bench, brisk_healthy: Columns) -> None:
    """A second effect that begins with the first, and adds little beside it, is a note."""
    both = brisk.with_values(modules_power__power=150.0, T_tank_C__bias_K=0.1)
    found = diagnose(brisk.network, brisk.record(changed=both, onset_h=3.0), brisk_healthy)
    assert [(e.kind, e.where) for e in found.effects] == [("heat_source", "modules")]
    assert found.effects[0].value == pytest.approx(150.0, rel=0.1)
    assert any(re.search("both begin at 2[1-3] min: one cause is likelier", note) for note in found.notes)


def test_beside_lost_rejection_a_lesser_effect_is_told_by_its_own_beginning(
    brisk: Bench, brisk_healthy: Columns
) -> None:
    ua = brisk.network.parameters["fins.UA_100"].value
    record = brisk.record(changed=brisk.with_values(fins__UA_100=0.94 * ua), onset_h=3.0)
    error = np.where(record.time_s >= 8.0 * HOUR, 0.12, 0.0)[:, None] * np.array([0.0, 0.0, 0.0, 1.0])
    found = diagnose(brisk.network, replace(record, measured=record.measured + error), brisk_healthy)
    first, second = sorted(found.effects, key=lambda e: e.onset_s)
    # A fan that turns slower is the same on every record.
    same = {(a.kind, a.where) for a in found.indistinguishable} | {(first.kind, first.where)}
    assert same >= {("heat_rejection", "radiator"), ("actuator", "fan_speed")}
    told = [{(a.kind, a.where, a.driver) for a in part} for part in (found.indistinguishable, found.alternatives)]
    assert not told[0] & told[1]  # what a record excludes is not alike in it
    assert (second.kind, second.where) == ("sensor", brisk.network.sensor_names[3])
    assert second.onset_s == pytest.approx(8.0 * HOUR, abs=HOUR / 4)


def test_what_no_candidate_can_be_is_named_by_its_place_and_not_adopted(brisk: Bench, brisk_healthy: Columns) -> None:
    """Heat for two times of different length: no candidate comes again so."""
    heated = brisk.with_element("heat", {"kind": "heat_source", "node": "tank", "power": 150.0})
    record = brisk.record(24.0, changed=heated, onset_h=4.0, until_h=9.0)
    again = brisk.record(24.0, changed=heated, onset_h=13.0, until_h=16.0)
    plain = brisk.record(24.0)
    record = replace(record, measured=record.measured + again.measured - plain.measured)
    heard: list[str] = []
    found = diagnose(brisk.network, record, brisk_healthy, say=heard.append)
    assert found.verdict == "ambiguous" and found.network is None
    # More of the record would not make it fit, so it is searched at most to its end.
    assert heard.count("re-tuning") <= 3
    (effect,) = found.effects
    assert (effect.kind, effect.where, effect.shape) == ("heat_source", "tank", "own course")
    assert found.courses[0].site == "tank" and found.courses[0].unit == "W"
    during = (found.courses[0].hours > 5.0 * HOUR / 3600.0) & (found.courses[0].hours < 8.0 * HOUR / 3600.0)
    assert found.courses[0].mean[during].mean() == pytest.approx(150.0, rel=0.25)


def test_gaps_irregular_stamps_and_a_dead_thermometer_do_not_matter(pair: Bench, pair_healthy: Columns) -> None:
    record = pair.record(changed=pair.with_values(modules_power__power=120.0), onset_h=5.0)
    rng = np.random.default_rng(3)
    keep = rng.random(len(record.time_s)) < 0.6
    keep[500:550] = False
    measured = record.measured.copy()
    measured[:, 1] = np.nan
    torn = Columns(record.time_s[keep], record.inputs[keep], measured[keep])
    found = diagnose(pair.network, torn, pair_healthy)
    assert [(e.kind, e.where) for e in found.effects] == [("heat_source", "modules")]
    assert "T_tank_C" not in found.errors


def test_a_record_with_a_gap_needs_no_healthy_one(brisk: Bench) -> None:
    """Nobody knows the state at the beginning, nor at the gap's end."""
    record = brisk.record(changed=brisk.with_values(modules_power__power=150.0), onset_h=5.0)
    keep = np.ones(len(record.time_s), dtype=bool)
    keep[500:550] = False
    torn = Columns(record.time_s[keep], record.inputs[keep], record.measured[keep])
    found = diagnose(brisk.network, torn)
    assert [(e.kind, e.where) for e in found.effects] == [("heat_source", "modules")]
    assert found.effects[0].value == pytest.approx(150.0, rel=0.1)


def test_a_change_inside_the_held_out_part_is_noticed_and_said(pair: Bench, pair_healthy: Columns) -> None:
    record = pair.record(changed=pair.with_values(modules_power__power=150.0), onset_h=13.0)
    found = diagnose(pair.network, record, pair_healthy)
    assert found.effects and found.effects[0].where == "modules"
    assert any("inside the part" in note for note in found.notes)


def test_a_thermometer_that_stands_still_is_named_and_left_out(pair: Bench, pair_healthy: Columns) -> None:
    record = pair.record()
    measured = record.measured.copy()
    measured[625:1125, 1] = measured[625, 1]
    found = diagnose(pair.network, replace(record, measured=measured), pair_healthy)
    assert [(e.kind, e.where) for e in found.effects] == [("sensor", "T_tank_C")]
    assert "stands still" in found.summary


def test_one_that_stands_still_from_time_to_time_is_told_once(slow_pair: Bench, slow_pair_healthy: Columns) -> None:
    record = slow_pair.record()
    measured = record.measured.copy()
    for first in (2000, 5000, 8000):
        measured[first : first + 720, 1] = measured[first, 1]
    found = diagnose(slow_pair.network, replace(record, measured=measured), slow_pair_healthy)
    assert [(e.kind, e.where) for e in found.effects] == [("sensor", "T_tank_C")]
    assert "from 2 h 47 min to 3 h 47 min, and 2 more until 12 h 07 min, for 3 h 00 min in all" in found.summary


def test_a_tank_that_holds_less_water_is_a_mass_that_is_gone(brisk: Bench, brisk_healthy: Columns) -> None:
    lost = 0.15
    held = brisk.network.parameters["tank.capacitance"].value
    record = brisk.record(changed=brisk.with_values(tank__capacitance=(1.0 - lost) * held), onset_h=5.0)
    found = diagnose(brisk.network, record, brisk_healthy)
    assert found.verdict == "effect found"
    (gone,) = found.effects
    assert (gone.kind, gone.where) == ("thermal_mass", "tank")
    assert gone.value == pytest.approx(-lost * held, rel=0.1) and gone.onset_s == pytest.approx(
        5.0 * HOUR, abs=HOUR / 2
    )


def test_what_is_read_while_everything_stands_is_left_aside(pair: Bench, pair_healthy: Columns) -> None:
    found = diagnose(pair.network, stopped(pair.record()), pair_healthy)
    assert found.verdict == "adequate"
    (note,) = (n for n in found.notes if " stood for " in n)
    assert note.startswith(
        "pump and fan stood for 8.17 min in 2 periods (first at 0.7 h), as never in the healthy record"
    )
    heated = stopped(pair.record(changed=pair.with_values(modules_power__power=150.0), onset_h=3.0))
    (heat,) = diagnose(pair.network, heated, pair_healthy).effects
    assert (heat.kind, heat.where) == ("heat_source", "modules") and heat.value == pytest.approx(150.0, rel=0.05)


def test_what_stands_in_the_healthy_record_too_is_judged(pair: Bench, pair_healthy: Columns) -> None:
    record, known = stopped(pair.record()), pair_healthy.inputs.copy()
    assert standstill(pair.network, record.time_s, record.inputs, known).rows.sum() == 2 * (50 + 120)
    known[:60, :3] = 0.0
    assert not standstill(pair.network, record.time_s, record.inputs, known).rows.any()


def test_a_healthy_record_that_is_not_healthy_is_refused(pair: Bench) -> None:
    sick = pair.record(10.0, changed=pair.with_values(modules_power__power=300.0), onset_h=2.0)
    with pytest.raises(TwinFileError, match="does not fit the twin"):
        diagnose(pair.network, pair.record(), sick)


@pytest.mark.parametrize(("first_pct", "words"), [(0.0, "fan stood for"), (6.0, "fan turned too slowly for")])
def test_a_rig_that_starts_from_rest_gives_no_alarm(
    bench: Bench, healthy: Columns, first_pct: float, words: str
) -> None:
    """Half an hour with little fan, of which no twin knows how warm it leaves the water: it begins after that."""
    t, u = bench.inputs(10.0, 3)
    n = int(np.searchsorted(t, 1800.0))
    u[:n, 2] = first_pct
    still = bench.with_values(fins__UA_still=30.0)
    begun, ends = Kernel(still, ()).trace(still.values, np.full(4, 24.0), t[: n + 1], u[: n + 1])
    on, _ = Kernel(bench.network, ()).trace(bench.network.values, ends[0], t[n:], u[n:])
    y = np.vstack([begun[0][:n], on[0]])
    noise = bench.network.sigma * np.random.default_rng(8).normal(0.0, 1.0, y.shape)
    found = diagnose(bench.network, Columns(t, u, y + noise), healthy)
    assert found.verdict == "adequate", found.summary
    assert any(words in note for note in found.notes)


def test_a_diagnosis_begins_and_ends_where_the_inputs_are_known_and_says_so(pair: Bench, pair_healthy: Columns) -> None:
    record = pair.record(14.0)
    inputs = record.inputs.copy()
    inputs[record.time_s < 900.0, :3] = inputs[record.time_s > 12.8 * HOUR, :3] = np.nan
    found = diagnose(pair.network, replace(record, inputs=inputs), pair_healthy)
    assert found.verdict == "adequate" and found.held_out_s[1] <= 12.8 * HOUR
    assert "the inputs are unknown before 15 min: the diagnosis begins there" in found.notes
    assert "the inputs are unknown after 1 h 36 min: the diagnosis ends there" in found.notes


def test_without_a_healthy_record_a_large_effect_is_still_found_and_the_warning_given(brisk: Bench) -> None:
    record = brisk.record(changed=brisk.with_values(modules_power__power=150.0), onset_h=5.0)
    found = diagnose(brisk.network, record)
    assert found.warnings
    assert any(e.where == "modules" for e in found.effects)


def test_causes_that_no_input_can_separate_are_given_together(pair: Bench, pair_healthy: Columns) -> None:
    """A fan that turns slower and fins that conduct less are one and the same to every thermometer."""
    record = pair.record(changed=pair.with_values(fins__UA_100=50.0), onset_h=4.0)
    found = diagnose(pair.network, record, pair_healthy)
    kinds = {(e.kind, e.where) for e in found.effects} | {(a.kind, a.where) for a in found.indistinguishable}
    assert ("heat_rejection", "tank") in kinds
    spots = " ".join(found.blind_spots)
    assert ("actuator", "fan_speed") in kinds or "fan_speed" in spots


def test_the_document_keeps_the_contract(pair: Bench, pair_healthy: Columns) -> None:
    record = pair.record(changed=pair.with_values(modules_power__power=120.0), onset_h=5.0)
    document = diagnose(pair.network, record, pair_healthy).document()
    assert {"verdict", "effects", "indistinguishable", "alternatives", "error", "tunables_moved", "blind_spots"} <= set(
        document
    )
    assert set(document["error"]["sensors"]["T_tank_C"]) >= {"stale", "before", "after", "noise"}
    effect = document["effects"][0]
    assert {"kind", "where", "driver", "change", "value", "unit", "interval90", "onset_s", "confidence", "z"} <= set(
        effect
    )


def test_a_forecast_keeps_its_word(brisk: Bench, brisk_healthy: Columns) -> None:
    """An effect of four times the least size that was promised is found and named; one of a fifth of it is not."""
    plan = foresee(brisk.network, brisk.record(), brisk_healthy)
    least = next(s.least for s in plan.seen if (s.candidate.kind, s.candidate.where, s.candidate.driver) == HEATED)
    for share, seen in ((4.0, True), (0.2, False)):
        record = brisk.record(changed=brisk.with_values(modules_power__power=share * least))
        found = diagnose(brisk.network, record, brisk_healthy)
        assert (found.verdict != "adequate") == seen
        if seen:
            assert found.effects[0].where == "modules"
    alike = {(a.kind, b.kind) for a, b, _ in plan.confused}
    assert any("actuator" in pair for pair in alike)  # heater power and its gain, fan and fins
