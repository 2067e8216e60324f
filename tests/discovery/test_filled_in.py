"""Water that is filled in for a time: an everyday event of a tank, named with its place, its time and its amount."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.discovery.conftest import Bench
from twin.discovery.effects.catalogue import catalogue
from twin.discovery.effects.laws import CandidateLaw
from twin.discovery.effects.probe import Probe
from twin.discovery.effects.shapes import Shape
from twin.discovery.engine import diagnose
from twin.discovery.healthy.basis import Columns
from twin.discovery.refit.model import Model
from twin.discovery.scoring.search import Entry
from twin.elements.candidates import Candidate
from twin.kernel import Kernel

BEGUN_H = 5.0


def filled(bench: Bench, water_C: float, share: float, seconds: float) -> Columns:
    """A record of a tank of which a share of the content is replaced, evenly over some seconds."""
    time, inputs = bench.inputs(10.0, 1)
    tank, steps = bench.network.nodes.index("tank"), max(int(seconds / (time[1] - time[0])), 1)
    first = int(np.searchsorted(time, bench.hour_s * BEGUN_H))
    cuts = [0, *range(first, first + steps), len(time)]
    state, kernel, parts = np.array(bench.start_C), Kernel(bench.network, ()), []
    for low, high in zip(cuts[:-1], cuts[1:], strict=True):
        rows = slice(low, min(high + 1, len(time)))
        read, ends = kernel.trace(bench.network.values, state, time[rows], inputs[rows])
        parts.append(read[0][: high - low])
        state = ends[0][: len(bench.network.nodes)].copy()
        if high < len(time):
            state[tank] += (1.0 - (1.0 - share) ** (1.0 / steps)) * (water_C - state[tank])
    measured = np.vstack(parts)
    noise = np.random.default_rng(3).normal(0.0, 1.0, measured.shape)
    return Columns(time, inputs, measured + bench.network.sigma * noise)


@pytest.mark.parametrize(("word", "water_C", "seconds"), [("cold", 10.0, 120.0), ("hot", 60.0, 5.0)])
def test_water_that_is_filled_in_is_named_with_its_time_and_amount(
    slow_pair: Bench, slow_pair_healthy: Columns, word: str, water_C: float, seconds: float
) -> None:
    share = 0.1
    found = diagnose(slow_pair.network, filled(slow_pair, water_C, share, seconds), slow_pair_healthy)
    assert found.verdict == "effect found"
    (effect,) = found.effects
    assert (effect.kind, effect.where, effect.unit) == ("heat_source", "tank", "kg/s")
    assert effect.onset_s == pytest.approx(slow_pair.hour_s * BEGUN_H, abs=60.0)
    content = slow_pair.network.parameters["tank.capacitance"].value / 4180.0
    assert effect.value * effect.growth_s == pytest.approx(-np.log1p(-share) * content, rel=0.1)
    assert f"{word} water" in effect.says and "kg in all" in effect.says
    assert found.network is None  # it has passed: the twin lacks nothing


def entry_of(candidate: Candidate, shape: Shape, size: float) -> Entry:
    return Entry(CandidateLaw(candidate, None, None), shape, np.empty(0), size, 0.0, 0.0)


@pytest.mark.parametrize("name", ["transient", "pulse"])
def test_what_is_soon_over_is_simulated_the_same_alone_and_beside_others(bench: Bench, name: str) -> None:
    """Fits try several times side by side; what is found so has to hold when it is simulated alone."""
    time, inputs = bench.inputs(3.0, 1)
    time, inputs = np.ascontiguousarray(time[::2]), np.ascontiguousarray(inputs[::2])
    candidate = next(c for c in catalogue(bench.network) if c.unit == "kg/s" and c.where == "tank")
    one = Shape(name, 4003.0, 31.0)
    others = tuple(replace(one, onset_s=4003.0 + k, growth_s=31.0 + k) for k in (-7.0, 9.0, 300.0))
    model = Model.of(Probe(bench.network, ()), (entry_of(candidate, one, 0.2),))

    def run(shapes: tuple[Shape, ...]) -> np.ndarray:
        count = len(shapes)
        state, values = np.tile([37.0, 36.8, 34.5, 34.0], (count, 1)), np.tile(bench.network.values, (count, 1))
        return model.run(time, inputs, state, values, np.full((count, 1), 0.2), tuple((s,) for s in shapes))

    alone, beside, without = run((one,))[0], run((one, *others))[0], run((replace(one, onset_s=1e5),))[0]
    most, off = np.abs(without - alone).max(), np.abs(beside - alone)
    assert most > 0.5
    assert off.max() < 0.1 * most  # a pulse is held for a part of its time constant at once
    assert off[time > one.onset_s + 600.0].max() < 1e-3 * most
