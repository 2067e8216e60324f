"""A twin that is no loop, grown on a record of a heated room: sun through a window, walls that stay warm for hours."""

from __future__ import annotations

import numpy as np
import pytest

from twin.discovery.growing.answer import diagnose_grown
from twin.discovery.growing.descent import Start, descend
from twin.discovery.growing.growth import samples_of
from twin.discovery.growing.growth_problem import GrowthProblem
from twin.discovery.growing.superset.candidate_superset import CandidateSuperset, unsized
from twin.discovery.healthy.basis import Columns
from twin.kernel import Kernel, simulate
from twin.network import Array, Network, TwinFileError
from twin.revisions import with_elements
from twin.twinfile import parse

ROOM = """
format = 1
name = "room"
[inputs]
heater_power_W = { nominal = 750.0, lower = 0.0, upper = 3000.0 }
sun_W_m2 = { nominal = 100.0, lower = 0.0, upper = 1000.0 }
T_ambient_C = { nominal = 10.0, lower = -20.0, upper = 40.0 }
[elements.room]
kind = "node"
capacitance = { value = 2.0e6, lower = 2.0e5, upper = 1.0e8, status = "tunable" }
[elements.heater]
kind = "heat_source"
node = "room"
driver = "heater_power_W"
[elements.loss]
kind = "ambient_loss"
node = "room"
hA = { value = 60.0, lower = 5.0, upper = 500.0 }
[elements.T_room_C]
kind = "sensor"
node = "room"
columns = ["T_room_C"]
sigma = 0.05
[sets.commission]
members = ["room.capacitance", "loss.hA"]
"""
WALL = {"kind": "hidden_mass", "node": "room", "capacity": 1.8e7, "conductance": 2400.0}
SUN = {"kind": "heat_source", "node": "room", "driver": "sun_W_m2", "law": "linear", "gain": 6.0}


@pytest.fixture(scope="module")
def room() -> Network:
    return parse(ROOM)


def lived_in(room: Network, elements: dict[str, dict[str, object]], seed: int = 1) -> Columns:
    """Four days at ten minutes, with the heater in pulses."""
    rng = np.random.default_rng(seed)
    t = np.arange(576) * 600.0
    hour = t / 3600.0
    heat = 1500.0 * np.repeat(rng.integers(0, 2, 96), 6)
    clouds = np.repeat(rng.uniform(0.2, 1.0, 144), 4)
    sun = 700.0 * clouds * np.maximum(np.sin((hour % 24.0 - 6.0) / 12.0 * np.pi), 0.0)
    room_c: Array = 8.0 + 4.0 * np.sin((hour - 9.0) / 12.0 * np.pi) + np.repeat(rng.normal(0.0, 1.0, 48), 12)
    u = np.column_stack([heat, sun, room_c])
    y = simulate(with_elements(room, elements), t, u, np.array([22.0]))
    return Columns(t, u, y + rng.normal(0.0, 0.05, y.shape))


def test_sun_that_no_element_uses_and_walls_of_tonnes_are_found(room: Network) -> None:
    found = diagnose_grown(room, lived_in(room, {"wall": WALL, "sun": SUN}), most=2)
    assert found.verdict == "effect found" and found.network is not None
    size = {(e.kind, e.where, e.driver): (e.value, e.unit) for e in found.effects}
    assert set(size) == {("heat_source", "room", "sun"), ("thermal_mass", "room", "history")}
    gain, unit = size["heat_source", "room", "sun"]
    assert gain == pytest.approx(6.0, rel=0.1) and unit == "W/(W/m2)"
    assert "of sun" in found.summary


def test_one_mass_is_told_by_one_time_constant_and_says_which(room: Network) -> None:
    found = diagnose_grown(room, lived_in(room, {"wall": WALL}, seed=2), most=2)
    masses = [e for e in found.effects if e.kind == "thermal_mass"]
    assert len(masses) == 1 and found.network is not None
    added = found.network.parameters
    constant_s = added["mass_beside_room.capacity"].value / added["mass_beside_room.conductance"].value
    assert f"time constant of {constant_s / 60.0:.0f} min" in masses[0].says


def test_most_of_a_record_is_kept_and_the_rest_is_called_structural_error(room: Network) -> None:
    record = lived_in(room, {"wall": WALL, "sun": SUN})
    strict = room.with_values({"T_room_C.sigma": 0.008})
    found = diagnose_grown(strict, record, most=2)
    assert found.verdict == "effect found" and found.network is not None
    assert {e.kind for e in found.effects} == {"heat_source", "thermal_mass"}
    assert "structural error" in found.summary and "sigma" in found.summary
    (mass,) = [e for e in found.effects if e.kind == "thermal_mass"]
    assert "with a time constant of" in mass.says and mass.says in found.summary


def test_a_few_samples_are_too_little_to_grow_on(room: Network) -> None:
    record = lived_in(room, {"sun": SUN})
    with pytest.raises(TwinFileError, match=r"has 30 samples; .* grows from 40"):
        diagnose_grown(room, Columns(record.time_s[:30], record.inputs[:30], record.measured[:30]))


def test_a_wall_that_is_none_stands_still() -> None:
    """One that followed the water within a second would make ten minutes hundreds of steps."""
    text = (
        ROOM.replace("sun_W_m2 =", "pump_pct =").replace("[inputs]", "[inputs]\nT_in_C = { nominal = 20.0 }")
        + """
[elements.stream]
kind = "flow"
path = ["room"]
inlet = "T_in_C"
pump = "pump_pct"
nominal = 12.0
[elements.pipe]
kind = "pipe"
to = "room"
volume = 0.0
wall_hA = 1000.0
"""
    )
    open_loop = parse(text)
    t = np.arange(50) * 600.0
    u = np.tile(
        [
            {"T_in_C": 40.0, "heater_power_W": 500.0, "pump_pct": 100.0, "T_ambient_C": 10.0}[c]
            for c in open_loop.input_columns
        ],
        (50, 1),
    )
    kernel = Kernel(open_loop, ("pipe.wall_capacity",), whole_memory=True)
    values = np.tile(open_loop.values, (2, 1))
    values[:, open_loop.index(["pipe.wall_capacity"])[0]] = (0.0, 400.0)
    _, ends = kernel.trace(values, np.array([20.0]), t, u)
    assert ends[0, 1] == 20.0 and ends[1, 1] == pytest.approx(40.0, abs=0.1)


def test_hypotheses_go_down_side_by_side_as_each_does_alone(room: Network) -> None:
    record = lived_in(room, {"sun": SUN})
    samples, ids = samples_of(room, record.time_s, record.inputs, record.measured), room.tunables("commission")
    superset = CandidateSuperset.of(room, ids, 600.0, 345600.0)
    plain = GrowthProblem(superset, samples, ids)
    sun = next(c for c in superset.candidates if c.kind == "heat_source" and "sun" in c.driver)
    sunny = plain.with_entries((unsized(sun, 1.0),))
    starts = [Start(plain, plain.start()), Start(sunny, sunny.start()), Start(sunny, sunny.start() + 0.3)]
    together = descend(starts)
    for start, end in zip(starts, together, strict=True):
        assert end.v == pytest.approx(descend([start])[0].v, rel=1e-2, abs=1e-2)
    assert together[1].v[-1] * sunny.scales[0] == pytest.approx(6.0, rel=0.1)
    assert together[2].v == pytest.approx(together[1].v, rel=0.05, abs=0.05)
