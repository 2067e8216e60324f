"""Plants and effects of the zoo: conservation, reproducibility, and effects that vanish with their size."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from hil.bench.zoo.case import _delivered, inject
from hil.bench.zoo.effects.catalogue import EFFECTS
from hil.bench.zoo.effects.effect import EffectType, NoSuchPlaceError, Scene
from hil.bench.zoo.plants.cells import FLOW, GATE, HEAT, Modifier, simulate
from hil.bench.zoo.plants.families import DEVELOPMENT, FAMILIES, SEALED, draw_plant
from hil.bench.zoo.plants.schedules import KINDS, Schedule, draw_drive, load

SHORT = Schedule("steps", True, True, 1.0, 30.0)
DAY = Schedule("steps", True, True, 7.0, 60.0)


@functools.cache
def scene(family: str, seed: int = 3, schedule: Schedule = SHORT) -> Scene:
    plant = draw_plant(family, seed)
    rng = np.random.default_rng(seed)
    drive = draw_drive(schedule, plant.full_w, len(plant.pumps), rng)
    return Scene(plant, drive, schedule, schedule.times, 1200.0, rng, plant.run(drive, schedule.period_s))


@pytest.mark.parametrize("family", FAMILIES)
def test_a_plant_keeps_energy_and_water(family: str) -> None:
    s = scene(family)
    network = s.plant.network
    cell = int(network.stream_to[0])
    disturbed = (
        Modifier(HEAT, cell, 30.0 * s.step),
        Modifier(FLOW, 0, -0.3 * s.step),
        Modifier(GATE, 0, 0.4 * s.step),
    )
    moved = simulate(network, s.drive, SHORT.period_s, s.calm[0], disturbed)
    assert moved.put_in > 0.0
    assert moved.stored == pytest.approx(moved.put_in - moved.lost, abs=1e-9 * moved.put_in)
    assert network.imbalance(np.full(len(network.gate), 0.37)) < 1e-12


def test_a_plant_follows_from_family_and_seed() -> None:
    a, b, other = (scene("parallel", seed) for seed in (5, 5, 6))
    assert np.array_equal(a.calm, b.calm)
    assert a.plant.sheet == b.plant.sheet
    assert a.plant.sheet != other.plant.sheet


def test_a_smaller_step_changes_little() -> None:
    s = scene("serial")
    network = s.plant.network
    coarse = simulate(network, s.drive, SHORT.period_s, s.calm[0]).temperature
    fine_drive = type(s.drive)(
        *(np.repeat(getattr(s.drive, name), 40, axis=0) for name in s.drive.__dataclass_fields__)
    )
    fine = simulate(network, fine_drive, SHORT.period_s / 40.0, s.calm[0]).temperature[::40]
    assert np.abs(coarse - fine).max() < 2e-3


def test_sizes_of_a_family_spread_over_a_decade() -> None:
    powers = [float(draw_plant("serial", seed).full_w.sum()) for seed in range(60)]
    assert max(powers) / min(powers) > 8.0


def test_families_are_split_in_halves() -> None:
    assert len(DEVELOPMENT) == len(SEALED)
    assert not set(DEVELOPMENT) & set(SEALED)


@pytest.mark.parametrize("kind", KINDS)
def test_a_load_stays_between_rest_and_full_power(kind: str) -> None:
    course = load(kind, np.arange(0.0, 40_000.0, 20.0), np.random.default_rng(2))
    assert course.min() >= 0.0 and course.max() <= 1.0
    assert np.ptp(course) > 0.2


def test_there_are_enough_effects_and_enough_of_them_are_no_element() -> None:
    assert len(EFFECTS) >= 60
    assert sum(not e.element for e in EFFECTS) >= 0.4 * len(EFFECTS)
    assert len({e.name for e in EFFECTS}) == len(EFFECTS)


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.name)
def test_an_effect_of_no_size_is_none_and_one_of_some_size_shows(effect: EffectType) -> None:
    for family in ("exchanger", "cells_on_metal"):
        s = scene(family, schedule=DAY)
        try:
            injection = effect.build(s)
        except NoSuchPlaceError:
            continue
        calm = s.plant.readings(s.calm, DAY.period_s)
        args = (s.plant, s.drive, DAY, injection)
        none, columns = inject(*args, 0.0, s.calm, calm)
        for name, course in calm.items():
            np.testing.assert_allclose(none[name], course, rtol=1e-6, atol=1e-12)
        for name, course in s.plant.columns(s.drive).items():
            np.testing.assert_allclose(columns[name], course, rtol=1e-6, atol=1e-12)
        some, recorded = inject(*args, injection.most, s.calm, calm)
        read = max(float(np.abs(some[c] - calm[c]).max()) for c in calm)
        read += max(float(np.abs(recorded[c] - columns[c]).max()) for c in columns)
        assert read > 1e-6
        assert injection.answers
        return
    pytest.fail(f"no family has a place for {effect.name}")


def test_a_command_that_is_not_met_leaves_the_recorded_one() -> None:
    s = scene("serial")
    injection = next(e for e in EFFECTS if e.name == "heater: gain").build(s)
    acting = _delivered(s.plant, s.drive, injection, 0.5)
    after = s.time_s >= s.onset_s
    assert acting.heat[after].sum() == pytest.approx(0.5 * s.drive.heat[after].sum())
    assert np.array_equal(acting.heat[~after], s.drive.heat[~after])
