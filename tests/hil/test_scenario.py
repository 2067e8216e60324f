"""Scenarios: plausible loads within their range, plain errors, shipped files that equal a fresh build."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from hil.profile.load_profile import read_profile
from hil.profile.scenario import ScenarioError, build, dissipation, read_scenario
from hil.profile.scenario_figure import picture
from hil.profile.scenario_files import write_scenario

LOADS = Path(__file__).parents[2] / "profiles" / "loads"
SMALL = """
name = "small"
duration = "2:00"
converters = 6
heat_per_converter_W = [100, 150]
[[system]]
name = "Propulsion"
cooling = "water"
load_kW = 70
heat_fraction = 0.01
throttle = [["0:00", 0.9], ["1:00", 1.0]]
[[system]]
name = "Laser"
cooling = "water"
load_kW = 10
heat_fraction = 0.01
windows = [["0:30", "0:40"]]
[[system]]
name = "Hotel"
cooling = "air"
load_kW = 50
heat_fraction = 0.01
[setpoints]
fan_speed_pct = [["0:00", 70], [1.5, 85]]
"""


def _scenario(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "small.toml"
    path.write_text(text)
    return path


def test_only_water_cooled_systems_heat_the_loop(tmp_path: Path) -> None:
    profile = build(read_scenario(_scenario(tmp_path, SMALL)), repeat=1)
    assert profile.name == "small_2h"
    assert profile.columns == ("heater_power_W", "fan_speed_pct")
    assert profile.time_s.tolist() == [0, 1800, 2400, 3600, 5400, 7200]
    assert profile.values[:, 0].tolist() == [630, 730, 630, 700, 700, 700]
    assert profile.values[:, 1].tolist() == [70, 70, 70, 70, 85, 85]


def test_a_repeat_is_the_same_cycle_again(tmp_path: Path) -> None:
    scenario = read_scenario(_scenario(tmp_path, SMALL))
    once, thrice = build(scenario, 1), build(scenario, 3)
    t = np.arange(0.0, 7200, 60)
    for cycle in range(3):
        assert np.array_equal(thrice.sample(t + cycle * 7200), once.sample(t))
    assert thrice.duration_s == 3 * once.duration_s


@pytest.mark.parametrize("name", ["battle", "commissioning"])
def test_shipped_files_equal_a_fresh_build(tmp_path: Path, name: str) -> None:
    shutil.copy(LOADS / f"{name}.toml", tmp_path)
    written = write_scenario(tmp_path / f"{name}.toml")
    built = [path for path in written if path.suffix == ".csv"]
    assert len(built) == (2 if name == "battle" else 1)
    for path in built:
        assert path.read_bytes() == (LOADS / path.name).read_bytes()
    assert (LOADS / f"{name}.svg").stat().st_size < 200_000


def test_the_battle_is_plausible() -> None:
    scenario = read_scenario(LOADS / "battle.toml")
    times, heat = dissipation(scenario)
    water = [index for index, system in enumerate(scenario.system) if system.cooling == "water"]
    loop = heat[water].sum(axis=0)
    assert 600 <= loop.min() < 620
    assert 880 < loop.max() <= 900
    changes = times[1:-1][np.diff(loop[:-1]) != 0]
    assert 20 <= len(changes) <= 40
    plateaus = np.diff([0, *changes, scenario.duration])
    assert plateaus.min() >= 300
    assert plateaus.max() <= 2400
    propulsion = heat[[system.name for system in scenario.system].index("Propulsion")]
    assert (propulsion[:-1] > 0.5 * loop[:-1]).all()
    profile = build(scenario, 1)
    fan = profile.values[:, profile.columns.index("fan_speed_pct")]
    pump = profile.values[:, profile.columns.index("pump_speed_pct")]
    assert set(fan.tolist()) <= {55, 70, 85, 100}
    assert set(pump.tolist()) == {85, 100}


def test_the_commissioning_profile_moves_one_thing_at_a_time_and_keeps_them_apart() -> None:
    profile = read_profile(LOADS / "commissioning_10h.csv")
    moved = np.diff(profile.values[:-1], axis=0) != 0
    assert (moved.sum(axis=1) == 1).all()
    for k, column in enumerate(profile.columns):
        held = np.diff(np.concatenate([[0], profile.time_s[1:-1][moved[:, k]], [profile.duration_s]]))
        assert held.min() >= 1200, column
        assert held.max() <= 3600, column
    levels = {column: set(profile.values[:, k].tolist()) for k, column in enumerate(profile.columns)}
    assert levels["fan_speed_pct"] == {40, 55, 70, 85, 100}
    assert levels["pump_speed_pct"] == {70, 85, 100}
    assert {600, 900} < levels["heater_power_W"]
    t = np.arange(0.0, profile.duration_s, 60)
    correlation = np.corrcoef(np.column_stack([profile.sample(t), t]), rowvar=False)
    assert np.abs(correlation - np.eye(4)).max() < 0.15


def test_heat_outside_the_range_names_the_time_and_the_systems(tmp_path: Path) -> None:
    hot = _scenario(tmp_path, SMALL.replace("load_kW = 10\n", "load_kW = 30\n"))
    with pytest.raises(ScenarioError) as caught:
        build(read_scenario(hot))
    assert str(caught.value) == (
        f"{hot} heats the loop with 930 W at 0:30 (Propulsion 630 W, Laser 300 W), above the 900 W of its "
        "6 converters; lower a load there"
    )
    with pytest.raises(ScenarioError, match=r"560 W at 0:00 .Propulsion 560 W., below the 600 W .* raise a load there"):
        build(read_scenario(_scenario(tmp_path, SMALL.replace("0.9]", "0.8]"))))


@pytest.mark.parametrize(
    ("old", "new", "place", "remedy"),
    [
        ('cooling = "air"', 'cooling = "oil"', "line 20, system 'Hotel', cooling", "'water' or 'air'"),
        ("load_kW = 10\n", "", "line 12, system 'Laser', load_kW", "add it"),
        ("load_kW = 10\n", "load_kW = -1\n", "system 'Laser', load_kW", "must be above 0, got -1"),
        ("load_kW = 10\n", "load_KW = 10\n", "system 'Laser', load_KW", "check its spelling"),
        ('["0:00", 0.9], ', "", "system 'Propulsion', throttle", "add the value that holds from the start"),
        ('["1:00", 1.0]', '["0:00", 1.0]', "system 'Propulsion', throttle", "sort the steps by time"),
        ('["1:00", 1.0]', '["1:00", 1.2]', "system 'Propulsion', throttle[1]", "must be at most 1, got 1.2"),
        ('["1:00", 1.0]', '["1h", 1.0]', "system 'Propulsion', throttle[1]", "write hours and minutes as '1:45'"),
        (
            '["1:00", 1.0]',
            '["3:00", 1.0]',
            "system 'Propulsion' changes at 3:00, after the end at 2:00",
            "drop the step",
        ),
        ('["0:30", "0:40"]', '["0:40", "0:30"]', "system 'Laser', windows", "window 0:40 to 0:30 is empty"),
        ('name = "Laser"', 'name = "Hotel"', "names system 'Hotel' twice", "its own name"),
        ("fan_speed_pct", "fan_speed", "names set-point 'fan_speed' without a unit", "heater_power_W"),
        ("windows =", 'throttle = [["0:00", 1]]\nwindows =', "system 'Laser'", "both throttle and windows"),
        ('cooling = "water"', 'cooling = "air"', "no water-cooled system", "set cooling = 'water'"),
        ("duration =", "duration", "is not valid TOML", "line 3"),
    ],
)
def test_a_bad_scenario_is_refused_with_place_and_remedy(
    tmp_path: Path, old: str, new: str, place: str, remedy: str
) -> None:
    path = _scenario(tmp_path, SMALL.replace(old, new))
    with pytest.raises(ScenarioError) as caught:
        read_scenario(path)
    sentence = str(caught.value)
    assert sentence.startswith(str(path))
    assert place in sentence
    assert remedy in sentence


def test_a_missing_scenario_and_a_wrong_repeat_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="cannot be read"):
        read_scenario(tmp_path / "none.toml")
    with pytest.raises(ScenarioError, match="at least once"):
        build(read_scenario(_scenario(tmp_path, SMALL)), 0)


@pytest.mark.parametrize("kind", ["svg", "png"])
def test_the_picture_names_every_system(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"battle.{kind}"
    picture(read_scenario(LOADS / "battle.toml"), path)
    assert 20_000 < path.stat().st_size < 200_000
    if kind == "svg":
        drawn = path.read_text()
        for name in ("Propulsion", "Directed energy", "Radar", "Navigation", "Hotel", "Communication", "900 W"):
            assert f"<!-- {name} -->" in drawn
