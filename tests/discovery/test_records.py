"""Records without a healthy one beside them: what grows out of a twin that lacks most, on made records and public ones.

The made ones have the shapes of the public ones: two coupled heaters with thermistor lag and radiation, a pipe with a
wall, a fan cooler at rest.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

from hil.bench.discovery.public_records import measure
from twin.discovery.effects.catalogue import catalogue, sites_of
from twin.discovery.growing.growth import Growth, grow, grow_at_rest
from twin.discovery.growing.likelihood import Spectrum, cosines, judged
from twin.discovery.growing.superset.equivalent_places import family_candidates
from twin.discovery.growing.superset.steady_states import SteadyStates
from twin.kernel import Kernel, simulate
from twin.network import Array, Network, TwinFileError
from twin.steady import steady_readings
from twin.twinfile import load

TWINS = Path(__file__).resolve().parents[2] / "profiles" / "twins"
STEP_K = 0.32
"""Of the heaters' converter."""


def added(growth: Growth) -> list[tuple[str, str, str]]:
    return [(r.added.kind, r.added.where, r.added.driver) for r in growth.rungs if r.added is not None]


def heaters(network: Network, seed: int, rows: int = 600, wander_K: float = 0.0) -> tuple[Array, Array, Array]:
    """Ten minutes of two heaters with random steps, read in steps of the converter; `wander_K` of slow error."""
    rng = np.random.default_rng(seed)
    t, u = np.arange(rows, dtype=np.float64), np.zeros((rows, 3))
    u[:, 2] = 23.0
    for j in range(2):
        at = int(rng.integers(5, 120))
        while at < rows:
            u[at:, j] = 10.0 * rng.integers(2, 11)
            at += int(rng.integers(80, 200))
    y = simulate(network, t, u, np.array([23.0, 23.0]))
    kept = np.exp(-1.0 / 100.0)
    slow = rng.normal(0.0, wander_K, 2)
    for i in range(rows):
        y[i] += slow
        slow = kept * slow + rng.normal(0.0, wander_K * np.sqrt(1.0 - kept**2), 2)
    return t, u, np.round((y + rng.normal(0.0, 0.1, y.shape)) / STEP_K) * STEP_K


def test_two_heaters_get_their_lag_their_exchange_and_a_loss_that_grows_with_temperature() -> None:
    bare, full = load(TWINS / "tclab_bare.toml"), load(TWINS / "tclab.toml")
    found = grow(bare, *heaters(full, 1), most=3, beam=2)
    assert set(added(found)) == {
        ("sensor", "heaters", "rate_of_change"),
        ("coupling", "heater_2", "temperature_difference"),
        ("heat_loss", "heaters", "temperature"),
    }
    assert found.verdict == "adequate"
    by_kind = {r.added.kind: r.added for r in found.rungs if r.added is not None}
    assert by_kind["sensor"].value == pytest.approx(20.7, rel=0.05)
    lag = by_kind["sensor"].interval90
    assert lag[0] < 20.68 < lag[1]
    # Conduction of 1/245 W/K and the radiation between the heaters, together.
    assert by_kind["coupling"].value == pytest.approx(0.0054, rel=0.15)
    # Re-tuning had let the linear loss stand for radiation; with the term it gives back what it took.
    assert (
        found.rungs[-1].network.parameters["convection.hA"].value
        < found.rungs[-2].network.parameters["convection.hA"].value
    )
    # The twin that grew is an ordinary one, and foretells a record that it never saw.
    t, u, y = heaters(full, 2)
    errors = [np.abs(simulate(r.network, t, u, np.array([23.0, 23.0])) - y).mean() for r in found.rungs]
    assert errors[-1] < 0.2 < 5.0 * errors[-1] < errors[0]


@pytest.mark.parametrize(("seed", "wander_K"), [(0, 0.0), (5, 0.2)])
def test_nothing_is_added_to_a_twin_that_lacks_nothing(seed: int, wander_K: float) -> None:
    """A slow error of the thermometers is no effect, though a term could take it up."""
    bare = load(TWINS / "tclab_bare.toml")
    found = grow(bare, *heaters(bare, seed, wander_K=wander_K), most=1)
    assert added(found) == [] and len(found.rungs) == 1
    assert "nothing is missing" in found.summary


def pipe(network: Network, flow_pct: float, seconds: float, seed: int) -> tuple[Array, Array, Array]:
    """A step of the inlet up and down, read every three seconds or so to a tenth of a degree."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(2.5, 3.5, int(seconds / 3.0)))
    t -= t[0]
    inlet = 17.0 + 34.0 / (1.0 + np.exp(-(t - 20.0) / 4.0)) - 20.0 / (1.0 + np.exp(-(t - 0.55 * seconds) / 8.0))
    u = np.column_stack([np.full(t.size, flow_pct), np.round(inlet, 1), np.full(t.size, 18.0)])
    y = simulate(network, t, u, np.full(len(network.nodes), 17.0))
    return t, u, np.round(y + rng.normal(0.0, 0.05, y.shape), 1)


def test_a_mixed_pipe_becomes_a_delay_and_a_wall_and_claims_no_loss() -> None:
    mixed, whole = load(TWINS / "heated_pipe_mixed.toml"), load(TWINS / "heated_pipe.toml")
    # At one flow a wall in good contact is a late thermometer; at another it is not.
    other = pipe(whole, 35.0, 900.0, 2)
    found = grow(mixed, *pipe(whole, 75.0, 600.0, 1), more=(other,), most=2, beam=2)
    assert added(found) == [("delay", "water", "history"), ("thermal_mass", "water", "history")]
    delay, wall = (r.added for r in found.rungs[1:] if r.added is not None)
    assert delay.value == pytest.approx(84.36, rel=0.15) and wall.value == pytest.approx(101141.0, rel=0.25)
    assert found.rungs[-1].rms[0] < 0.1 < 20.0 * found.rungs[-1].rms[0] < found.rungs[0].rms[0]
    assert all("heat_loss" not in o for a in (delay, wall) for o in a.others)


def cooler(network: Network, states: int, seed: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    spans = {
        "T_in_C": (30.0, 45.0),
        "T_ambient_C": (12.0, 26.0),
        "fan_speed_pct": (10.0, 90.0),
        "flow_pct": (20.0, 95.0),
    }
    u = np.column_stack([rng.uniform(*spans[c], states) for c in network.input_columns])
    y = steady_readings(network, u)
    return u, y + rng.normal(0.0, 0.1, y.shape)


def test_a_cooler_at_rest_is_found_to_follow_its_fan_and_nothing_else() -> None:
    constant = load(TWINS / "dry_cooler_constant.toml")
    truth = constant.with_values({"fins.fan_exponent": 0.65, "fins.UA_100": 24000.0})
    found = grow_at_rest(constant, *cooler(truth, 27, 3), most=2)
    assert added(found) == [("heat_rejection", "core", "fan_speed")] and found.verdict == "adequate"
    (law,) = (r.added for r in found.rungs[1:])
    assert law is not None and law.interval90[0] < 0.65 < law.interval90[1]
    values = found.network.parameters
    assert values["fins.fan_exponent"].value == law.value
    assert values["fins.UA_100"].value == pytest.approx(24000.0, rel=0.05)
    assert added(grow_at_rest(constant, *cooler(constant, 27, 4), most=1)) == []


def test_states_at_rest_agree_with_the_oracle() -> None:
    network = load(TWINS / "dry_cooler.toml")
    u, _ = cooler(network, 6, 5)
    rows = np.tile(network.values, (2, 1))
    rows[1, network.index(["fins.UA_100"])] *= 0.5
    found = SteadyStates(network, Kernel(network, ("fins.UA_100",))).readings(u, rows)
    assert found[0] == pytest.approx(steady_readings(network, u), abs=1e-6)
    assert found[1] == pytest.approx(steady_readings(network, u, rows[1]), abs=1e-6)


def test_places_that_are_alike_are_offered_together() -> None:
    bare = load(TWINS / "tclab_bare.toml")
    single = catalogue(bare)
    found = family_candidates(bare, sites_of(bare), single)
    assert {c.where for c in found} == {"heaters"}
    radiates = next(c for c in found if "m2" in c.unit)
    assert set(radiates.changes) == {"radiation_of_heater_1.area", "radiation_of_heater_2.area"}
    assert set(radiates.adds) == {"radiation_of_heater_1", "radiation_of_heater_2"}
    assert not [c for c in found if c.kind == "coupling"]


def test_slow_error_is_dearer_to_explain_than_its_squares_say() -> None:
    """A term that halves a wandering error wins little; one that halves white noise of the same size wins much."""
    rng = np.random.default_rng(1)
    n, sigma, good = 600, np.array([0.1]), np.ones((600, 1), dtype=bool)
    white = rng.normal(0.0, 1.0, (n, 1))
    slow = np.cumsum(rng.normal(0.0, 0.1, (n, 1)), axis=0)
    slow += rng.normal(0.0, 0.1, (n, 1))
    gains = []
    for r in (white, slow):
        slowest = cosines(r, good)
        emptied = slowest.copy()
        emptied[:3] = 0.0
        gains.append(judged(slowest, sigma)[0] - judged(emptied, sigma)[0])
    share = (slowest[:3] ** 2).sum() / (slowest**2).sum()
    assert share > 0.5 and gains[1] < 25.0 and gains[0] < 10.0
    assert Spectrum.white(sigma, n).roots == pytest.approx(0.1)


def test_what_cannot_grow_is_told_in_one_sentence() -> None:
    bare, constant = load(TWINS / "tclab_bare.toml"), load(TWINS / "dry_cooler_constant.toml")
    t, u, y = heaters(bare, 0, rows=300)
    with pytest.raises(TwinFileError, match="two windows"):
        grow(bare, t, u, y)
    known = {k: replace(p, status="fixed") for k, p in bare.parameters.items()}
    still = replace(bare, parameters=MappingProxyType(known), sets=MappingProxyType({}))
    with pytest.raises(TwinFileError, match="no tunables"):
        grow(still, *heaters(bare, 0))
    states, readings = cooler(constant, 8, 1)
    with pytest.raises(TwinFileError, match=r"8 steady states .* at least 12"):
        grow_at_rest(constant, states, readings)


def test_without_the_public_records_there_is_a_line_that_says_so(tmp_path: Path) -> None:
    tables, left_out = measure(tmp_path, 0)
    assert not tables and "HIL_DATA" in left_out[0]


@pytest.mark.skipif(not os.environ.get("HIL_SLOW"), reason="a study of minutes; set HIL_SLOW=1 to repeat it")
def test_the_public_records_grow_what_is_published_of_them() -> None:
    folder = Path(os.environ.get("HIL_DATA", Path(__file__).parents[2].parent / "shared" / "data"))
    if not (folder / "real").is_dir():
        pytest.skip(f"no public records at {folder}; set HIL_DATA to the folder that holds 'real'")
    tables = {t.key: t for t in measure(folder, 0)[0]}

    def rungs(key: str) -> list[str]:
        return [str(row[0]) for row in tables[key].rows if row[0] not in ("baseline, fitted", "published")]

    assert set(rungs("tclab")) == {"sensor, heaters", "coupling, heater_2", "heat loss, heaters"}
    assert rungs("heated_pipe") == ["delay, water", "thermal mass, water"]
    assert rungs("dry_cooler") == ["heat rejection, core"]
    assert rungs("wet_tower") == ["heat rejection, basin"] and tables["wet_tower"].rows[1][1] == "flow ratio"
    published = tables["tclab"].rows[-1][-1]
    assert published == 840.95
    last = {key: table.rows[len(rungs(key))] for key, table in tables.items() if key != "refused"}
    assert float(last["tclab"][-1] or "nan") < published
    assert float(last["heated_pipe"][-4] or "nan") < 0.05 * float(tables["heated_pipe"].rows[0][-4] or "nan")
    assert float(last["dry_cooler"][-1] or "nan") < 0.50
