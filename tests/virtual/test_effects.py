"""Effects change what they say they change, nothing before their onset; bad files get one plain sentence."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.virtual.plant.effects import FORMS, EffectFileError, Form, PlantEffect, _EffectPlace, _parse, load_effects
from drivers.virtual.plant.geometry import CHANNELS
from drivers.virtual.plant.instruments import Instruments
from drivers.virtual.plant.plant import Plant
from drivers.virtual.plant.thermocouple_module import OPEN_CIRCUIT, ThermocoupleModule

SHIPPED = Path(__file__).resolve().parents[2] / "profiles" / "effects"
ONSET_S = 100.0
HEALTHY = "healthy"

VALUES = {
    "power_W": 150.0,
    "conductance_W_per_K": 8.0,
    "lost_fraction": 0.4,
    "exponent_change": 0.5,
    "recirculated_fraction": 0.4,
    "bypass_fraction": 0.4,
    "capacity_J_per_K": 5e4,
    "gain": 0.8,
}
SHAPES = {
    "tau_s": 200.0,
    "peak_hour": 8.0,
    "width_h": 6.0,
    "exponent": 1.0,
    "period_s": 300.0,
    "duty": 0.5,
    "threshold_C": 25.0,
    "hysteresis_K": 0.5,
    "conductance_W_per_K": 50.0,
}


def history(effects: tuple[PlantEffect, ...], seconds: int = 900, start_C: float = 36.0) -> np.ndarray:
    """Junction temperatures and read-backs, (seconds, 14), with load and speeds that move."""
    plant = Plant(seed=4, start_C=start_C, effects=effects)
    instruments = Instruments(4, 1.0, effects)
    rows = []
    for second in range(seconds):
        plant.step(600.0 + 200.0 * (second // 150 % 2), 0.9, 0.7)
        rows.append([*plant.junction, *instruments.read(plant)])
    return np.array(rows)


@pytest.fixture(scope="module")
def healthy() -> np.ndarray:
    return history(())


def effect_of(form: Form, where: str) -> PlantEffect:
    shape = {name: SHAPES[name] for name, _ in form.shape}
    return PlantEffect(form.kind, where, form.driver, form.magnitude, VALUES[form.magnitude], ONSET_S, shape=shape)


PLANT_FORMS = [form for form in FORMS if form.kind != "sensor"]


@pytest.mark.parametrize("form", PLANT_FORMS, ids=lambda form: f"{form.kind}-{form.driver}-{form.magnitude}")
def test_every_form_acts_everywhere_it_may_stand_and_only_after_its_onset(form: Form, healthy: np.ndarray) -> None:
    for where in form.places:
        rows = history((effect_of(form, where),), 500)
        assert np.array_equal(rows[:100], healthy[:100]), where
        assert np.abs(rows[100:, :9] - healthy[100:500, :9]).max() > 0.005, where


def test_modules_heat_warms_the_modules_by_its_power(healthy: np.ndarray) -> None:
    rows = history((PlantEffect("heat_source", "modules", "constant", "power_W", 180.0, ONSET_S),))
    change = (rows - healthy)[-1]
    assert change[1:7].min() > 0.5
    assert change[0] > 0.0
    # What entered stays: nothing leaves but by temperature.
    plain, heated = (
        Plant(seed=0),
        Plant(seed=0, effects=(PlantEffect("heat_source", "pm3", "constant", "power_W", 90.0),)),
    )
    for plant in (plain, heated):
        for _ in range(100):
            plant.step(0.0, 1.0, 0.0)
    assert heated.heat_in_J() - plain.heat_in_J() == pytest.approx(9000.0)


@pytest.mark.parametrize(("where", "sensor"), [("heater", 0), ("pm4", 4), ("tank", 8), ("radiator", 7)])
def test_a_source_is_seen_first_where_it_stands(where: str, sensor: int, healthy: np.ndarray) -> None:
    rows = history((PlantEffect("heat_source", where, "constant", "power_W", 400.0, ONSET_S),), 200)
    early = np.abs(rows[:, :9] - healthy[:200, :9])[108]
    assert early.argmax() == sensor or (where, early.argmax()) == ("tank", 0)


def test_tank_insulation_cools_the_loop() -> None:
    loss = PlantEffect(
        "heat_loss", "tank", "temperature_difference", "conductance_W_per_K", 6.0, shape={"exponent": 1.0}
    )
    assert (history((loss,))[-1, :9] < history(())[-1, :9] - 0.1).all()


def test_fouling_grows_with_time() -> None:
    foul = PlantEffect("heat_rejection", "radiator", "elapsed_time", "lost_fraction", 0.5, ONSET_S, ramp_s=600.0)
    change = (history((foul,)) - history(()))[:, 7]
    assert 0.0 < change[250] < change[450] < change[800]


def test_flow_step_shows_in_the_flow_meter(healthy: np.ndarray) -> None:
    rows = history((PlantEffect("flow", "loop", "constant", "lost_fraction", 0.25, ONSET_S),))
    assert rows[150:, 11].mean() == pytest.approx(0.75 * healthy[150:, 11].mean(), rel=0.02)
    assert rows[150:, 12].mean() == pytest.approx(healthy[150:, 12].mean(), rel=1e-3)


def test_heater_gain_is_invisible_to_the_power_meter(healthy: np.ndarray) -> None:
    rows = history((PlantEffect("actuator", "heater_power", "constant", "gain", 0.8, ONSET_S),))
    assert np.array_equal(rows[:, 10], healthy[:, 10])
    assert rows[-1, 0] < healthy[-1, 0] - 0.5


def test_a_dead_pump_stops_the_flow() -> None:
    rows = history((PlantEffect("actuator", "pump_speed", "constant", "gain", 0.0, ONSET_S),), 200)
    assert rows[90, 11] > 3.0
    assert rows[-1, 11] == 0.0


def test_an_effect_ends() -> None:
    pulse = PlantEffect("heat_source", "tank", "constant", "power_W", 500.0, 100.0, 0.0, 200.0)
    plain, heated = Plant(seed=0), Plant(seed=0, effects=(pulse,))
    for plant in (plain, heated):
        for _ in range(400):
            plant.step(0.0, 1.0, 0.0)
    assert heated.heat_in_J() - plain.heat_in_J() == pytest.approx(50_000.0)


def test_periodic_and_ramp_and_time_of_day_shapes() -> None:
    def energy(effect: PlantEffect, seconds: int) -> float:
        plant = Plant(seed=0, effects=(effect,))
        for _ in range(seconds):
            plant.step(0.0, 1.0, 0.0)
        return plant.heat_in_J()

    duty = PlantEffect("heat_source", "tank", "periodic", "power_W", 100.0, shape={"period_s": 100.0, "duty": 0.3})
    assert energy(duty, 1000) == pytest.approx(30_000.0)
    ramp = PlantEffect("heat_source", "tank", "constant", "power_W", 100.0, 0.0, 1000.0)
    assert energy(ramp, 1000) == pytest.approx(50_000.0, rel=0.01)
    noon = PlantEffect(
        "heat_source", "tank", "time_of_day", "power_W", 100.0, shape={"peak_hour": 12.0, "width_h": 4.0}
    )
    assert energy(noon, 7000) == 0.0
    assert energy(noon, 8 * 3600) == pytest.approx(100.0 * 4 * 3600 * 2 / np.pi, rel=0.01)


def sampled(effects: tuple[PlantEffect, ...], seconds: int = 300) -> np.ndarray:
    """Raw counts, (seconds, 9), of a module whose junctions rise by 0.1 K/s."""
    module = ThermocoupleModule(9, effects)
    rows = []
    for second in range(1, seconds + 1):
        a, b, c = module.sample(float(second), [20.0 + 0.1 * second] * 9)
        rows.append(np.frombuffer(a + b + c[:2], dtype="<i2"))
    return np.array(rows).astype(int)


@pytest.mark.parametrize(
    ("magnitude", "value", "expected"),
    [
        ("bias", 0.8, lambda t: 80.0 + 0.0 * t),
        ("drift_per_h", 36.0, lambda t: 1.0 * (t - ONSET_S)),
        ("stuck", 1.0, lambda t: -10.0 * (t - ONSET_S)),
        ("lag_s", 10.0, lambda t: -100.0 * (1 - np.exp(-(t - ONSET_S) / 10.0))),
    ],
)
def test_sensor_faults_touch_one_channel_after_onset(magnitude: str, value: float, expected: object) -> None:
    rows = sampled((PlantEffect("sensor", "T_tank_C", "any", magnitude, value, ONSET_S),))
    plain = sampled(())
    assert np.array_equal(rows[:, :8], plain[:, :8])
    assert np.array_equal(rows[:99], plain[:99])
    times = np.arange(1, 301)
    # A stuck reading also holds the noise of its last sample.
    tolerance = 60.0 if magnitude == "stuck" else 8.0
    assert np.abs((rows - plain)[100:, 8] - expected(times[100:])).max() < tolerance


def test_open_circuit_is_flagged_and_full_scale() -> None:
    module = ThermocoupleModule(0, (PlantEffect("sensor", "T_pm2_C", "constant", "open_circuit", 1.0, 2.0),))
    before = module.sample(1.0, [30.0] * 9)
    after = module.sample(2.0, [30.0] * 9)
    assert before[2][2:4] == b"\x00\x00"
    assert int.from_bytes(after[0][4:6], "little") == OPEN_CIRCUIT
    assert int.from_bytes(after[2][2:4], "little") == 1 << CHANNELS.index("T_pm2_C")


def test_meter_faults_touch_one_meter(healthy: np.ndarray) -> None:
    rows = history((PlantEffect("sensor", "flow_L_per_min", "constant", "bias", 0.5, ONSET_S),))
    assert (rows - healthy)[150:, 11] == pytest.approx(0.5, abs=0.01)
    rows[:, 11] = healthy[:, 11]
    assert np.array_equal(rows, healthy)


@pytest.mark.parametrize("path", sorted(SHIPPED.glob("*.toml")), ids=lambda path: path.stem)
def test_shipped_files_load_and_do_nothing_before_their_onset(path: Path, healthy: np.ndarray) -> None:
    effects = load_effects(path)
    seconds = int(min(900.0, *(effect.onset_s for effect in effects), 900.0))
    assert np.array_equal(history(effects, seconds), healthy[:seconds])


GOOD = '[[effect]]\nkind = "heat_source"\nwhere = "tank"\ndriver = "constant"\npower_W = 5.0\n'


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "at least one [[effect]]"),
        ("effect = 3", "at least one [[effect]]"),
        ("[[effect]", "is not valid TOML"),
        (GOOD + "[other]\n", "key 'other' is unknown"),
        (GOOD.replace("heat_source", "magic"), "use one of heat_source, heat_loss"),
        (GOOD.replace("tank", "attic"), "use one of heater, modules, radiator, tank, pm1"),
        (GOOD.replace('where = "tank"\n', ""), "key 'where' is missing"),
        (GOOD.replace("constant", "moon"), "use one of constant, elapsed_time"),
        (GOOD.replace("power_W = 5.0", ""), "no magnitude that goes with driver 'constant'; give power_W"),
        (GOOD.replace("5.0", '"5"'), "give a number"),
        (GOOD.replace("5.0", "nan"), "finite"),
        (GOOD.replace("5.0", "1e6"), "from -3000 to 3000"),
        (GOOD.replace("5.0", "true"), "give a number"),
        (GOOD + "onset = 3\n", "key 'onset' is unknown here; use one of kind, where"),
        (GOOD + "onset_s = -3\n", "0 or later"),
        (GOOD + "onset_s = 30\nend_s = 20\n", "after onset_s = 30"),
        (GOOD + "ramp_s = -1\n", "ramp_s"),
        (GOOD.replace("constant", "periodic"), "key 'period_s' is missing"),
        (GOOD.replace("constant", "periodic") + "period_s = 0\n", "above 0"),
        (GOOD.replace("constant", "periodic") + "period_s = 9\nduty = 2\n", "at most 1"),
        ('[[effect]]\nkind="sensor"\nwhere="T_tank_C"\nbias=1\nlag_s=3\n', "more than one magnitude"),
        (GOOD.replace('driver = "constant"\n', ""), "line 1: effect 1: key 'driver' is missing"),
        (GOOD.replace("[[effect]]\n", ""), "line 1: key 'kind' belongs to no effect; write [[effect]] above it"),
        (GOOD.replace("[[effect]]", "[effect]"), "line 1: [effect] is one table; write [[effect]]"),
        (GOOD.replace("[[effect]]", "[[effects]]"), "line 1: key 'effects' is unknown"),
        ("\ufeff" + GOOD, "byte order mark"),
        (GOOD + "note = 3\n", "line 6: effect 1: key 'note' is 3; give text"),
        (GOOD + GOOD + "onset_s = 2020-01-01\n", "line 11: effect 2: key 'onset_s' is 2020-01-01; give a number"),
        (GOOD.replace("constant", "time_of_day") + "peak_hour = 26\n", "from 0 to 24"),
        (GOOD.replace("constant", "time_of_day") + "width_h = 48\n", "at most 24"),
        ('[[effect]]\nkind="sensor"\nwhere="T_tank_C"\nstuck=false\n', "must be true"),
        ('[[effect]]\nkind="sensor"\nwhere="T_ambient_C"\nopen_circuit=true\n', "give"),
        ('[[effect]]\nkind="heat_rejection"\nwhere="radiator"\ndriver="elapsed_time"\nlost_fraction=0.2\n', "ramp_s"),
        ('[[effect]]\nkind="thermal_mass"\nwhere="tank"\ncapacity_J_per_K=9000\n', "conductance_W_per_K"),
    ],
)
def test_bad_files_are_refused_in_one_sentence(text: str, says: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(EffectFileError) as caught:
        load_effects(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert says in message
    assert "\n" not in message.replace(str(path), "")


WORDS = [name for form in FORMS for name in (form.kind, form.driver, form.magnitude, *form.places)]
KEYS = ["kind", "where", "driver", "onset_s", "ramp_s", "end_s", *VALUES, *SHAPES, "bias", "stuck"]
SCALARS = st.sampled_from(WORDS) | st.integers() | st.floats() | st.booleans() | st.lists(st.integers(), max_size=2)


@settings(deadline=None)
@given(st.dictionaries(st.sampled_from(KEYS), SCALARS), st.sampled_from(FORMS))
def test_any_table_is_an_effect_or_a_plain_refusal(table: dict[str, object], form: Form) -> None:
    good = {"kind": form.kind, "where": form.places[0], "driver": form.driver, form.magnitude: 1.0}
    for candidate in (table, {**good, **table}):
        try:
            effect = _parse(candidate, _EffectPlace(Path("file"), 1))
        except EffectFileError as error:
            assert str(error).startswith("file: effect 1: ")
        else:
            assert effect.envelope(effect.onset_s + 1e9) in (0.0, 1.0)


def test_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(EffectFileError, match="cannot be read"):
        load_effects(tmp_path / "none.toml")


def test_a_file_in_another_encoding_is_refused_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "bad.toml"
    path.write_bytes(GOOD.replace("tank", "t\u00e4nk").encode("latin-1"))
    with pytest.raises(EffectFileError, match=r"is not UTF-8 text \(line 3\); save it as UTF-8"):
        load_effects(path)
