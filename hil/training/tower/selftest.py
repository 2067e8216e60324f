"""Self-test of a device before anything is simulated: a few steps of both sizes on random windows, and their pace."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twin.calibrators.hiera_unet.tower import CellTable
from twin.calibrators.hiera_unet.tower.table import CHANNELS, SUBJECT, clock_of

if TYPE_CHECKING:
    from twin.calibrators.hiera_unet.model.trees import Trees

STEPS, TIMED = 12, 8
MINUTES = 4 * 1440


def random_table(seed: int) -> CellTable:
    """Return a table of random numbers in the shapes of a cell's."""
    rng = np.random.default_rng(seed)
    n, t = MINUTES, np.arange(MINUTES, dtype=np.float64)
    start = np.arange(SUBJECT.context - SUBJECT.target, n - SUBJECT.target + 1, SUBJECT.target)
    k = len(start)

    def noise(*shape: int, size: float = 1.0) -> NDArray[np.float32]:
        return rng.normal(0.0, size, shape).astype(np.float32)

    water = np.float32(28.0) + noise(n, size=0.1)
    reading = water + np.float32(0.1) + noise(n, size=0.05)
    return CellTable(
        name=f"R{seed:04d}_1",
        x=noise(n, len(CHANNELS)).astype(np.float16),
        m=rng.random((n, len(CHANNELS))) < 0.9,
        regime=rng.integers(0, SUBJECT.regimes, n).astype(np.uint8),
        clock=clock_of(60.0 * t),
        outlet=np.where(t % 5 == 0, reading, np.nan).astype(np.float32),
        reading=reading,
        water=water,
        slopes=noise(n, 3, size=0.2) - np.float32(2.0),
        chunk=(t // 4320).astype(np.int32),
        reference=noise(n // 4320 + 1, 3, size=0.02),
        commissioned=water - np.float32(0.2),
        true_water=water + noise(n, size=0.05),
        point=noise(n, 4).astype(np.float16),
        start=start.astype(np.int64),
        mean=noise(k, 4, size=0.03),
        sd=np.full((k, 4), 0.03, dtype=np.float32),
        fit=noise(k, 4, size=0.05),
        fit_sd=np.full((k, 4), 0.05, dtype=np.float32),
        true=noise(k, 4, size=0.04),
        condition=np.full(k, 200.0, dtype=np.float32),
        age_h=np.full(k, 0.2, dtype=np.float32),
        seen=np.full(k, 90.0, dtype=np.float32),
        kind=rng.integers(0, 5, k).astype(np.uint8),
        valid=np.ones(k, dtype=bool),
        jumped=np.zeros(k, dtype=bool),
        statics=noise(6),
        design=np.array([7.0, 4.0], dtype=np.float32),
        memory=noise(20, SUBJECT.memory),
        healthy_end=1440,
    )


def random_trees(seed: int = 0) -> Trees:
    """Return trees of one split each, of random numbers, for each figure that a network corrects."""
    from twin.calibrators.hiera_unet.model.trees import trees_from

    rng = np.random.default_rng(seed)
    shape = (1 + len(SUBJECT.deviations), 4, 3)
    arrays = {name: np.zeros(shape) for name in ("threshold", "missing", "feature", "value")}
    arrays["feature"][..., 0] = rng.integers(0, len(SUBJECT.deviations), shape[:2])
    arrays["value"][..., 1:] = rng.normal(0.0, 0.002, (*shape[:2], 2))
    left, right = (np.broadcast_to(np.array(one), shape) for one in ([1.0, 1.0, 2.0], [2.0, 1.0, 2.0]))
    return trees_from({**arrays, "left": left, "right": right, "base": np.zeros(shape[0])})


def check(device: str, work: Path, batches: Mapping[str, int]) -> list[str]:
    """Train, judge, write and read a network of each size on random windows; return a sentence for each.

    Parameters
    ----------
    batches
        Windows of a step by size.

    Raises
    ------
    HieraError, RuntimeError
        The device cannot do it.
    """
    from twin.calibrators.hiera_unet.tower import Fleet, MemberTraining, TowerPlan, adapt, load_member
    from twin.calibrators.hiera_unet.tower.member import MONTH_MIN
    from twin.calibrators.hiera_unet.tower.predict import predict
    from twin.calibrators.hiera_unet.weights.device import ready

    ready(device, 1 if device == "cpu" else 2)
    fleet = Fleet([random_table(0), random_table(1)], device)
    said = []
    for size, batch in batches.items():
        plan = TowerPlan(steps=STEPS + TIMED, batch=batch, even_every=4, half=device != "cpu")
        training = MemberTraining(size, plan, fleet, fleet, None, "selftest", random_trees().to(fleet.device))
        for _ in range(STEPS):
            training.trainer.step()
        began = time.monotonic()
        for _ in range(TIMED):
            found = training.trainer.step()
        assert found is not None  # every tenth step is read, which waits for the device
        pace = (time.monotonic() - began) / TIMED
        gate = training.gate(16)
        path = work / f"selftest_{size}.safetensors"
        training.write(path, gate, {})
        network = load_member(path, blind_too=True).network.to(fleet.device)
        predict(network, fleet, fleet.rows[:4], half=plan.half)
        months = float(fleet.minutes.min()) / MONTH_MIN
        adapt(network, fleet, fleet, replace(plan, steps=2), time.monotonic() + 5.0, months)
        said.append(f"{size}: {1e3 * pace:.0f} ms a step of {batch} windows, {network.count()} weights")
    return said
