"""Laws that a twin lacked in health already are no change, as far as the healthy record says so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.discovery.conftest import Bench
from twin.discovery.effects.shapes import Shape
from twin.discovery.engine import diagnose
from twin.discovery.evidence.missing_in_health import _Columns, _possible, with_missing, with_usual
from twin.discovery.evidence.part import Part
from twin.discovery.healthy.basis import Basis, Columns, basis
from twin.discovery.records.grid import on_grid
from twin.discovery.scoring.search import Entry
from twin.kernel import Kernel

LAG_S = 60.0
"""Of the tank's thermometer, which the twin lacks; four times what a lumped twin is thought to lack anyway."""


def calm(bench: Bench, rig: Bench, hours: float = 10.0) -> Columns:
    """A healthy record in which the power stays, so that it hardly tells how late the thermometers are."""
    t, u = bench.inputs(hours, 7)
    u[:, 0] = 740.0
    return read(rig, t, u, seed=107)


def read(rig: Bench, t: np.ndarray, u: np.ndarray, seed: int) -> Columns:
    net = rig.network
    y, _ = Kernel(net, ()).trace(net.values, np.array([37.0, 36.8, 34.5, 34.0]), t, u)
    noise = net.sigma * np.random.default_rng(seed).normal(0.0, 1.0, y[0].shape)
    return Columns(t, u, y[0] + noise)


@pytest.fixture(scope="module")
def late(bench: Bench) -> Bench:
    """The rig, whose tank is read late."""
    return replace(bench, network=bench.with_values(T_tank_C__lag_s=LAG_S))


def known_of(bench: Bench, healthy: Columns, record: Columns) -> tuple[Basis, Part]:
    grid = on_grid(bench.network, record.time_s, record.inputs, record.measured)
    known = basis(bench.network, healthy, grid)
    return known, Part.of(known, grid)


def test_a_lag_that_the_healthy_record_leaves_open_is_no_change(bench: Bench, late: Bench) -> None:
    healthy, record = calm(bench, late), late.record(10.0, seed=4)
    found = diagnose(bench.network, record, healthy)
    assert found.verdict == "adequate"
    assert any("healthy record" in note and "T_tank_C" in note for note in found.notes), found.notes


def test_a_lag_that_the_healthy_record_rules_out_is_told(bench: Bench, late: Bench, healthy: Columns) -> None:
    found = diagnose(bench.network, late.record(10.0, seed=4), healthy)
    assert [(e.kind, e.where, e.driver) for e in found.effects] == [("sensor", "T_tank_C", "rate_of_change")]


@pytest.mark.parametrize("moving", [False, True])
def test_a_healthy_record_tells_a_lag_within_its_own_error(bench: Bench, late: Bench, moving: bool) -> None:
    healthy = late.record(10.0, seed=7) if moving else calm(bench, late)
    known, part = known_of(bench, healthy, late.record(16.0, seed=4))
    assert known.health is not None
    wanted = ("T_tank_C", "rate_of_change", 60.0)
    (lag,) = [c for law in part.laws if ((c := law.candidate).where, c.driver, c.typical) == wanted]
    told = known.health.amplitudes([lag], known.probe.scaling.ids)
    size, sd = told.score[0] / told.precision[0, 0], told.precision[0, 0] ** -0.5
    # To first order about no lag, which takes one of 60 s for some less.
    assert size == pytest.approx(LAG_S, abs=3.0 * sd + 0.2 * LAG_S)
    assert sd < 0.2 * LAG_S


def test_an_effect_that_begins_later_is_not_taken_for_what_was_missing(bench: Bench, late: Bench) -> None:
    """Heat since six hours, beside a lag that was there in health too: the heat is told, and it alone."""
    healthy = calm(bench, late)
    warmed = replace(late, network=late.with_element("heat", {"kind": "heat_source", "node": "modules", "power": 40.0}))
    found = diagnose(bench.network, late.record(16.0, seed=4, changed=warmed.network, onset_h=6.0), healthy)
    assert [(e.kind, e.where) for e in found.effects] == [("heat_source", "modules")]
    assert found.effects[0].value == pytest.approx(40.0, rel=0.1)


@pytest.mark.parametrize("told", [False, True])
def test_beside_a_large_effect_a_law_is_no_change_that_the_healthy_record_leaves_open(
    brisk: Bench, brisk_healthy: Columns, told: bool
) -> None:
    """Heat in the modules, and a heater that follows late: of steady power no healthy record tells how late.

    One of changing power does. Beside that one the heater has become late, and both are told.
    """
    late = brisk.of(brisk.with_element("late", {"kind": "actuator", "column": "heater_power_W", "lag_s": 40.0}))
    record = late.record(seed=4, changed=late.with_values(modules_power__power=300.0), onset_h=5.0)
    found = diagnose(brisk.network, record, brisk_healthy if told else calm(brisk, late))
    named = {(e.kind, e.where) for e in found.effects}
    assert named == {("heat_source", "modules"), *([("actuator", "heater_power")] if told else [])}
    assert any("follows its command late" in note for note in found.notes) is not told, found.notes


@pytest.mark.parametrize("measured", [True, False])
def test_a_room_that_nobody_measured_has_no_thermometer_that_could_fail(brisk: Bench, measured: bool) -> None:
    """Its column has one value throughout; means of equal samples may differ by rounding."""
    record = brisk.record(4.0)
    if not measured:
        record.inputs[:, brisk.network.input_columns.index("T_ambient_C")] = 22.1
    grid = on_grid(brisk.network, record.time_s, record.inputs, record.measured)
    known = basis(brisk.network, None, grid)
    part = Part.of(known, grid)
    assert ("T_ambient_C" in {law.candidate.where for law in part.laws}) is measured


def test_a_twin_that_is_its_rig_lacks_nothing(bench: Bench, healthy: Columns) -> None:
    known, part = known_of(bench, healthy, bench.record(16.0, seed=4))
    assert with_missing(part) is known


def test_laws_of_an_earlier_twin_that_has_none_of_them_say_nothing(bench: Bench, healthy: Columns) -> None:
    known, part = known_of(bench, healthy, bench.record(16.0, seed=4))
    assert known.health is not None
    strange = replace(part.laws[0].candidate, where="elsewhere")
    told = known.health.amplitudes([strange], known.probe.scaling.ids)
    assert told.candidates == () and told.moves.shape == (known.probe.q, 0)


def test_a_law_that_a_revision_has_adopted_is_not_looked_for_in_the_record_of_the_twin_before_it(
    bench: Bench, healthy: Columns
) -> None:
    """It has the name that it had as an addition, and changes an element that this twin lacks."""
    known, part = known_of(bench, healthy, bench.record(2.0, seed=4))
    assert known.health is not None
    addition = next(law.candidate for law in part.laws if law.candidate.kind == "heat_source" and law.candidate.adds)
    adopted = replace(addition, change="existing", adds={})
    assert adopted.id == addition.id
    assert known.health.amplitudes([addition], known.probe.scaling.ids).candidates != ()
    assert known.health.amplitudes([adopted], known.probe.scaling.ids).candidates == ()


def test_an_effect_all_along_of_the_size_that_it_had_in_health_is_taken_as_known(bench: Bench, late: Bench) -> None:
    """Of another size, or begun later, it is a change."""
    known, part = known_of(bench, late.record(10.0, seed=7), late.record(16.0, seed=4))
    assert known.health is not None
    lags = [e for e in part.scanned if e.label == ("sensor", "T_tank_C", "rate_of_change") and e.shape.onset_s == 0.0]
    found = known.health.amplitudes([lags[0].candidate], known.probe.scaling.ids)
    in_health = float(found.score[0] / found.precision[0, 0])
    assert in_health > 0.0
    same = replace(lags[0], size=in_health, sd=0.05 * in_health)
    more = with_usual(known, [same])
    assert more.missing is not None and [c.id for c in more.missing.candidates] == [same.candidate.id]
    assert with_usual(known, [replace(same, size=4.0 * in_health)]) is known
    assert with_usual(known, [replace(same, shape=replace(same.shape, onset_s=7200.0))]) is known


@pytest.mark.parametrize(
    ("unit", "lower", "kept"), [("W", -9.0, (0, 1)), ("W", 0.0, (1,)), ("1", -9.0, ())], ids=["W", "bound", "share"]
)
def test_a_law_of_a_size_that_cannot_be_is_left_out(
    bench: Bench, late: Bench, unit: str, lower: float, kept: tuple[int, ...]
) -> None:
    """Of watts any number within the bounds may be; a share of five times all would have been seen in commissioning."""
    _, part = known_of(bench, late.record(10.0, seed=7), late.record(16.0, seed=4))
    law = replace(part.laws[0].candidate, unit=unit, typical=0.05, lower=lower, upper=9.0)
    gram = 100.0 * np.eye(2)
    columns = _Columns(gram, gram @ np.array([-5.0, 5.0]), np.eye(2), np.zeros(2), np.full(2, -3.0))
    found, odds = _possible(columns, (), (law, law))
    expected = float(columns.odds(np.array([kept], dtype=np.intp))[0]) if kept else 0.0
    assert found == kept and odds == pytest.approx(expected)


def test_an_open_law_of_the_size_that_it_has_in_health_joins_what_is_known(bench: Bench) -> None:
    """Heat that comes with much power, which the twin does not have: no fault if it came in health, too."""
    law = {"kind": "law_heat", "node": "tank", "driver": "heater_power_W", "form": "threshold", "on": 740.0}
    other = replace(bench, network=bench.with_element("warms", {**law, "off": 740.0, "size": 15.0}))
    for health, is_usual in ((other.record(10.0, seed=7), True), (bench.record(10.0, seed=7), False)):
        known, part = known_of(bench, health, other.record(10.0, seed=4))
        says = "gives off {value} while heater power is above 740"
        (warms,) = (one for one in part.open_candidates if one.candidate.where == "tank" and one.candidate.says == says)
        begun = Entry(warms, Shape("step", 0.0), np.empty(0), 15.0, 0.5, 0.0).refreshed(part.score_test)
        more = with_usual(known, [replace(begun, size=15.0, sd=0.5)])
        assert (more is not known) is is_usual
        if is_usual:
            assert Part.of(more, part.grid).score_test.total < part.score_test.total - 20.0
