"""Undeclared effects of a tower cell: drivers, physics, adoption by a twin file, and evidence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.twin.tower.made_cell import M_W0, made_points
from tests.twin.tower.made_effect import weathered, with_recirculation
from tests.twin.tower.test_calibration import SITE, clean
from twin.elements import tower_effect
from twin.network import Revision
from twin.tower import effects as physics
from twin.tower.air import CP_WATER, density, ratio_from_wet_bulb, saturated_enthalpy
from twin.tower.clean_cell.commissioning import fit_clean_cell
from twin.tower.diagnosis.adoption import adopted, effects_of
from twin.tower.diagnosis.candidates import candidates, decoys, noons
from twin.tower.diagnosis.evidence import gain
from twin.tower.diagnosis.search import CellCase, search_effects
from twin.tower.diagnosis.validation import held_out_parts
from twin.tower.effects import CellEffect, pattern, sun_height, wet_bulb_with_exhaust
from twin.tower.estimates import Priors, time_grid
from twin.tower.minutes import minutes_of
from twin.tower.model import NAMES, CellModel
from twin.tower.twin_file import BOUNDS, cell_network

WEST = CellEffect("recirculation", "exhaust", "wind_direction", 270.0, size=0.1, sd=0.01)


def design():  # type: ignore[no-untyped-def]
    return fit_clean_cell(clean(), M_W0).design


def case(made, effects=()) -> CellCase:  # type: ignore[no-untyped-def]
    minutes = minutes_of(made.time_s, made.columns, made.origin, M_W0, 0.0, effects)
    edges = time_grid(float(made.time_s[0]), float(made.time_s[-1]))
    return CellCase(1, CellModel(design(), SITE, effects), minutes, made.columns, Priors(BOUNDS), (), (), edges)


def test_element_and_physics_have_the_same_paths_and_drivers() -> None:
    assert tower_effect.PATHS == physics.PATHS and tower_effect.DRIVERS == physics.DRIVERS


def test_element_takes_every_effect_that_a_diagnosis_may_find() -> None:
    columns = {
        name: np.linspace(0.0, 100.0, 2000) for name in ("wind_deg", "wind_m_s", "neighbours_speed_pct", "load_kW")
    }
    found = candidates(columns, np.arange(2000) * 60.0, "America/Chicago")
    kinds = {form.kind for one in found for form in one.forms}
    assert len(kinds) >= 4 and kinds <= set(tower_effect.KINDS)


def test_wind_drives_from_its_direction_alone_and_from_the_onset_on() -> None:
    columns = {"wind_m_s": np.full(4, 10.0), "wind_deg": np.array([270.0, 90.0, 330.0, 270.0])}
    late = CellEffect("recirculation", "exhaust", "wind_direction", 270.0, onset_s=180.0)
    assert pattern(WEST, np.arange(4) * 60.0, columns, 1.0) == pytest.approx([2.0, 0.0, 1.0, 2.0])
    assert pattern(late, np.arange(4) * 60.0, columns, 1.0) == pytest.approx([0.0, 0.0, 0.0, 2.0])


def test_sun_stands_highest_at_noon_and_is_away_at_night() -> None:
    hours = np.arange(24) * 3600.0 + 170 * 86400.0
    height = sun_height(hours, 18.0)
    assert int(height.argmax()) == 18 and height[6] == 0.0 and 0.9 < height.max() <= 1.0
    assert noons("America/Chicago", hours) == (17.0, 18.0, 19.0)
    assert len(noons(None, hours)) == 24


@pytest.mark.parametrize(
    ("path", "warmer"), [("exhaust", True), ("past_fill", True), ("wetted", True), ("outlet", True), ("wet_bulb", True)]
)
def test_an_effect_of_positive_size_warms_the_outlet(path: str, warmer: bool) -> None:
    made = weathered(1.0, 3)
    one = CellEffect("follows", path, "neighbours_speed", size=0.1)
    with_it, without = (case(made, e) for e in ((one,), ()))
    slow, g = np.zeros((len(made.time_s), 5)), Priors(BOUNDS).constant()[0]
    change = with_it.model.outlet(with_it.minutes.operation, slow, g) - without.model.outlet(
        without.minutes.operation, slow, g
    )
    acting = made.columns["neighbours_speed_pct"] > 0.0
    assert (change[acting] > 0.0).all() is np.bool_(warmer) or (change[acting] > 0.0).all() == warmer
    assert np.abs(change[~acting]).max() < 1e-9


def test_air_with_exhaust_has_the_mean_enthalpy_of_ambient_air_and_of_the_exhaust_that_it_becomes() -> None:
    wet, hot, share = np.array([0.0, 15.0, 22.0, 28.0]), np.array([24.0, 33.0, 36.0, 40.0]), 0.3 * np.ones(4)
    rise = np.array([0.8, 0.6, 0.5, 0.4])
    mixed = wet_bulb_with_exhaust(wet, hot, share, rise, 99.0 * np.ones(4))
    ambient, most, found = (saturated_enthalpy(t, 99.0) for t in (wet, hot, mixed))
    exhaust = found + rise * (most - found)
    assert np.allclose(found, (1.0 - share) * ambient + share * exhaust, rtol=1e-4)
    assert np.allclose(wet_bulb_with_exhaust(wet, hot, 0.0 * share, rise, 99.0 * np.ones(4)), wet)


def test_the_exhaust_that_comes_back_has_taken_up_the_heat_of_the_cells_water() -> None:
    made = weathered(1.0, 3)
    one = CellEffect("recirculation", "exhaust", "neighbours_speed", size=0.2)
    model, o = case(made, (one,)).model, case(made, (one,)).minutes.operation
    slow, g = np.zeros((len(made.time_s), 5)), Priors(BOUNDS, discrepancy=False).constant()[0]
    g[[NAMES.index("recirculation"), NAMES.index("draft")]] = 0.0
    acting = (o.patterns[:, 0] > 0.2) & (o.inputs.t_in > o.inputs.wet + 5.0)
    out = model.outlet(o, slow, g)[acting]
    u = o.inputs.take(acting)
    rho = density(u.dry, ratio_from_wet_bulb(u.dry, u.wet, u.pressure), u.pressure)
    share, air = 0.2 * o.patterns[acting, 0], model.design.m_a0 * u.speed * rho / model.design.density
    heat = u.m_w * CP_WATER * (u.t_in - out)
    ambient = saturated_enthalpy(u.wet, u.pressure)
    # Entering air by hand, and the outlet of a cell that stands in such air.
    wanted = ambient + share / (1.0 - share) * heat / air
    grid = np.linspace(-10.0, 45.0, 5501)
    wet = np.array([np.interp(h, saturated_enthalpy(grid, p), grid) for h, p in zip(wanted, u.pressure, strict=True)])
    plain = case(made, ()).model
    moved = replace(o.take(acting), inputs=replace(u, wet=wet, dry=np.maximum(u.dry, wet)))
    assert acting.sum() > 50
    assert np.abs(plain.outlet(moved, slow[acting], g) - out).max() < 0.08


def test_an_adopted_effect_is_read_back_from_the_twin_file() -> None:
    network = cell_network(1, "Z", design(), 0.0, 0.1, (0.02, 0.1), Revision())
    column = CellEffect("follows", "inlet", "column", column="dry_C", centre=20.0, spread=5.0, size=0.3, sd=0.02)
    since = CellEffect("bypass_leak", "past_fill", "always", onset_s=1.66e9, size=0.04, sd=0.01)
    grown = adopted(network, [WEST, column, since], Revision())
    assert effects_of(grown) == (WEST, column, since)
    twice = adopted(grown, [WEST], Revision())
    assert len(effects_of(twice)) == 4


def test_evidence_has_the_bayes_factor_of_one_gaussian_size() -> None:
    """Against the density of one reading y = size + noise under both hypotheses."""
    y, noise, sd = 1.3, 0.4, 0.7
    found = gain(np.array([1 / noise**2]), np.array([y / noise**2]), np.array([sd]), 0)
    total = noise**2 + sd**2
    expected = -0.5 * np.log(total) - 0.5 * y**2 / total + 0.5 * np.log(noise**2) + 0.5 * y**2 / noise**2
    assert found.gain[0] == pytest.approx(expected)
    assert gain(np.array([1 / noise**2]), np.array([-y / noise**2]), np.array([sd]), 1).gain[0] < 0.0


def test_held_out_parts_lie_inside_the_record_and_take_a_third() -> None:
    for days in (6.0, 30.0, 100.0):
        time_s = np.arange(0.0, days * 86400.0, 60.0)
        parts = held_out_parts(time_s)
        assert parts[0][0] > time_s[0] and parts[-1][1] <= time_s[-1] + 60.0
        assert 0.2 < sum(b - a for a, b in parts) / (days * 86400.0) < 0.45


def test_candidates_need_their_drivers_and_decoys_keep_the_spectrum() -> None:
    made = weathered(3.0, 5)
    names = {one.forms[0].kind for one in candidates(made.columns, made.time_s, "UTC")}
    assert {"recirculation", "neighbour", "bypass_leak", "solar", "underwetting", "follows"} <= names
    calm = {n: v for n, v in made.columns.items() if not n.startswith("wind")}
    assert "recirculation" not in {one.forms[0].kind for one in candidates(calm, made.time_s, "UTC")}
    decoy, wind = decoys(made.columns, 1)["decoy_wind"], made.columns["wind_m_s"]
    assert np.std(decoy) == pytest.approx(np.std(wind), rel=0.05)
    assert abs(np.corrcoef(decoy, wind)[0, 1]) < 0.5


def test_search_names_hidden_recirculation_with_its_direction_and_nothing_on_a_healthy_cell() -> None:
    healthy = weathered(12.0, 11)
    assert made_points()  # the clean cell is commissioned on points of another solver
    quiet = search_effects([case(healthy)], "UTC")
    assert quiet.findings == ()
    found = search_effects([case(with_recirculation(healthy, 0.15, 240.0))], "UTC")
    assert [f.hypothesis.candidate.forms[0].kind for f in found.findings] == ["recirculation"]
    effect = found.findings[0].effects[1]
    assert effect.driver == "wind_direction" and effect.form == pytest.approx(240.0, abs=15.0)
    assert effect.onset_s is None and found.findings[0].p_value == pytest.approx(0.005)
    assert found.after[1].without_offset() < 0.9 * found.before[1].without_offset()
    assert found.findings[0].held_out_gain > 3.0
