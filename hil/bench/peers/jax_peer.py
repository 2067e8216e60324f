"""Solver with jax on the processor, jit and scan, double precision: one classical Runge-Kutta step a second."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hil.bench.kernel import Job
from hil.bench.peers.formulas import right_side_of, sensor_rows, vector_of
from twin import Array


def runge_kutta(job: Job) -> Callable[[], Array]:
    """Return costs (P,). The state is one array (P,) for each node: it compiles to far faster code than matrices."""
    jax.config.update("jax_enable_x64", True)
    rhs = right_side_of(job.network, jnp.exp, jnp.log, jnp.maximum)
    reads, count, k = sensor_rows(job.network), len(job.particles), len(job.state)

    @jax.jit
    def cost(particles: Any, inputs: Any, measured: Any, weight: Any) -> Any:
        p = vector_of(job.network, job.ids, particles)

        def slope(x: Any, u: Any) -> Any:
            return tuple(jnp.broadcast_to(row, (count,)) for row in rhs(x, u, p))

        def along(x: Any, h: float, d: Any) -> Any:
            return tuple(a + h * b for a, b in zip(x, d, strict=True))

        def step(carry: Any, row: Any) -> Any:
            x, total = carry
            u, y, w = row
            for j, node in enumerate(reads):
                total = total + ((x[node] - y[j]) * w[j]) ** 2
            k1 = slope(x, u)
            k2 = slope(along(x, 0.5, k1), u)
            k3 = slope(along(x, 0.5, k2), u)
            k4 = slope(along(x, 1.0, k3), u)
            x = tuple(x[i] + (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]) / 6.0 for i in range(k))
            return (x, total), None

        start = tuple(jnp.full(count, value) for value in job.state)
        return jax.lax.scan(step, (start, jnp.zeros(count)), (inputs, measured, weight))[0][1]

    return lambda: np.asarray(cost(job.particles, job.inputs, job.measured, job.weight))
