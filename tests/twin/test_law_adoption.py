"""Adoption of laws: the edit, its equation in every view, and fits of a twin that has one."""

from pathlib import Path

import numpy as np
import pytest

from tests.twin.two_nodes import TWO
from twin.calibrators import CALIBRATOR_NAMES, make_calibrator
from twin.commissioning import commission
from twin.drawing import draw
from twin.kernel import simulate
from twin.laws.equation import law_equations
from twin.network import Network, TwinFileError
from twin.revisions import diff, revert, save_revision
from twin.revisions.law_adoption import adopt_law
from twin.tracking import TwinTracker
from twin.twinfile import load, parse, save

LOSSES = '[elements.l]\nkind="ambient_loss"\nnode="b"\nhA={ value = 8.0, lower = 1.0, upper = 30.0 }\n'
POWER = (
    '[elements.p]\nkind="heat_source"\nnode="a"\ndriver="heater_power_W"\nfactor={ value = 1.0, status = "fixed" }\n'
)
WIND = np.array([2.0, 4.0, np.nan, 3.0, 9.0])


@pytest.fixture
def twin() -> Network:
    return parse(TWO + LOSSES + POWER)


def test_a_recorded_column_that_the_twin_lacks_is_declared(twin: Network) -> None:
    new = adopt_law(
        twin,
        {"kind": "law_heat", "node": "b", "driver": "wind_m_s", "form": "linear"},
        {"gain": -7.0, "reference": 2.0},
        columns={"wind_m_s": WIND},
    )
    wind = new.inputs["wind_m_s"]
    assert (wind.nominal, wind.lower, wind.upper, wind.unit) == (3.5, 2.0, 9.0, "m/s")
    gain = new.parameters["law_heat_b.gain"]
    assert (gain.value, gain.unit, gain.status) == (-7.0, "W/(m/s)", "tunable")
    assert "wind_m_s" not in twin.inputs
    again = adopt_law(new, {"kind": "law_heat", "node": "b", "form": "constant"}, {"size": 1.0})
    assert {"law_heat_b", "law_heat_b_2"} <= {e.name for e in again.elements}


def test_a_time_course_brings_the_stamps_and_the_interval_of_the_samples(twin: Network) -> None:
    new = adopt_law(
        twin,
        {"kind": "law_heat", "node": "a", "form": "constant", "course": "interval"},
        {"size": 90.0, "start_s": 100.0, "end_s": 400.0},
        sample_s=10.0,
    )
    assert new.inputs["time_s"].unit == "s" and new.parameters["law_heat_a.edge_s"].value == 10.0
    # A record needs no column of stamps.
    columns = {c: np.full(60, s.nominal) for c, s in twin.inputs.items()}
    columns |= {"T_a_C": np.full(60, 20.0), "T_b_C": np.full(60, 20.0)}
    inputs, _ = new.select(columns)
    time = 10.0 * np.arange(60)
    with_law, without = simulate(new, time, inputs, [20.0, 20.0]), simulate(twin, time, inputs[:, :-1], [20.0, 20.0])
    more = (with_law - without)[:, 0]
    assert np.abs(more[:11]).max() < 1e-9 and more[39] > 2.0 and more[45] < more[40]


def test_an_actuator_law_brings_an_actuator_once(twin: Network) -> None:
    site = {"kind": "law_actuator", "column": "heater_power_W"}
    one = adopt_law(twin, {**site, "form": "constant"}, {"size": -0.1})
    two = adopt_law(one, {**site, "driver": "fan_speed_pct", "form": "linear"}, {"gain": 0.001})
    assert [e.kind for e in two.elements].count("actuator") == 1
    time, u = np.arange(50.0), np.tile(twin.nominal_inputs, (50, 1))
    less, plain = (
        simulate(two, time, u, [20.0, 20.0]),
        simulate(twin.with_values({"p.factor": 0.9 * 1.05}), time, u, [20.0, 20.0]),
    )
    assert less == pytest.approx(plain, abs=1e-9)


@pytest.mark.parametrize(
    ("site", "driver", "form", "said"),
    [
        ({"kind": "heat_source", "node": "a"}, {}, "constant", "is no kind of law; give one of law_actuator"),
        ({"kind": "law_heat", "node": "a"}, {"driver": "sun_W_m2"}, "linear", "name a recorded column as the driver"),
        ({"kind": "law_heat", "node": "z"}, {}, "constant", "no such node 'z'"),
        ({"kind": "law_heat", "node": "a"}, {}, "linear", "needs a driver"),
    ],
)
def test_a_law_that_cannot_be_adopted_is_refused(twin: Network, site, driver, form, said) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(TwinFileError, match=said):
        adopt_law(twin, {**site, **driver, "form": form}, {})


def test_an_error_of_the_rooms_thermometer_has_an_equation(twin: Network) -> None:
    site = {"kind": "law_input", "column": "T_ambient_C", "driver": "fan_speed_pct", "form": "linear"}
    new = adopt_law(twin, site, {"gain": 0.02}, name="found")
    said = "error of the thermometer of T_ambient_C, in proportion to fan_speed_pct"
    assert str(law_equations(new)["found"]) == f"{said}: d(T_ambient_C) = 0.02 K/% * fan_speed_pct"
    assert [e.kind for e in new.elements].count("actuator") == 1


@pytest.mark.parametrize(
    ("site", "driver", "form", "course", "parameters", "equation"),
    [
        (
            {"kind": "law_heat", "node": "b"},
            {"of": "b", "minus_input": "T_ambient_C"},
            "linear",
            "always",
            {"gain": -5.0},
            "heat into b, in proportion to T(b) - T_ambient_C: Q(b) = -5 W/K * (T(b) - T_ambient_C)",
        ),
        (
            {"kind": "law_heat", "node": "b", "source": "a"},
            {"driver": "fan_speed_pct"},
            "power",
            "ramp",
            {"size": 40.0, "scale": 100.0, "exponent": 1.5, "start_s": 60.0, "end_s": 600.0},
            "Q(a to b) = 40 W * sign(r) |r|^1.5, r = fan_speed_pct / 100 %, growing from t = 60 s to its whole size "
            "at t = 600 s",
        ),
        (
            {"kind": "law_reading", "sensor": "T_a_C"},
            {"driver": "fan_speed_pct"},
            "threshold",
            "periodic",
            {"size": 0.5, "on": 60.0, "off": 40.0, "start_s": 0.0, "period_s": 300.0},
            "d(T_a_C) = 0.5 K from fan_speed_pct = 60 % until fan_speed_pct = 40 %, else 0, on for 0.5 of every 300 s "
            "from t = 0 s on",
        ),
        (
            {"kind": "law_conductance", "node": "a", "to": "b"},
            {"driver": "T_supply_C"},
            "memory",
            "always",
            {"gain": 0.2, "reference": -3.0, "lag_s": 600.0},
            "G(a, b) = 0.2 W/K/K * (z - (-3 degC)), 600 s dz/dt = T_supply_C - z",
        ),
    ],
)
def test_the_equation_stands_in_the_difference_and_in_the_picture(
    twin: Network, tmp_path: Path, monkeypatch, site, driver, form, course, parameters, equation
) -> None:  # type: ignore[no-untyped-def]
    import matplotlib

    monkeypatch.setitem(matplotlib.rcParams, "svg.fonttype", "none")
    new = adopt_law(twin, {**site, **driver, "form": form, "course": course}, parameters, name="found")
    assert equation in str(law_equations(new)["found"])
    assert equation in diff(twin, new).added[0].equation
    symbols = law_equations(new)["found"].symbols
    drawn = draw(new, tmp_path / "picture.svg").read_text(encoding="utf-8")
    assert symbols.partition(" = ")[0] in drawn and "found" in drawn


def test_a_revision_with_a_law_is_saved_and_reverted(twin: Network, tmp_path: Path) -> None:
    path = save(twin, tmp_path / "two.toml")
    new = adopt_law(load(path), {"kind": "law_heat", "node": "a", "form": "constant"}, {"size": 25.0})
    second = save_revision(new, path)
    assert load(second).parameters["law_heat_a.size"].value == 25.0
    assert diff(load(path), load(revert(second))).empty


@pytest.fixture(scope="module")
def record() -> tuple[Network, np.ndarray, np.ndarray, np.ndarray]:
    """A twin with a law of the fan with memory, and what it reads with 300 W of it."""
    net = parse(TWO + LOSSES + POWER)
    net = adopt_law(
        net,
        {"kind": "law_heat", "node": "b", "driver": "fan_speed_pct", "form": "memory"},
        {"gain": 0.0, "reference": 50.0, "lag_s": 120.0},
        name="found",
    )
    rng = np.random.default_rng(0)
    time, u = 2.0 * np.arange(1300), np.tile(net.nominal_inputs, (1300, 1))
    u[:, 0], u[:, 2] = np.repeat(rng.uniform(100, 900, 13), 100), np.repeat(rng.uniform(10, 90, 26), 50)
    truth = net.with_values({"found.gain": 3.0})
    measured = simulate(truth, time, u, [30.0, 30.0]) + rng.normal(0.0, 1.0, (1300, 2)) * net.sigma
    return net, time, u, measured


def test_commissioning_finds_the_strength_of_a_law(record) -> None:  # type: ignore[no-untyped-def]
    net, time, u, measured = record
    done = commission(net, time, u, measured)
    assert done.network.parameters["found.gain"].value == pytest.approx(3.0, abs=0.1)


@pytest.mark.parametrize("name", ["pso", "least_squares", "kalman"])
def test_a_tracker_follows_a_twin_with_a_law(record, name: str) -> None:  # type: ignore[no-untyped-def]
    net, time, u, measured = record
    assert name in CALIBRATOR_NAMES and make_calibrator(name, net).ids
    tracker = TwinTracker(net, name, seed=1)
    for part in np.array_split(np.arange(len(time)), 5):
        update = tracker.push(time[part], u[part], measured[part])
        assert np.isfinite(update.tracked).all()
    table = tracker.table()
    assert table["T_b_C"]["tracked"] < 0.5 * table["T_b_C"]["static"]
    assert tracker.values["found.gain"] == pytest.approx(3.0, abs=0.6)
