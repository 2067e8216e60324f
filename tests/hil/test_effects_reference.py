"""The page of the effects file names what the reader takes, with its defaults, bounds and sentences."""

from __future__ import annotations

import dataclasses
import re
import tomllib
from math import inf
from pathlib import Path

import numpy as np
import pytest

from drivers.virtual.plant.effects import (
    ACTUATORS,
    COMMON,
    FORMS,
    NO_RAMP,
    READINGS,
    SHAPES,
    SWITCHES,
    EffectFileError,
    Form,
    PlantEffect,
    bounds_of,
    load_effects,
    needs_ramp,
)
from drivers.virtual.plant.geometry import CHANNELS, PLACES
from drivers.virtual.plant.plant import Plant
from hil.run.session.request import RunRequest, prepare
from tests.hil.reference_pages import page

PAGE = page("effects-file")
EXAMPLE = PAGE.code["toml"][0]
PROJECT = Path(__file__).resolve().parents[2]
GROUPS = {"volumes": PLACES, "thermocouples": CHANNELS, "meters": READINGS}
UNITS = {
    "power_W": "W",
    "conductance_W_per_K": "W/K",
    "capacity_J_per_K": "J/K",
    "lag_s": "s",
    "jump_K": "K",
    "tau_s": "s",
    "period_s": "s",
    "peak_hour": "h",
    "width_h": "h",
    "threshold_C": "°C",
    "hysteresis_K": "K",
    "bias": "of the column",
    "drift_per_h": "of the column per hour",
}
KINDS = dict.fromkeys(form.kind for form in FORMS)


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "effects.toml"
    path.write_text(text, encoding="utf-8")
    return path


def type_of(key: str) -> str:
    return "true" if key in SWITCHES else f"number, {UNITS[key]}" if key in UNITS else "number"


def where_of(form: Form) -> str:
    """Groups of places where the form may stand in all of one, else names."""
    groups = [group for group, names in GROUPS.items() if set(names) <= set(form.places)]
    if groups:
        assert sum(len(GROUPS[group]) for group in groups) == len(form.places)
        return ", ".join(groups)
    return ", ".join(f"`{name}`" for name in form.places)


def row_of(form: Form) -> tuple[str, ...]:
    """What the page has to say of a form."""
    shapes = [f"`{key}`" + ("" if default is None else f" = {default:g}") for key, default in form.shape]
    allowed = "true" if form.magnitude in SWITCHES else f"{form.lowest:g} to {form.highest:g}"
    ramp = "none" if form.magnitude in NO_RAMP else "needed" if needs_ramp(form) else "allowed"
    return (
        f"`{form.driver}`",
        f"`{form.magnitude}`",
        type_of(form.magnitude),
        allowed,
        where_of(form),
        ", ".join(shapes) or "none",
        ramp,
    )


@pytest.mark.parametrize("kind", KINDS)
def test_every_form_of_a_kind_has_its_row(kind):
    columns = ("Driver", "Key", "Type, unit", "Allowed", "Where", "Further keys", "Ramp")
    assert [tuple(row[c] for c in columns) for row in PAGE.rows[kind]] == [row_of(f) for f in FORMS if f.kind == kind]


def test_there_is_a_heading_for_every_kind_and_no_other():
    assert {name for name, rows in PAGE.rows.items() if rows and "Ramp" in rows[0]} == set(KINDS)


def test_every_common_key_is_named_with_its_default_and_no_other():
    rows = PAGE.keys("[[effect]]")
    assert tuple(rows) == COMMON
    for field in dataclasses.fields(PlantEffect):
        if field.name.endswith("_s"):
            shown = "none" if field.default == inf else f"`{field.default:g}`"
            assert rows[field.name]["Default"] == shown, field.name


def test_every_shape_key_driver_and_place_is_named():
    rows = PAGE.keys("Shape keys")
    assert list(rows) == list(SHAPES) and {key for form in FORMS for key, _ in form.shape} == set(SHAPES)
    for key, row in rows.items():
        assert (row["Type, unit"], row["Allowed"]) == (type_of(key), bounds_of(key) or "any")
    assert {row["Driver"].strip("`") for row in PAGE.rows["Course in time"]} == {form.driver for form in FORMS}
    named = {row["Group"]: tuple(re.findall("`([^`]+)`", row["Names"])) for row in PAGE.rows["Places"]}
    assert named == GROUPS
    assert set(ACTUATORS) <= {place for form in FORMS for place in form.places}


@pytest.mark.parametrize("number", range(len(PAGE.rows["Mistakes"])))
def test_what_goes_wrong_is_said_in_the_words_of_the_page(tmp_path, number):
    row = PAGE.rows["Mistakes"][number]
    old, new = row["Instead of"].strip("`"), row["Written"].strip("`")
    assert old in EXAMPLE
    path = written(tmp_path, EXAMPLE.replace(old, new, 1))
    with pytest.raises(EffectFileError) as caught:
        load_effects(path)
    said = str(caught.value)
    assert said.removeprefix(f"{path}").lstrip(",: ") == row["The sentence, after the file's name"]


def test_two_of_what_the_rig_has_one_of(tmp_path):
    first = '[[effect]]\nkind = "flow"\nwhere = "heater"\nbypass_fraction = 0.2\n'
    second = first.replace("heater", "radiator")
    path = written(tmp_path, first + second)
    with pytest.raises(EffectFileError) as caught:
        load_effects(path)
    assert str(caught.value) == f"{path}, {PAGE.code['text'][0].strip()}"
    assert len(load_effects(written(tmp_path, first + "end_s = 9\n" + second + "onset_s = 9\n"))) == 2
    loss = '[[effect]]\nkind = "heat_loss"\nwhere = "%s"\nconductance_W_per_K = 2\nexponent = %s\n'
    assert len(load_effects(written(tmp_path, loss % ("pm1", 1) + loss % ("modules", 1) + loss % ("tank", 1.25)))) == 3
    with pytest.raises(EffectFileError, match=r"line 10: effect 2: key 'exponent' must be, .* that of effect 1; let"):
        load_effects(written(tmp_path, loss % ("pm1", 1) + loss % ("modules", 1.25)))


@pytest.mark.parametrize("table", range(EXAMPLE.count("[[effect]]")))
def test_what_must_be_given_is_missed_and_nothing_else(tmp_path, table):
    """The example without a key is refused where the page says so, and read where it does not."""
    blocks = EXAMPLE.split("[[effect]]")[1:]
    keys = tomllib.loads("[[effect]]" + blocks[table])["effect"][0]
    rows = PAGE.keys("[[effect]]")
    row = next(r for r in PAGE.rows[keys["kind"]] if r["Driver"] == f"`{keys['driver']}`")
    needed = {"kind", "where", row["Key"].strip("`")} | {
        key
        for key, default in next(f for f in FORMS if row_of(f)[:2] == (row["Driver"], row["Key"])).shape
        if default is None
    }
    needed |= {"ramp_s"} if row["Ramp"] == "needed" else set()
    needed |= {"driver"} if sum(r["Key"] == row["Key"] for r in PAGE.rows[keys["kind"]]) > 1 else set()
    assert {key for key in keys if key in rows and rows[key]["Default"] == "must be given"} <= needed
    for key in keys:
        lines = [line for line in blocks[table].splitlines() if not line.startswith(f"{key} =")]
        path = written(tmp_path, "[[effect]]" + "\n".join(lines) + "\n")
        if key in needed:
            with pytest.raises(EffectFileError):
                load_effects(path)
        else:
            assert len(load_effects(path)) == 1


@pytest.mark.parametrize(
    "effect",
    [
        PlantEffect(
            "heat_loss",
            "pipe_to_modules",
            "temperature_difference",
            "conductance_W_per_K",
            60.0,
            shape={"exponent": SHAPES["exponent"][1]},
        ),
        PlantEffect(
            "thermal_mass",
            "tank",
            "history",
            "capacity_J_per_K",
            100.0,
            shape={"conductance_W_per_K": SHAPES["conductance_W_per_K"][1]},
        ),
    ],
)
def test_at_the_bounds_of_the_shapes_the_plant_is_stable(effect):
    plant = Plant(seed=1, start_C=70.0, effects=(effect,))
    for _ in range(300):
        plant.step(1000.0, 1.0, 1.0)
    assert np.isfinite(plant.junction).all() and plant.solid.min() > 20.0 and plant.solid.max() < 80.0


def test_the_example_runs_on_the_virtual_rig_and_a_late_effect_is_noted(tmp_path):
    path = written(tmp_path, EXAMPLE)
    load = tmp_path / "load.csv"
    head = "time_s,heater_power_W,pump_speed_pct,fan_speed_pct\n"
    load.write_text(head + "0,700,100,70\n20000,700,100,70\n", encoding="utf-8")
    rig = PROJECT / "profiles/rigs/virtual.toml"
    request = RunRequest(load, rig, None, tmp_path, virtual=True, mode="lockstep", effects=path)
    assert not any("begins at" in note for note in prepare(request).notes)
    load.write_text(head + "0,700,100,70\n9000,700,100,70\n", encoding="utf-8")
    late = [note for note in prepare(request).notes if "begins at" in note]
    assert late == [f"{path}: effect 3 begins at 10800 s, after the profile's end at 9000 s"]
