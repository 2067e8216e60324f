"""A twin that has taken up an effect is asked again: nothing is in its own way, and what has changed since is told."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.discovery.conftest import Bench
from tests.twin.conftest import LOOP
from twin.discovery.effects.catalogue import catalogue, extended, sized
from twin.discovery.engine import diagnose
from twin.discovery.healthy.basis import CommissionedRecord
from twin.discovery.healthy.health import NotHealthyError
from twin.elements.candidates import Candidate
from twin.network import Network
from twin.twinfile import load

ADOPTED = {
    "heat_by_fan_speed_tank_straight": (
        {"kind": "heat_source", "node": "tank", "driver": "fan_speed_pct", "law": "linear", "gain": 0.45},
        {"gain": 0.9},
        ("heat_source", "tank", "fan_speed"),
    ),
    # A lag of zero is left out of the formulas of a twin.
    "actuator_of_heater_power_W": (
        {"kind": "actuator", "column": "heater_power_W", "gain": 0.95},
        {"lag_s": 150.0},
        ("actuator", "heater_power", "history"),
    ),
}


def every_form(candidates: tuple[Candidate, ...]) -> Iterator[Candidate]:
    """Yield one candidate of each set of elements and parameters; others differ by weights alone."""
    found: dict[object, Candidate] = {}
    for candidate in candidates:
        for form in (candidate, *(candidate.near() if candidate.near is not None else ())):
            found.setdefault((form.kind, form.where, form.driver, *form.adds, *form.changes), form)
    yield from found.values()


def taken_up(network: Network, candidate: Candidate) -> Network:
    bigger = extended(network, candidate)
    return bigger.with_values(sized(bigger, candidate, candidate.typical))


def test_whatever_a_twin_took_up_may_change_and_nothing_further_is_named_as_it() -> None:
    network = load(LOOP)
    silent = []
    stays = tuple(c for c in catalogue(network) if not c.is_event)  # what passes is not taken up
    for candidate in every_form(stays):
        own = taken_up(network, candidate)
        offered = tuple(every_form(catalogue(own)))
        for further in offered:
            extended(own, further)
        if not any(set(c.changes) & set(candidate.changes) for c in offered if not c.adds):
            silent.append(candidate.id)
    assert silent == []


@pytest.mark.parametrize("name", ADOPTED)
def test_an_effect_that_grows_after_it_was_adopted_is_told(brisk: Bench, name: str) -> None:
    table, later, (kind, where, driver) = ADOPTED[name]
    own = brisk.of(brisk.with_element(name, table))
    more = brisk.with_element(name, {**table, **later})
    healthy = own.record(10.0, seed=7)
    assert diagnose(own.network, own.record(16.0), healthy).verdict == "adequate"
    answer = diagnose(own.network, own.record(16.0, 1, more, onset_h=5.0), healthy)
    assert [(e.kind, e.where, e.driver) for e in answer.effects] == [(kind, where, driver)]


def test_a_healthy_record_from_before_an_adoption_is_read_by_the_twin_of_then(pair: Bench) -> None:
    own = pair.with_element("heat", {"kind": "heat_source", "node": "modules", "power": 120.0})
    good, later = pair.record(10.0, seed=7), pair.of(own).record(16.0)
    with pytest.raises(NotHealthyError, match="does not fit the twin"):
        diagnose(own, later, good)
    before = CommissionedRecord(good.time_s, good.inputs, good.measured, before=(pair.network,))
    answer = diagnose(own, later, before)
    assert answer.verdict == "adequate"
    (note,) = (note for note in answer.notes if "before the twin's last changes" in note)
    # Heat at one module alone changes how the modules differ, and no healthy record knows that.
    assert "single thermometers of T_modules_C" in note
    # The whole record of the rig without what was taken up: the effect is gone.
    gone = diagnose(own, pair.record(16.0), before)
    assert [(e.kind, e.where, e.change) for e in gone.effects] == [("heat_source", "modules", "existing")]
    assert gone.effects[0].value == pytest.approx(-120.0, rel=0.03)


def test_heat_that_was_taken_for_constant_is_not_believed_where_it_follows_the_fan(brisk: Bench) -> None:
    """Two laws at one place are one thing; the place, and what it follows, are told."""
    own = brisk.with_element("heat", {"kind": "heat_source", "node": "tank", "power": 60.0})
    truth = brisk.with_element(
        "fan", {"kind": "heat_source", "node": "tank", "driver": "fan_speed_pct", "law": "cubed", "power_100": 120.0}
    )
    answer = diagnose(own, brisk.of(truth).record(12.0), brisk.of(own).record(10.0, seed=7))
    assert answer.verdict == "effect found" and answer.network is None
    (unknown,) = answer.effects
    assert (unknown.where, unknown.driver) == ("tank", "fan_speed") and unknown.shape == "own course"
