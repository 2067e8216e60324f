"""What real records asked of growing (decision 0035): masses of the record's own time scales and two to a place, sets
that are asked whatever made them, members of a family that differ, sensors without a reading."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from tests.discovery.test_a_room import ROOM, WALL, lived_in
from tests.discovery.test_records import TWINS, added, heaters
from twin.discovery.diagnosis import SensorError
from twin.discovery.effects.catalogue import catalogue, sites_of
from twin.discovery.effects.phrases import said
from twin.discovery.evidence.held_out import leaves_more_squares, weights_unreliable
from twin.discovery.growing.answer import diagnose_grown
from twin.discovery.growing.beam import Beam, FittedSet, _finalists, likeliest
from twin.discovery.growing.growth import grow
from twin.discovery.growing.merit import Merit
from twin.discovery.growing.scoring import Scored
from twin.discovery.growing.superset.candidate_superset import unsized
from twin.discovery.growing.superset.equivalent_places import family_candidates, untied_losses
from twin.discovery.growing.superset.hidden_masses import masses, time_constants
from twin.discovery.healthy.basis import Columns
from twin.discovery.scoring.search import Entry
from twin.elements.candidates import Candidate
from twin.network import Network
from twin.revisions import with_elements
from twin.twinfile import load, parse

DAY_S = 86400.0


@pytest.fixture(scope="module")
def room() -> Network:
    return parse(ROOM)


def bare() -> Network:
    return load(TWINS / "tclab_bare.toml")


def a_set(candidates: list[Candidate], score: float, squares: float = 1.0) -> FittedSet:
    """A set with no fit behind it."""
    samples = SimpleNamespace(sigma=np.ones(1))
    fit = SimpleNamespace(
        entries=tuple(unsized(c, 1.0) for c in candidates), residual=np.array([math.sqrt(squares)]), cost=score
    )
    return FittedSet(SimpleNamespace(samples=samples), fit, score)  # type: ignore[arg-type]


def test_a_set_that_asking_has_fitted_is_asked_in_its_turn() -> None:
    """What is left of a set without a member that is not needed may be better than all that the beam had fitted."""
    one, other, *_ = (c for c in catalogue(bare()) if not c.replaces)
    empty, both, small = a_set([], 100.0), a_set([one, other], 10.0), a_set([one], 20.0)
    known = {s.ids: s for s in (empty, both)}
    rows = SimpleNamespace(samples=SimpleNamespace(time=np.arange(12)))

    class Asked(Merit):
        def _weakest(self, found: FittedSet) -> Entry | None:
            if found is both:
                known[small.ids] = small
                return both.fit.entries[1]
            return None

    beam = cast(Beam, SimpleNamespace(known=known, levels=[[empty], [both]], empty=rows))
    assert Asked(beam).earned() is small


def test_of_time_constants_the_one_that_leaves_least_is_taken() -> None:
    slow, slower = [c for c in masses(sites_of(bare()), 1.0, 600.0)[0] if "mass_beside_heater_1" in c.adds][:2]
    likely, close = a_set([slow], 10.0, 50.0), a_set([slower], 12.0, 20.0)
    assert likeliest([likely, close]) == [close]


def test_a_record_gives_the_time_constants_of_its_masses() -> None:
    house = time_constants(1800.0, 116.0 * 3600.0)
    assert 7200.0 <= house[0] < 13000.0 and 116.0 * 3600.0 < house[-1] <= 3.0 * 116.0 * 3600.0
    heater = time_constants(1.0, 600.0)
    assert 4.0 <= heater[0] < 8.0 and 600.0 < heater[-1] <= 1800.0
    # Every second of a day of seconds and every day of a month: a dozen each, not more for being long.
    assert len(time_constants(1.0, DAY_S)) < 22 and len(time_constants(DAY_S, 30 * DAY_S)) < 9


def test_a_second_mass_is_offered_beside_one_and_a_third_is_not(room: Network) -> None:
    found, after = masses(sites_of(room), 600.0, DAY_S)
    names = {name for c in found for name in c.adds}
    assert names == {"mass_beside_room", "mass_beside_room_2"} and after == {"mass_beside_room_2": "mass_beside_room"}
    walled = with_elements(room, {"wall": WALL})
    found, after = masses(sites_of(walled), 600.0, DAY_S)
    assert {name for c in found for name in c.adds} == {"mass_beside_room"} and not after
    found, _ = masses(sites_of(with_elements(walled, {"floor": WALL})), 600.0, DAY_S)
    assert not found
    slower = next(c for c in masses(sites_of(room), 600.0, DAY_S)[0] if "mass_beside_room_2" in c.adds)
    assert slower.slower is not None and set(slower.slower(5000.0).adds) == {"mass_beside_room_2"}


def test_a_mass_at_each_of_two_places_stays_at_both_when_it_is_slower() -> None:
    network = bare()
    found, _ = masses(sites_of(network), 1.0, 600.0)
    pair = next(c for c in family_candidates(network, sites_of(network), found) if c.slow_s)
    assert pair.slower is not None and set(pair.slower(33.0).adds) == {"mass_beside_heater_1", "mass_beside_heater_2"}


def test_two_masses_of_a_house_are_found(room: Network) -> None:
    floor = {"kind": "hidden_mass", "node": "room", "capacity": 4.0e7, "conductance": 400.0}
    found = diagnose_grown(room, lived_in(room, {"wall": WALL, "floor": floor}, seed=3), most=2)
    assert [(e.kind, e.where) for e in found.effects] == [("thermal_mass", "room")] * 2
    assert found.network is not None and found.verdict == "effect found"
    assert all(e.after < 2.0 * e.noise < 0.5 * e.before for e in found.errors.values())


def test_a_time_constant_is_told_in_seconds_minutes_or_as_longer_than_the_record(room: Network) -> None:
    first = masses(sites_of(room), 600.0, DAY_S)[0][0]
    assert first.slower is not None
    assert said(first.slower(23.0), 1.0).endswith("with a time constant of 23 s")
    assert said(first.slower(6000.0), 1.0, record_s=DAY_S).endswith("with a time constant of 100 min")
    assert said(first.slower(2.0 * DAY_S), 1.0, record_s=DAY_S).endswith("with a time constant longer than the record")


def test_variants_that_change_other_parameters_both_go_on() -> None:
    mixed = load(TWINS / "heated_pipe_mixed.toml")
    delays = [c for c in catalogue(mixed) if c.kind == "delay"]
    assert len(delays) == 2 and len({(c.where, c.driver, c.unit) for c in delays}) == 1
    scored = [Scored(unsized(c, 1.0), 1.0, float(i), float(i)) for i, c in enumerate(delays)]
    assert len(_finalists(scored)) == 2
    # Two sizes of one and the same are still one.
    assert len(_finalists([scored[0], replace(scored[0], squares=9.0)])) == 1


def test_one_of_two_heaters_that_are_tied_may_lose_more() -> None:
    network = bare()
    offered = untied_losses(network, sites_of(network))
    assert {(c.where, *c.adds) for c in offered} == {
        ("heater_1", "further_loss_of_heater_1"),
        ("heater_2", "further_loss_of_heater_2"),
    }
    differs = with_elements(network, {"more": {"kind": "ambient_loss", "node": "heater_1", "hA": 0.006}})
    found = grow(network, *heaters(differs, 4), most=1, beam=2)
    assert added(found) == [("heat_loss", "heater_1", "temperature_difference")]
    assert found.rungs[1].added is not None and found.rungs[1].added.value == pytest.approx(0.006, rel=0.15)


def test_a_sensor_without_a_reading_is_named_and_spoils_nothing() -> None:
    t, u, y = heaters(bare(), 0)
    y[:, 1] = np.nan
    found = diagnose_grown(bare(), Columns(t, u, y), most=1)
    assert found.verdict == "adequate" and set(found.errors) == {"T1_C"}
    assert any(w.startswith("T2_C has no reading") for w in found.warnings)


def test_what_is_worse_than_re_tuning_is_no_finding(room: Network) -> None:
    assert leaves_more_squares({"T_room_C": SensorError(3.0, 0.476, 0.593, 0.1)})
    assert not leaves_more_squares({"T_room_C": SensorError(3.0, 0.476, 0.4, 0.1)})
    # Both are noise.
    assert not leaves_more_squares({"T_room_C": SensorError(3.0, 0.02, 0.04, 0.05)})
    far = SensorError(2.26, 1.82, 85.7, 0.2, (2.26, 1.82, 85.7))
    assert weights_unreliable({"T_room_C": far}, room) and not weights_unreliable(
        {"T_room_C": replace(far, after=2.2)}, room
    )
