"""Contestants of `hil bench twin`: name, preparation of a job, and largest swarm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from hil.bench.kernel.windows import Job
from hil.bench.peers import Absent
from hil.bench.peers.formulas import sensor_rows
from twin import Array, Kernel, Network, TwinFileError, right_hand_side, simulate_exact

ALL = ("constant", "stepped", "each s")
HELD = ("constant", "stepped")


@dataclass(frozen=True, slots=True)
class Single:
    """One parameter vector: `prepare` gives a call that returns states (n, k). A quick run omits `slow` ones."""

    name: str
    prepare: Callable[[Job], Callable[[], Array]]
    schedules: tuple[str, ...] = ALL
    slow: bool = False
    solve_ivp: bool = False


@dataclass(frozen=True, slots=True)
class Swarm:
    """Many parameter vectors: `prepare` gives a call that returns costs (P,); `most` is the largest swarm."""

    name: str
    prepare: Callable[[Job], Callable[[], Array]]
    most: int
    schedules: tuple[str, ...] = ALL


def ours(job: Job) -> Callable[[], Array]:
    """Return costs (P,) of the generated kernel."""
    kernel = Kernel(job.network, job.ids)

    def cost() -> Array:
        sse, _ = kernel.cost(job.particles, job.state, job.time, job.inputs, job.measured, job.weight)
        total: Array = sse.sum(axis=1)
        return total

    return cost


def our_readings(job: Job) -> Callable[[], Array]:
    """Return readings (n, m) of particle 0 of the generated kernel."""
    kernel = Kernel(job.network, job.ids)
    return lambda: kernel.trace(job.particles[:1], job.state, job.time, job.inputs)[0][0]


def our_error(job: Job) -> float:
    """Return the largest error of our readings over all particles, K; infinite if one is not finite."""
    kernel, reads = Kernel(job.network, job.ids), sensor_rows(job.network)
    readings, _ = kernel.trace(job.particles, job.state, job.time, job.inputs)
    exact = np.stack([oracle(replace(job, particles=row[None]))[:, reads] for row in job.particles])
    error = np.abs(readings - exact)
    return float(error.max()) if np.isfinite(error).all() else float("inf")


def singles() -> list[Single]:
    """Return the contestants with one vector, in the order of the table."""
    from hil.bench.peers import scipy_ode

    def ivp(method: str, **options: float) -> Callable[[Job], Callable[[], Array]]:
        return lambda job: scipy_ode.ivp(job, method, **options)

    def restarted(method: str, **options: float) -> Callable[[Job], Callable[[], Array]]:
        return lambda job: scipy_ode.ivp_restarted(job, method, **options)

    def odeint(**options: float) -> Callable[[Job], Callable[[], Array]]:
        return lambda job: scipy_ode.lsoda(job, **options)

    return [
        Single("C, one vector", lambda job: _c(job, 1)[1]),
        Single("ivp RK45, defaults", ivp("RK45"), solve_ivp=True),
        Single("ivp LSODA, defaults", ivp("LSODA"), solve_ivp=True),
        Single("ivp Radau, defaults", ivp("Radau"), solve_ivp=True),
        Single("ivp DOP853, defaults", ivp("DOP853"), solve_ivp=True),
        Single("ivp RK45, step <= 1", ivp("RK45", max_step=1.0), solve_ivp=True),
        Single("ivp LSODA 1e-9, step <= 1", ivp("LSODA", rtol=1e-9, atol=1e-9, max_step=1.0), solve_ivp=True),
        Single("ivp LSODA 1e-9, restarted", restarted("LSODA", rtol=1e-9, atol=1e-9), solve_ivp=True),
        Single("ivp DOP853 1e-9, restarted", restarted("DOP853", rtol=1e-9, atol=1e-9), solve_ivp=True),
        Single("ivp RK45 1e-9, step <= 1", ivp("RK45", rtol=1e-9, atol=1e-9, max_step=1.0), ALL, True, True),
        Single("odeint, defaults", odeint()),
        Single("odeint 1e-9, step <= 1", odeint(rtol=1e-9, atol=1e-9, hmax=1.0)),
        Single("numpy + expm, our oracle", lambda job: lambda: oracle(job)),
    ]


def swarms() -> list[Swarm]:
    """Return the contestants with swarms, in the order of the table; ours first."""
    return [
        Swarm("ours", ours, 100_000),
        Swarm("C, 16 lanes", lambda job: _c(job, 16)[0], 100_000),
        Swarm("C, one by one", lambda job: _c(job, 1)[0], 10_000, ("each s",)),
        Swarm("numpy, exact", _numpy, 10_000, HELD),
        Swarm("torch, exact", _torch_exact, 10_000, HELD),
        Swarm("torch, RK4", _torch_steps, 10_000, ("each s",)),
        Swarm("jax, RK4", _jax, 100_000, ("stepped", "each s")),
    ]


def remembers(network: Network) -> bool:
    """Return True if the network's state is more than its temperatures (pipes, lags), so that no reference here covers
    it.
    """
    return Kernel(network, ()).size != len(network.nodes)


def oracle(job: Job) -> Array:
    """Return states (n, k) of particle 0, exact for a linear network, else by tight steps that never cross a jump."""
    p = job.particles[0]
    try:
        return simulate_exact(job.network, job.time, job.inputs, job.state, p)
    except TwinFileError:
        return tight(job.network, job.time, job.inputs, job.state, p)


def tight(network: Network, time: Array, inputs: Array, state: Array, p: Array) -> Array:
    """Return states (n, k) by eight Runge-Kutta steps a sample: the reference if no exponential exists."""
    rhs, out = right_hand_side(network), np.empty((len(time), len(state)))
    x = out[0] = state
    for i in range(len(time) - 1):
        h = (time[i + 1] - time[i]) / 8.0
        for _ in range(8):
            k1 = np.array(rhs(x, inputs[i], p))
            k2 = np.array(rhs(x + 0.5 * h * k1, inputs[i], p))
            k3 = np.array(rhs(x + 0.5 * h * k2, inputs[i], p))
            x = x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + np.array(rhs(x + h * k3, inputs[i], p)))
        out[i + 1] = x
    return out


def _c(job: Job, lanes: int) -> tuple[Callable[[], Array], Callable[[], Array]]:
    from hil.bench.peers.c_peer import prepared

    return prepared(job, lanes, order=5)


def _numpy(job: Job) -> Callable[[], Array]:
    from hil.bench.peers.numpy_peer import exact

    return exact(job)


def _torch_exact(job: Job) -> Callable[[], Array]:
    try:
        from hil.bench.peers import torch_peer
    except ImportError:
        raise Absent("torch: not installed (pip install -e '.[ml]')") from None
    return torch_peer.exact(job)


def _torch_steps(job: Job) -> Callable[[], Array]:
    try:
        from hil.bench.peers import torch_peer
    except ImportError:
        raise Absent("torch: not installed (pip install -e '.[ml]')") from None
    return torch_peer.runge_kutta(job)


def _jax(job: Job) -> Callable[[], Array]:
    try:
        from hil.bench.peers import jax_peer
    except ImportError:
        raise Absent("jax: not installed (pip install -e '.[bench]')") from None
    return jax_peer.runge_kutta(job)
