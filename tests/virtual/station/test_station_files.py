"""Simulated stations: reproducible by seed, files of a plant's export, truth for scoring alone."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from drivers.virtual.tower.degradation import Ramp
from drivers.virtual.tower.effects import EFFECTS, hidden_effects
from drivers.virtual.tower.export import key_of, write_station
from drivers.virtual.tower.physics.plant import OF_STATION
from drivers.virtual.tower.sites import CHICAGO_SITE, MIAMI_SITE
from drivers.virtual.tower.station import Simulated, SimulationPlan, simulate, state_by_minute
from hil.tower.station import read_station

DAYS_4 = 4 / 30.4375
OUTLET = "21-TI-1103.PV"


def same(one: Simulated, other: Simulated) -> bool:
    """Return whether two stations have the same samples."""
    return one.samples.keys() == other.samples.keys() and all(
        np.array_equal(one.samples[tag].value, other.samples[tag].value)
        and np.array_equal(one.samples[tag].time_s, other.samples[tag].time_s)
        for tag in one.samples
    )


def test_a_seed_makes_the_same_station_again_and_another_seed_another() -> None:
    one, again, other = (
        simulate(CHICAGO_SITE, 1, SimulationPlan(months=DAYS_4 / 4, cells=1, seed=seed)) for seed in (11, 11, 12)
    )
    assert same(one, again)
    assert not same(one, other)


def test_parts_of_a_record_have_the_weather_and_wear_of_the_whole_and_no_sample_between(clean: Simulated) -> None:
    parts = simulate(CHICAGO_SITE, 1, SimulationPlan(months=DAYS_4, cells=1, seed=11, segments=((0, 1), (2, 4))))
    whole, some = clean.truth, parts.truth
    np.testing.assert_array_equal(some.life.states, whole.life.states)
    np.testing.assert_array_equal(some.weather.dry, whole.weather.dry)
    day = np.arange(len(some.cells)) // 1440
    assert np.isnan(some.cells[day == 1]).all() and np.isfinite(some.cells[day != 1]).all()
    np.testing.assert_array_equal(some.cells[day == 0], whole.cells[day == 0])
    # A part begins from a plant at rest, which forgets that within hours.
    late = day == 3
    assert np.abs(some.cell("t_out", 1) - whole.cell("t_out", 1))[late].mean() < 0.5
    for samples in parts.samples.values():
        assert not ((samples.time_s >= 86400.0) & (samples.time_s < 2 * 86400.0)).any()
        assert np.isfinite(samples.value).all()


def test_a_ramp_of_a_plan_wears_the_plant_of_its_cell_alone_and_has_its_entry(clean: Simulated) -> None:
    loss = Ramp(1, "fill", 1, 3, -0.12)
    cleaned = Ramp(2, "uniformity", 0, 1, 0.05, "nozzle_cleaning")
    plan = replace(clean.plan, ramps=(loss, cleaned))
    worn = simulate(CHICAGO_SITE, 2, replace(plan, cells=2))
    before, after = (state_by_minute(one, 1)["fill"] for one in (clean, worn))
    day = np.arange(len(before)) / 1440.0
    np.testing.assert_allclose(after - before, -0.12 * np.clip((day - 1.0) / 2.0, 0.0, 1.0), atol=1e-9)
    np.testing.assert_array_equal(worn.truth.life.states[:, 2:], clean.truth.life.states[:, 2:])
    # The fan makes up for a part of the lost fill.
    late = (day > 3.0) & (clean.truth.cell("on", 1) > 0.5) & (worn.truth.cell("on", 1) > 0.5)
    speed, water = (worn.truth.cell(n, 1)[late] - clean.truth.cell(n, 1)[late] for n in ("speed", "t_out"))
    assert speed.mean() >= 0.0 and water.mean() + 0.02 * speed.mean() > 0.05
    done = [one for one in worn.truth.life.happenings if one.event == "nozzle_cleaning"]
    assert [(one.cell, one.minute) for one in done] == [(2, 1440)]


@pytest.mark.parametrize(
    "ramp", [Ramp(5, "fill", 0, 1, -0.1), Ramp(1, "rust", 0, 1, -0.1), Ramp(1, "fill", 1, 1, -0.1)]
)
def test_a_ramp_that_no_plant_can_have_is_refused(ramp: Ramp) -> None:
    with pytest.raises(ValueError, match="give a cell from 1 to 4, a state among fill, uniformity"):
        simulate(CHICAGO_SITE, 1, SimulationPlan(months=DAYS_4 / 4, cells=1, seed=11, ramps=(ramp,)))


def test_defects_change_the_record_and_not_the_plant(made: Simulated, clean: Simulated) -> None:
    assert np.array_equal(made.truth.cells, clean.truth.cells)
    kinds = {one.kind for one in made.seeded.defects}
    assert kinds >= {"stuck", "comms_gap", "duplicates", "unit_switch", "swap", "local_time", "humidity_latched"}
    assert not clean.seeded.defects
    (changed,) = made.seeded.of("range_change")
    (tag,) = changed.tags
    rows = [(kept.time_s >= changed.span[0]) & (kept.time_s < changed.span[1]) for kept in (made.samples[tag],)]
    before, after = (np.median(made.samples[tag].value[part]) for part in (~rows[0], rows[0]))
    assert tag not in {t for kind in ("unit_switch", "swap") for one in made.seeded.of(kind) for t in one.tags}
    assert abs(after - before) > 0.1 * abs(before)


def test_a_seeded_swap_gap_and_clock_are_in_the_samples(made: Simulated, clean: Simulated) -> None:
    gap = made.seeded.of("comms_gap")[0]
    true = {tag: made.samples[tag].time_s for tag in gap.tags if tag not in made.seeded.of("local_time")[0].tags}
    assert all(((time < gap.span[0]) | (time >= gap.span[1])).all() for time in true.values())
    late = made.samples["21-JI-1111.PV"].time_s[0] - clean.samples["21-JI-1111.PV"].time_s[0]
    assert late == pytest.approx(-5 * 3600.0, abs=600.0), "Chicago in May"


def test_an_undeclared_effect_warms_the_water_under_the_same_weather_and_load(clean: Simulated) -> None:
    for name in EFFECTS:
        other = simulate(CHICAGO_SITE, 1, SimulationPlan(months=DAYS_4, cells=1, seed=11, hide=(name,)))
        assert np.array_equal(other.truth.wet, clean.truth.wet)
        # The control answers with its fans: more power for the same water, or warmer water.
        warmer = float((other.truth.cell("t_out", 1) - clean.truth.cell("t_out", 1)).mean())
        harder = float((other.truth.cell("speed", 1) - clean.truth.cell("speed", 1)).mean())
        assert warmer > 0.02 or harder > 0.3, name
        assert other.answer["kind"] == name


def test_an_unknown_effect_is_refused_with_those_that_there_are() -> None:
    with pytest.raises(ValueError, match="no effect is called 'ghost'; those that can be hidden are recirculation"):
        hidden_effects(("ghost",), MIAMI_SITE, 1, np.random.default_rng(0))


def test_the_station_holds_its_water_and_its_process(clean: Simulated) -> None:
    station = {name: clean.truth.station[:, k].astype(float) for k, name in enumerate(OF_STATION)}
    assert 50.0 < station["level"].min() < station["level"].max() < 75.0
    # Over days the towers reject what the process gives, but for what the water in header and basin keeps.
    water = sum(
        clean.truth.cell("m_w", c) * (clean.truth.cell("t_in", c) - clean.truth.cell("t_out", c)) for c in range(1, 5)
    )
    rejected = 4.182 * np.asarray(water)[600:].mean()
    assert rejected == pytest.approx(station["load"][600:].mean(), rel=0.04)
    running = clean.truth.cell("on", 1) > 0.5
    assert (clean.truth.cell("t_out", 1)[running] > clean.truth.wet[running] - 0.5).all()


def test_files_are_those_that_the_alignment_reads_and_hold_no_truth(folder: Path) -> None:
    assert sorted(path.name for path in folder.iterdir()) == [
        "commissioning.csv",
        "datasheet.json",
        "events.csv",
        "labels.csv",
        "raw.parquet",
        "tags.csv",
    ]
    station = read_station(folder / "tags.csv", folder / "datasheet.json", folder / "events.csv")
    assert station.cells == (1,)
    assert not station.remarks
    table = pq.read_table(folder / "raw.parquet")
    assert set(table["tag"].unique().to_pylist()) == set(station.tags)
    assert set(table["quality"].unique().to_pylist()) == {192}
    with (folder / "commissioning.csv").open() as file:
        tests = list(csv.DictReader(file))
    assert len(tests) == 15
    assert all(float(row["water_outlet_C"]) > float(row["entering_wet_bulb_C"]) for row in tests)


def test_the_truth_and_the_key_are_written_for_scoring(made: Simulated, tmp_path: Path) -> None:
    write_station(made, tmp_path / "stationA", score=True)
    truth = pq.read_table(tmp_path / "stationA" / "truth.parquet")
    assert {"running", "t_out", "t_in", "twb", "m_w", "fill", "air", "uniformity", "bias", "flow_gain"} <= set(
        truth.column_names
    )
    assert truth.num_rows == 4 * 1440
    key = json.loads(json.dumps(key_of(made)))
    assert key["answer"] == {"kind": "none"}
    assert {"type", "from", "to"} <= set(key["defects"][0])


def test_the_outlet_tag_is_the_flume_with_lag_and_bias(clean: Simulated) -> None:
    samples, truth = clean.samples[OUTLET], clean.truth
    flume = np.interp(samples.time_s / 60.0, np.arange(len(truth.wet)), truth.cell("t_rtd", 1))
    off = np.median(samples.value - flume)
    assert off == pytest.approx(truth.life.bias[:4, 0].mean(), abs=0.03)


def test_recorded_cells_are_shared_among_the_stations() -> None:
    assert SimulationPlan(cells=1).recorded() == {"A": 1, "B": 0}
    assert SimulationPlan(cells=2).recorded() == {"A": 2, "B": 0}
    assert SimulationPlan(cells=3).recorded() == {"A": 2, "B": 1}
    assert SimulationPlan(cells=6).recorded() == {"A": 4, "B": 2}
