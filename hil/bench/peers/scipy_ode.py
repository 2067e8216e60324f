"""Solvers of scipy on one particle. The right side is one matrix product with coefficients made beforehand."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.integrate import odeint, solve_ivp

from hil.bench.kernel import Job
from hil.bench.peers.formulas import affine, runs
from twin import Array

Solve = Callable[[], Array]


def coefficients(job: Job) -> tuple[Array, Array]:
    """Return A (n, k, k) and b (n, k) of particle 0 in every sample interval."""
    distinct, which = np.unique(job.inputs, axis=0, return_inverse=True)
    pairs = [affine(job.network, job.ids, job.particles[:1], row) for row in distinct]
    a = np.stack([pair[0][0] for pair in pairs])
    b = np.stack([pair[1][0] for pair in pairs])
    return a[which.ravel()], b[which.ravel()]


def ivp(job: Job, method: str, **options: float) -> Solve:
    """Solve the whole window with `solve_ivp`, states (n, k)."""
    a, b = coefficients(job)
    last = len(job.time) - 2

    def slope(t: float, x: Array) -> Array:
        i = min(int(t), last)
        return np.asarray(a[i] @ x + b[i])

    span = (float(job.time[0]), float(job.time[-1]))
    return lambda: solve_ivp(slope, span, job.state, method=method, t_eval=job.time, **options).y.T


def ivp_restarted(job: Job, method: str, **options: float) -> Solve:
    """Solve with `solve_ivp`, restarted at every change of an input, so that no step crosses a jump."""
    a, b = coefficients(job)
    stretches = runs(job.inputs)

    def solve() -> Array:
        out = np.empty((len(job.time), len(job.state)))
        x = out[0] = job.state
        for first, stop in stretches:
            here, offset = a[first], b[first]
            times = job.time[first : stop + 1]
            done = solve_ivp(
                lambda t, x, here=here, offset=offset: here @ x + offset,
                (times[0], times[-1]),
                x,
                method=method,
                t_eval=times[1:],
                **options,
            )
            out[first + 1 : stop + 1] = done.y.T
            x = done.y[:, -1]
        return out

    return solve


def lsoda(job: Job, **options: float) -> Solve:
    """Solve the whole window with `odeint`."""
    a, b = coefficients(job)
    last = len(job.time) - 2

    def slope(x: Array, t: float) -> Array:
        i = min(int(t), last)
        return np.asarray(a[i] @ x + b[i])

    return lambda: np.asarray(odeint(slope, job.state, job.time, **options))
