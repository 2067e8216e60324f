"""Moist air, Merkel's integral and the cell against others' numbers."""

from __future__ import annotations

import csv
import os
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

from twin.tower import air as moist
from twin.tower.cell import WETTED, CellDeviations, Design, Inputs, solve_cell
from twin.tower.clean_cell.merkel import entering_enthalpy, merkel_number


def reference(name: str) -> Path:
    root = Path(os.environ.get("HIL_DATA", Path(__file__).resolve().parents[3].parent / "shared" / "data"))
    path = root / "real" / name
    if not path.is_file():
        pytest.skip(f"no reference {path}; set HIL_DATA to the folder that holds 'real'")
    return path


def rows(path: Path) -> list[list[str]]:
    return list(csv.reader(line for line in path.read_text().splitlines() if line[:1].isdigit()))


def celsius(fahrenheit: str) -> float:
    return (float(fahrenheit) - 32.0) / 1.8


@pytest.mark.parametrize(
    ("t", "kPa", "ratio", "h"),
    [
        (-20.0, 0.10326, 0.000637, -18.54),
        (0.0, 0.61115, 0.003790, 9.475),
        (20.0, 2.33921, 0.014761, 57.544),
        (40.0, 7.38427, 0.049014, 166.374),
        (60.0, 19.94439, 0.152845, 458.962),
    ],
)
def test_saturated_air_is_that_of_ashraes_table(t: float, kPa: float, ratio: float, h: float) -> None:
    # ASHRAE Fundamentals 2017, chapter 1, tables 2 and 3; the table's air is real, with 0.5 % more vapour.
    assert float(moist.saturation_pressure(t)) == pytest.approx(kPa, rel=1e-3)
    assert float(moist.saturated_ratio(t, 101.325)) == pytest.approx(ratio, rel=8e-3)
    assert float(moist.saturated_enthalpy(t, 101.325)) / 1e3 == pytest.approx(h, rel=8e-3, abs=0.05)


@pytest.mark.parametrize("kPa", [101.325, 83.5])
def test_moist_air_is_that_of_coolprop_and_psychrolib(kPa: float) -> None:
    library = pytest.importorskip("psychrolib")
    library.SetUnitSystem(library.SI)
    for dry, wet in ((30.0, 22.0), (15.0, 9.0), (38.0, 27.0), (-3.0, -4.0)):
        ratio = library.GetHumRatioFromTWetBulb(dry, wet, kPa * 1e3)
        assert float(moist.ratio_from_wet_bulb(dry, wet, kPa)) == pytest.approx(ratio, rel=1e-3)
        assert float(moist.enthalpy(dry, ratio)) == pytest.approx(
            library.GetMoistAirEnthalpy(dry, ratio), rel=1e-3, abs=20.0
        )
        assert float(moist.density(dry, ratio, kPa)) == pytest.approx(
            library.GetMoistAirDensity(dry, ratio, kPa * 1e3), rel=1e-3
        )
    cool = pytest.importorskip("CoolProp.HumidAirProp")
    for t in (5.0, 20.0, 35.0):
        ratio = cool.HAPropsSI("W", "T", t + 273.15, "P", kPa * 1e3, "R", 0.5)
        vapour = 0.5 * float(moist.saturation_pressure(t))
        # CoolProp's air is real: its enhancement factor is 1.004 to 1.005.
        assert float(moist.humidity_ratio(1.0045 * vapour, kPa)) == pytest.approx(ratio, rel=1e-3)


def test_wet_bulb_and_humidity_are_each_others_inverse() -> None:
    dry, share = np.meshgrid(np.linspace(2.0, 45.0, 12), np.linspace(0.05, 1.0, 12))
    wet = moist.wet_bulb(dry, share, 95.0)
    assert moist.relative_humidity(dry, wet, 95.0) == pytest.approx(share, abs=1e-5)


def test_merkels_integral_is_that_of_baker_and_shryock() -> None:
    table = rows(reference("tower_reference/baker_shryock_1961_table1b.csv"))
    assert len(table) == 8
    h = moist.saturated_enthalpy(celsius("70"), 101.325)
    for _, hot, published in table:
        found = float(merkel_number(celsius(hot), celsius("80"), h, 1.2, 101.325))
        assert found == pytest.approx(float(published), rel=0.015)


def test_kerns_hand_integrals_are_four_to_eight_per_cent_low() -> None:
    for row in rows(reference("tower_reference/kern_ch17_examples.csv")):
        if all(row[1:6]):
            # His chart counts enthalpy from air at 0 F and water at 32 F, in Btu/lb.
            h = (float(row[3]) - 0.24 * 32.0) * 2326.0
            found = float(merkel_number(celsius(row[1]), celsius(row[2]), h, float(row[4]), 101.325))
            assert 1.03 < found / float(row[5]) < 1.09


def test_supersaturated_air_of_kloppers_is_missed_by_what_constant_heat_capacities_miss() -> None:
    row = [float(v) for v in rows(reference("tower_reference/kloppers_supersaturated_point.csv"))[0]]
    t, kPa = row[3] - 273.15, row[2] / 1e3
    saturated = float(moist.saturated_ratio(t, kPa))
    h = float(moist.enthalpy(t, saturated)) + (row[1] - saturated) * moist.CP_WATER * t
    assert h / 1e3 == pytest.approx(row[0], rel=4e-3)


def test_effectiveness_form_inverts_merkels_integral() -> None:
    # Of the outlet that a Merkel number gives, the integral gives that number back: the chord of C_s costs most in
    # hot weather and at wide ranges.
    design = Design(250.0, 205.0, 1.4, 0.0, 40.0, 1.15)
    wet, fall = np.meshgrid(np.linspace(5.0, 27.0, 6), np.linspace(8.0, 16.0, 5))
    u = Inputs(
        (wet + fall).ravel(), np.full(30, 250.0), np.ones(30), (wet + 4.0).ravel(), wet.ravel(), np.full(30, 99.0)
    )
    out = solve_cell(u, design, CellDeviations(uniformity=1.0 / WETTED))
    back = merkel_number(u.t_in, out.t_out, entering_enthalpy(u.dry, u.wet, u.pressure), u.m_w / out.m_a, 99.0)
    assert back == pytest.approx(np.full(30, 1.4), rel=0.14)
    mild = fall.ravel() <= 10.0
    assert back[mild] == pytest.approx(np.full(mild.sum(), 1.4), rel=0.06)


def test_energyplus_tower_is_followed_to_a_twentieth_of_a_degree() -> None:
    path = reference("tower_reference/energyplus_variable_speed_merkel_SIMULATED.dat")
    d = np.array([row for row in rows(path) if row[1:]], dtype=float)
    d = d[(d[:, 5] > 0.0) & (d[:, 9] > 0.0)]
    rho = moist.density(d[:, 1], moist.ratio_from_wet_bulb(d[:, 1], d[:, 2], 101.325), 101.325)
    u = Inputs(d[:, 3], d[:, 5], d[:, 9] * 1.15 / rho, d[:, 1], d[:, 2], np.full(len(d), 101.325))
    fitted, held = np.arange(0, len(d), 2), np.arange(1, len(d), 2)

    def error(p: np.ndarray, part: np.ndarray) -> np.ndarray:
        design = Design(d[:, 5].max(), p[2] * d[:, 5].max(), p[0], p[1], 1.0, 1.15)
        return solve_cell(u.take(part), design, CellDeviations(uniformity=1.0 / WETTED)).t_out - d[part, 4]

    found = least_squares(error, [1.5, 0.6, 0.8], args=(fitted,)).x
    assert np.abs(error(found, held)).max() < 0.05


def test_real_tower_calibrated_on_one_test_predicts_another() -> None:
    # CIEMAT Plataforma Solar de Almeria, doi 10.5281/zenodo.17885527; published 0.33 K and 8.47 L/h on wct_exp3.
    def read(name: str) -> dict[str, np.ndarray]:
        with reference(f"psa_cooling/{name}").open() as handle:
            table = list(csv.DictReader(handle))
        return {
            k: np.array([float(row[k]) for row in table])
            for k in ("Tamb", "HR", "Tin", "q", "w_fan", "Tout", "m_w_lost")
        }

    def run(v: dict[str, np.ndarray], p: np.ndarray):  # type: ignore[no-untyped-def]
        wet = moist.wet_bulb(v["Tamb"], v["HR"] / 100.0, 95.4)
        rho = moist.density(v["Tamb"], moist.ratio_from_wet_bulb(v["Tamb"], wet, 95.4), 95.4)
        half = 0.5 * v["w_fan"]
        m_a = -0.0014 * half**2 + 0.1743 * half - 0.7251  # the published fan curve, kg/s
        fill = p[0] * (v["Tin"] / 40.0) ** p[2] * (m_a / 3.0) ** p[3]
        u = Inputs(v["Tin"], v["q"] / 3.6 * 0.992, m_a / 3.0 / rho, v["Tamb"], wet, np.full(len(wet), 95.4))
        return solve_cell(
            u, Design(4.0, 3.0, 1.0, p[1], 1.0, 1.0), CellDeviations(fill=fill, uniformity=1.0 / WETTED)
        ), m_a

    one, other = read("wct_exp1_exp.csv"), read("wct_exp3_exp.csv")
    found = least_squares(lambda p: run(one, p)[0].t_out - one["Tout"], [1.5, 0.6, 0.0, 0.0]).x
    out, m_a = run(other, found)
    assert np.sqrt(np.mean((out.t_out - other["Tout"]) ** 2)) < 0.33
    fitted, air = run(one, found)
    # What is lost evaporates, or drifts out with the air.
    law = np.linalg.lstsq(np.stack([fitted.evaporation * 3600.0, air], axis=1), one["m_w_lost"], rcond=None)[0]
    lost = np.stack([out.evaporation * 3600.0, m_a], axis=1) @ law
    assert np.sqrt(np.mean((lost - other["m_w_lost"]) ** 2)) < 9.0
