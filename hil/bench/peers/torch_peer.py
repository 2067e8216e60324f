"""Solver with torch, eager, double precision, one thread: exact steps for held inputs, else classical Runge-Kutta."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from hil.bench.kernel import Job
from hil.bench.peers.formulas import affine, right_side_of, runs, sensor_rows, vector_of
from twin import Array


def exact(job: Job) -> Callable[[], Array]:
    """Return costs (P,) by one `matrix_exp` for each level and one batched product for each sample."""
    torch.set_num_threads(1)
    reads, k = sensor_rows(job.network), len(job.state)
    measured, weight = torch.from_numpy(job.measured), torch.from_numpy(job.weight)

    def cost() -> Array:
        with torch.inference_mode():
            count = len(job.particles)
            x = torch.from_numpy(np.tile(job.state, (count, 1))[:, :, None])
            total = torch.zeros(count, dtype=torch.float64)
            for first, stop in runs(job.inputs):
                a, b = affine(job.network, job.ids, job.particles, job.inputs[first])
                block = torch.zeros((count, k + 1, k + 1), dtype=torch.float64)
                block[:, :k, :k], block[:, :k, k] = torch.from_numpy(a), torch.from_numpy(b)
                step = torch.linalg.matrix_exp(block)
                transition, offset = step[:, :k, :k].contiguous(), step[:, :k, k:].contiguous()
                for i in range(first, stop):
                    total += (((x[:, reads, 0] - measured[i]) * weight[i]) ** 2).sum(1)
                    x = torch.baddbmm(offset, transition, x)
            total += (((x[:, reads, 0] - measured[-1]) * weight[-1]) ** 2).sum(1)
            return total.numpy()

    return cost


def runge_kutta(job: Job) -> Callable[[], Array]:
    """Return costs (P,) by one classical Runge-Kutta step a second, for any inputs."""
    torch.set_num_threads(1)

    def largest(a: Any, b: Any) -> Any:
        return torch.clamp(a, min=b) if isinstance(a, torch.Tensor) else max(a, b)

    rhs = right_side_of(job.network, _exp, np.log, largest)
    reads = sensor_rows(job.network)

    def cost() -> Array:
        with torch.inference_mode():
            p = vector_of(job.network, job.ids, torch.from_numpy(job.particles))
            zero = torch.zeros(len(job.particles), dtype=torch.float64)
            x = torch.from_numpy(np.repeat(job.state[:, None], len(job.particles), axis=1))
            total = zero.clone()

            def slope(x: Any, u: Any) -> Any:
                return torch.stack([zero + row for row in rhs(x, u, p)])

            for i, u in enumerate(job.inputs.tolist()):
                for j, node in enumerate(reads):
                    total += ((x[node] - job.measured[i, j]) * job.weight[i, j]) ** 2
                k1 = slope(x, u)
                k2 = slope(x + 0.5 * k1, u)
                k3 = slope(x + 0.5 * k2, u)
                x = x + (k1 + 2.0 * (k2 + k3) + slope(x + k3, u)) / 6.0
            return total.numpy()

    return cost


def _exp(x: Any) -> Any:
    return torch.exp(x) if isinstance(x, torch.Tensor) else np.exp(x)
