"""What an effect does not say quite rightly of itself is not told as another one."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from tests.discovery.conftest import HOUR, Bench
from twin.discovery.engine import diagnose
from twin.discovery.healthy.basis import Columns
from twin.kernel import Kernel

PIECE_S = HOUR / 12


def growing(bench: Bench, amount: Callable[[float], float], **coming: float) -> Columns:
    """Twenty hours of the loop while parameters change by `coming` times an amount of time, every five minutes."""
    t, u = bench.inputs(20.0, 1)
    changes = {name.replace("__", "."): by for name, by in coming.items()}
    kernel, values = Kernel(bench.network, tuple(changes)), bench.network.values
    edges = np.append(np.searchsorted(t, np.arange(0.0, t[-1], PIECE_S)), len(t) - 1)
    state, parts = np.array(bench.start_C), []
    for low, high in pairwise(edges.tolist()):
        now = values.copy()
        now[bench.network.index(tuple(changes))] += amount(0.5 * (t[low] + t[high])) * np.array([*changes.values()])
        read, ends = kernel.trace(now, state, t[low : high + 1], u[low : high + 1])
        parts.append(read[0][:-1])
        state = ends[0][: len(bench.network.nodes)]
    y = np.vstack(parts)
    return Columns(t[:-1], u[:-1], y + bench.network.sigma * np.random.default_rng(3).normal(0.0, 1.0, y.shape))


def test_fouling_that_ends_in_the_last_hours_is_one_effect(pair: Bench, pair_healthy: Columns) -> None:
    change = -0.35 * pair.network.parameters["fins.UA_100"].value
    record = growing(pair, lambda t: float(np.clip((t - 3.0 * HOUR) / (13.6 * HOUR), 0.0, 1.0)), fins__UA_100=change)
    found = diagnose(pair.network, record, pair_healthy)
    assert found.verdict == "effect found"
    (effect,) = found.effects
    assert (effect.kind, effect.where, effect.driver) == ("heat_rejection", "tank", "elapsed_time")
    assert effect.value == pytest.approx(change, rel=0.05)
