"""What heat in one block of time does to every reading, against runs with that heat in them."""

from __future__ import annotations

import numpy as np
import pytest

from tests.discovery.conftest import Bench
from twin.discovery.effects.probe import Probe
from twin.discovery.records.grid import on_grid
from twin.discovery.scoring.score_tests import block_edges
from twin.network import Network


def lagging(bench: Bench) -> Network:
    return bench.with_values(T_heater_C__lag_s=30.0)


def piped(bench: Bench) -> Network:
    return bench.with_element("hose", {"kind": "pipe", "to": "modules", "volume": 1.5})


@pytest.mark.parametrize("variant", [None, lagging, piped])
def test_responses_to_blocks_of_heat_are_those_of_runs_with_that_heat(bench: Bench, variant) -> None:
    network = bench.network if variant is None else variant(bench)
    record = bench.record(3.0, seed=5)
    grid = on_grid(network, record.time_s, record.inputs, record.measured)
    probe = Probe(network, network.tunables())
    state, edges = probe.first_state(grid), block_edges(len(grid.time), 30)
    found = probe.blocks(grid, state, edges)
    for b, k in ((0, 0), (7, 3), (12, 1), (29, 2)):
        heat = np.zeros((len(grid.time), probe.k, 1))
        heat[edges[b] : edges[b + 1], k, 0] = 10.0
        change = probe.responses(grid, state, heat)[:, :, 0] / 10.0
        means = np.add.reduceat(change, edges[:-1], axis=0) / np.diff(edges)[:, None]
        # Means of a block are of its beginnings of bins, those of a run of their middles.
        assert np.abs(found[:, :, b, k] - means).max() < 0.04 * np.abs(means).max()
        assert np.abs(found[:b, :, b, k]).max(initial=0.0) == 0.0
        later = slice(b + 2, None)
        if b + 2 < len(means):
            assert found[later, :, b, k] == pytest.approx(means[later], rel=0.02, abs=2e-3 * np.abs(means).max())
