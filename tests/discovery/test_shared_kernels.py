"""Effects that are numbers of one shared kernel do what they do as elements of their own."""

from __future__ import annotations

import numpy as np
import pytest

from tests.discovery.conftest import Bench
from twin.discovery.effects.catalogue import catalogue
from twin.discovery.effects.laws import CandidateLaw
from twin.discovery.effects.probe import Probe
from twin.discovery.effects.shapes import Shape
from twin.discovery.healthy.basis import Columns
from twin.discovery.records.grid import on_grid
from twin.discovery.refit.model import Model
from twin.discovery.scoring.search import Entry

SHAPES = (Shape("step", 7200.0), Shape("ramp", 3600.0, 10_000.0), Shape("saturating", 5400.0, 4000.0))


@pytest.mark.parametrize(
    "kinds",
    [
        ("heat_source", "flow"),
        ("heat_loss", "heat_rejection"),
        ("sensor", "actuator"),
        ("thermal_mass", "heat_source", "coupling"),
    ],
)
def test_a_set_of_effects_reads_the_same_in_the_shared_kernel_and_alone(
    bench: Bench, healthy: Columns, kinds: tuple[str, ...]
) -> None:
    network = bench.network
    grid = on_grid(network, healthy.time_s, healthy.inputs, healthy.measured).part(0, 1440)
    probe = Probe(network, network.tunables())
    state = probe.first_state(grid)[None, :]
    chosen = [
        next(c for c in catalogue(network)[::-1] if c.kind == kind and not c.replaces and c.driver != "temperature")
        for kind in kinds
    ]
    entries = tuple(
        Entry(
            CandidateLaw(c, None, None),
            shape if "ramp" in c.shapes else Shape("step", 7200.0),
            np.empty(0),
            1.0,
            0.0,
            0.0,
        )
        for c, shape in zip(chosen, SHAPES, strict=False)
    )
    assert probe.kernels.holding(tuple(chosen)) is not None
    sizes = np.array([[c.typical for c in chosen]])
    models = Model.of(probe, entries), Model.alone(probe, entries)
    shared, alone = (m.run(grid.time, grid.inputs, state, network.values[None, :], sizes)[0] for m in models)
    plain = Model.alone(probe, ()).run(grid.time, grid.inputs, state, network.values[None, :], np.empty((1, 0)))[0]
    assert np.abs(alone - plain).max() > 1e-3
    assert np.abs(shared - alone).max() < 1e-6


def test_what_bends_or_delays_is_compiled_by_itself(bench: Bench) -> None:
    probe = Probe(bench.network, bench.network.tunables())
    for kind, driver in (("delay", "history"), ("heat_loss", "temperature"), ("actuator", "history")):
        found = next(c for c in catalogue(bench.network) if (c.kind, c.driver) == (kind, driver))
        assert probe.kernels.holding((found,)) is None
