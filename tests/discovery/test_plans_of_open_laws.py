"""What a plan expects of a law without a name: heat that follows a column, and an error of reading."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.discovery.conftest import Bench
from twin.discovery.effects.shapes import Shape
from twin.discovery.evidence.part import Part, fitted
from twin.discovery.healthy.basis import Columns, basis
from twin.discovery.planning.design import Runner
from twin.discovery.records.grid import on_grid
from twin.discovery.scoring.search import Entry
from twin.network import Array


@pytest.fixture(scope="module")
def part(bench: Bench, healthy: Columns) -> Part:
    record = bench.record(8.0, seed=7)
    grid = on_grid(bench.network, record.time_s, record.inputs, record.measured)
    return Part.of(basis(bench.network, healthy, grid), grid)


def planned(part: Part, site: str, size: float) -> tuple[Array, Array]:
    """Return readings (n, m) of half an hour as planned, less those without the law, and the law's values (n,)."""
    law = next(
        law for law in part.open_candidates if law.site.name == site and law.candidate.adopts["form"] == "linear"
    )
    entry = Entry(law, Shape("step", 0.0), np.empty(0), size, 1.0, 0.0)
    ((plain, _),) = fitted(part, [()], 1)
    known, rows = part.basis, slice(0, 60)
    time, inputs = part.grid.time[rows], part.grid.inputs[rows]
    found = []
    for fit in (replace(plain, entries=(entry,)), plain):
        sizes = np.array([size] if fit.entries else [])
        runner = Runner(known.probe, fit, sizes, known.prior, part.state)
        found.append(runner.advance(runner.state, time, inputs)[0])
    assert law.candidate.follows is not None
    return found[0] - found[1], law.candidate.follows(time, inputs)


def test_an_error_of_reading_is_there_at_once_and_at_its_thermometer_alone(part: Part, bench: Bench) -> None:
    off, values = planned(part, "read_T_tank_C", 0.001)
    j = bench.network.sensor_names.index("T_tank_C")
    assert off[:, j] == pytest.approx(0.001 * values, abs=1e-6) and np.abs(values).max() > 100.0
    assert np.abs(np.delete(off, j, axis=1)).max() < 1e-9


def test_heat_that_is_moved_warms_one_place_and_cools_the_other(part: Part, bench: Bench) -> None:
    off, _ = planned(part, "transfer_heater_tank", 0.2)
    at = [bench.network.sensor_names.index(name) for name in ("T_heater_C", "T_tank_C")]
    assert off[-1, at[0]] > 0.05 and off[:30, at[1]].min() < -0.005
