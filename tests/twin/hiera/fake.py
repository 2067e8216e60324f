"""Windows of a plant that needs no kernel: two parameters move its outputs, and the twin lacks some structure."""

from __future__ import annotations

from typing import Any

import numpy as np

from twin.calibrators.hiera_unet.data.windows import Windows
from twin.calibrators.hiera_unet.model.config import Config, named

GROUPS = (2, 3)
TOLD = np.array([False, False, True, True, True])


def config(**other: Any) -> Config:
    """A network as small as the stages allow."""
    sizes: dict[str, Any] = {
        "groups": GROUPS,
        "bounds": (1.1, 1.1),
        "tolerances": (0.3, 0.3),
        "meta": 13,
        "evidence": True,
        "group_dim": 8,
        "dims": (16, 16, 32, 32),
        "depths": (1, 1, 1, 1),
        "head_dim": 16,
        **other,
    }
    return named("small", **sizes)


def windows(count: int, seed: int = 0, healthy: float = 0.5) -> Windows:
    """Two outputs, two parameters, inputs of one column; evidence with an error of 0.1."""
    rng = np.random.default_rng(seed)
    n, target = 1440, 120
    u = np.repeat(rng.normal(size=(count, 24)), n // 24, axis=1)
    theta = np.where(rng.random((count, 1)) < healthy, 0.0, rng.uniform(-0.8, 0.8, (count, 2)))
    shape = np.stack([u, np.roll(u, 7, axis=1) ** 2 - 1.0], -1)
    lacking = 0.5 * np.stack([np.roll(u, 3, axis=1), -u], -1)
    response = shape * theta[:, None, :]
    base = np.stack([40.0 + u, 30.0 - u], -1)
    truth = base + response + lacking
    measured = truth + 0.02 * rng.normal(size=truth.shape)
    x = np.concatenate([u[..., None], np.roll(u, 7, axis=1)[..., None], measured - base, measured[..., :1] - 40.0], -1)
    sd = np.full((count, 2), 0.1)
    evidence = theta + 0.1 * rng.normal(size=theta.shape)
    meta = np.concatenate(
        [rng.normal(size=(count, 2)), evidence, sd, 0.9 * evidence, 0.9 * sd, 0.0 * sd + 0.5, np.ones((count, 1))], 1
    )
    last = slice(n - target, n)
    return Windows(
        x=x.astype(np.float32),
        m=rng.random(x.shape) > 0.02,
        regime=np.full((count, n), 7, dtype=np.int8),
        clock=np.zeros((count, n, 6), dtype=np.float32),
        meta=meta.astype(np.float32),
        target=measured[:, last].astype(np.float32),
        truth=truth[:, last].astype(np.float32),
        base=base[:, last].astype(np.float32),
        state=np.zeros((count, 2)),
        inputs=np.stack([u, np.roll(u, 7, axis=1)], -1)[:, last],
        theta=theta.astype(np.float32),
        known=np.ones((count, 2), dtype=bool),
        changed=np.zeros(count, dtype=bool),
        nominal=np.repeat(np.arange(-(-count // 2), dtype=np.float64), 2)[:count, None],
    )


def simulate(theta: Any, rows: Windows) -> Any:
    """The twin: right in everything but what it lacks."""
    import torch

    u = torch.from_numpy(rows.inputs).to(theta)
    response = torch.stack([u[..., 0], u[..., 1] ** 2 - 1.0], -1)
    return torch.from_numpy(rows.base).to(theta) + response * theta[:, None, :]
