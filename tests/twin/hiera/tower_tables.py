"""Tables of a made cell: smooth operation, a twin with known slopes, and readings with a bias that the belief lacks."""

from __future__ import annotations

import numpy as np

from twin.calibrators.hiera_unet.tower.cell_table import CellTable
from twin.calibrators.hiera_unet.tower.table import CHANNELS, SUBJECT, clock_of

BIAS = 0.15


def made_table(name: str = "made_1", seed: int = 0, minutes: int = 2 * 1440) -> CellTable:
    """Table of a record of `minutes` whose outlet is sampled every fourth minute."""
    rng = np.random.default_rng(seed)
    n, t = minutes, np.arange(minutes)
    water = 28.0 + np.sin(2 * np.pi * t / 1440) + rng.normal(0, 0.02, n)
    slopes = np.stack([-2.0 + 0.2 * np.cos(t / 300.0), -3.0 + 0.1 * np.sin(t / 100.0), -2.5 + 0 * t], axis=1)
    true_water = water + slopes @ np.array([-0.03, 0.01, 0.0]) + 0.05 * np.sin(t / 40.0)
    reading = true_water + BIAS
    outlet = np.where(t % 4 == 0, reading, np.nan)
    x = rng.normal(0, 0.5, (n, len(CHANNELS))).astype(np.float16)
    m = rng.random((n, len(CHANNELS))) < 0.95
    start = np.arange(1320, n - 120 + 1, 120)
    k = len(start)
    return CellTable(
        name=name,
        x=x,
        m=m,
        regime=np.full(n, 3, dtype=np.uint8),
        clock=clock_of(60.0 * t),
        outlet=outlet.astype(np.float32),
        reading=reading.astype(np.float32),
        water=water.astype(np.float32),
        slopes=slopes.astype(np.float32),
        chunk=(t // 720).astype(np.int32),
        reference=np.zeros((n // 720 + 1, 3), dtype=np.float32),
        commissioned=(water - 0.2).astype(np.float32),
        true_water=true_water.astype(np.float32),
        point=rng.normal(0, 0.3, (n, 4)).astype(np.float16),
        start=start,
        mean=np.tile(np.array([-0.02, 0.0, -0.01, 0.05], dtype=np.float32), (k, 1)),
        sd=np.tile(np.array([0.02, 0.015, 0.02, 0.08], dtype=np.float32), (k, 1)),
        fit=np.zeros((k, 4), dtype=np.float32),
        fit_sd=np.full((k, 4), 0.05, dtype=np.float32),
        true=np.tile(np.array([-0.03, 0.01, 0.0, BIAS], dtype=np.float32), (k, 1)),
        condition=np.full(k, 100.0, dtype=np.float32),
        age_h=np.full(k, 0.1, dtype=np.float32),
        seen=np.full(k, 100.0, dtype=np.float32),
        kind=(np.arange(k) % 5).astype(np.uint8),
        valid=np.ones(k, dtype=bool),
        jumped=np.zeros(k, dtype=bool),
        statics=np.zeros(6, dtype=np.float32),
        design=np.array([7.0, 4.0], dtype=np.float32),
        memory=rng.normal(0, 1, (20, SUBJECT.memory)).astype(np.float32),
        healthy_end=600,
    )
