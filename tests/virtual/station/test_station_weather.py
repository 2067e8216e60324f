"""Weather of the virtual station: files of typical years, generator, noise within the hour."""

from __future__ import annotations

import datetime
from pathlib import Path

import numpy as np
import pytest

from drivers.virtual.tower.weather import CHICAGO, MIAMI, WeatherError, find_file, made_year, minutes, read_year

START = datetime.datetime(2023, 7, 1, tzinfo=datetime.UTC)


def epw(path: Path, hours: int = 8760) -> Path:
    """Write a file of EnergyPlus whose dry bulb is the hour of the day."""
    head = ["LOCATION,Town,ST,USA,TMY3,1,41.0,-87.0,-6.0,200.0", *["COMMENTS,x"] * 7]
    rows = [
        f"1986,1,1,{k % 24 + 1},0,?9,{k % 24}.0,-5.0,40,98500,0,0,0,120,0,0,0,0,0,0,270,4.5,0" for k in range(hours)
    ]
    path.write_text("\n".join(head + rows) + "\n")
    return path


def tm2(path: Path) -> Path:
    """Write a file of TMY2: tenths of degC and m/s, millibars, in fixed columns."""
    row = list(" 62010101" + " " * 133)
    for first, text in ((17, "0250"), (67, " 256"), (73, " 211"), (84, "1016"), (90, "120"), (95, " 41")):
        row[first : first + len(text)] = text
    head = " 12839 TOWN                   FL  -5 N 25 48 W  80 16     2"
    path.write_text("\n".join([head, *["".join(row)] * 8760]) + "\n")
    return path


def test_a_file_of_energyplus_is_read(tmp_path: Path) -> None:
    year = read_year(epw(tmp_path / "USA_IL_Chicago.epw"))
    assert year.dry[:25].tolist() == [float(k % 24) for k in range(25)]
    assert (year.dew[0], year.pressure[0], year.wind[0], year.direction[0], year.sun[0]) == (
        -5.0,
        98.5,
        4.5,
        270.0,
        120.0,
    )
    assert year.zone_h == -6.0


def test_a_file_of_tmy2_is_read(tmp_path: Path) -> None:
    year = read_year(tm2(tmp_path / "Miami.tm2"))
    assert (year.dry[0], year.dew[0], year.pressure[0], year.direction[0]) == (25.6, 21.1, 101.6, 120.0)
    assert (year.wind[0], year.sun[0], year.zone_h) == (4.1, 250.0, -5.0)


def test_a_file_that_is_cut_short_is_refused_by_its_hours(tmp_path: Path) -> None:
    with pytest.raises(WeatherError, match="has 100 hours; a year of 8760 is needed"):
        read_year(epw(tmp_path / "x.epw", 100))


def test_a_line_that_is_no_weather_is_named(tmp_path: Path) -> None:
    path = epw(tmp_path / "x.epw")
    lines = path.read_text().splitlines()
    lines[20] = "1986,1,1,1,0,?9,warm"
    path.write_text("\n".join(lines))
    with pytest.raises(WeatherError, match=r"x\.epw:21: is no line of hourly weather"):
        read_year(path)


def test_a_file_is_found_by_a_word_of_its_name(tmp_path: Path) -> None:
    path = epw(tmp_path / "USA_IL_Chicago-Ohare.epw", 1)
    assert find_file(tmp_path, ("chicago",)) == path
    assert find_file(tmp_path, ("miami",)) is None
    assert find_file(tmp_path / "absent", ("miami",)) is None


@pytest.mark.parametrize("climate", [CHICAGO, MIAMI])
def test_the_generator_is_a_climate_and_repeats_with_its_seed(climate) -> None:  # type: ignore[no-untyped-def]
    year, again = made_year(climate, np.random.default_rng(4)), made_year(climate, np.random.default_rng(4))
    assert (year.dry == again.dry).all()
    assert year.dry.mean() == pytest.approx(climate.mean, abs=2.0)
    assert (year.dew <= year.dry).all()
    assert year.dry[4300:4900].mean() - year.dry[:600].mean() == pytest.approx(2.0 * climate.year, rel=0.5)
    assert year.sun.min() == 0.0
    assert 600.0 < year.sun.max() < 1100.0


def test_noise_within_the_hour_has_the_measured_spread_and_memory() -> None:
    year = made_year(MIAMI, np.random.default_rng(1))
    air = minutes(year, START, 60 * 1440, np.random.default_rng(2))
    smooth = np.convolve(air.dry, np.ones(60) / 60.0, mode="same")
    rest = (air.dry - smooth)[100:-100]
    assert 0.2 < rest.std() < 0.7
    assert np.corrcoef(rest[:-5], rest[5:])[0, 1] > 0.7
    assert (air.wet_bulb() <= air.dry + 1e-6).all()
    assert (air.humidity() <= 1.0 + 1e-9).all()
