"""Solver with numpy: the exact solution by matrix exponentials, all particles at once, sample by sample."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import expm

from hil.bench.kernel import Job
from hil.bench.peers.formulas import affine, runs, sensor_rows
from twin import Array


def exact(job: Job) -> Callable[[], Array]:
    """Return costs (P,), the sum of squared weighted residuals; one exponential for each particle and level of the
    inputs.
    """
    reads, k = sensor_rows(job.network), len(job.state)

    def cost() -> Array:
        count = len(job.particles)
        x = np.tile(job.state, (count, 1))[:, :, None]
        total = np.zeros(count)
        for first, stop in runs(job.inputs):
            a, b = affine(job.network, job.ids, job.particles, job.inputs[first])
            block = np.zeros((count, k + 1, k + 1))
            block[:, :k, :k], block[:, :k, k] = a, b
            step = expm(block)
            transition, offset = step[:, :k, :k].copy(), step[:, :k, k, None].copy()
            for i in range(first, stop):
                r = (x[:, reads, 0] - job.measured[i]) * job.weight[i]
                total += np.einsum("pm,pm->p", r, r)
                x = transition @ x + offset
        r = (x[:, reads, 0] - job.measured[-1]) * job.weight[-1]
        return total + np.einsum("pm,pm->p", r, r)

    return cost
