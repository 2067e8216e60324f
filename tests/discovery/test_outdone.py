"""What changes from hour to hour is not told as something that is simply there, however well that fits."""

from __future__ import annotations

import numpy as np
import pytest
from twin.discovery.answer.spells import explained, outdone

from tests.discovery.conftest import Bench
from twin.discovery.evidence.part import Part
from twin.discovery.healthy.basis import Columns, basis
from twin.discovery.places.localise import courses
from twin.discovery.places.sites import sites_of
from twin.discovery.records.grid import on_grid
from twin.kernel import Kernel
from twin.network import Network

HOURS, ONSET_H, PERIOD_H = 16.0, 6.0, 2.6


def on_and_off(bench: Bench, warmer: Network, share: float) -> Columns:
    """The loop with the heat of `warmer` for a share of every period from the onset on."""
    t, u = bench.inputs(HOURS, 1)
    hours = t / 3600.0
    on = (hours >= ONSET_H) & ((hours - ONSET_H) % PERIOD_H < share * PERIOD_H)
    edges = [0, *(np.flatnonzero(np.diff(on)) + 1).tolist(), len(t)]
    state, parts = np.array([37.0, 36.8, 34.5, 34.0]), []
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        network = warmer if on[low] else bench.network
        until = min(high + 1, len(t))
        read, ends = Kernel(network, ()).trace(network.values, state, t[low:until], u[low:until])
        parts.append(read[0][: high - low])
        state = ends[0][: len(network.nodes)]
    y = np.vstack(parts)
    return Columns(t, u, y + bench.network.sigma * np.random.default_rng(3).normal(0.0, 1.0, y.shape))


@pytest.mark.parametrize(("share", "freer"), [(1.0, False), (0.6, True)])
def test_a_free_unknown_outdoes_a_constant_source_only_where_none_was(
    bench: Bench, healthy: Columns, share: float, freer: bool
) -> None:
    warmer = bench.with_element("leak", {"kind": "heat_source", "node": "tank", "power": {"value": 60.0}})
    record = on_and_off(bench, warmer, share)
    grid = on_grid(bench.network, record.time_s, record.inputs, record.measured)
    part = Part.of(basis(bench.network, healthy, grid), grid)
    constant = next(e for e in part.entries if e.label == ("heat_source", "tank", "constant"))
    gain = explained(part.contest, part.laws, (constant,))
    free = courses(part.contest, sites_of(bench.network, part.contest, part.laws))[0]
    assert constant.z > 20.0 and gain > 400.0
    assert outdone(gain, free) is freer
