"""The oracle: exact zero-order-hold simulation of a linear network by matrix exponentials, in plain numpy/scipy.

Slow and independent of the generated kernels but for the elements' formulas; tests compare the two, and a
network whose right side is not affine in the temperatures is refused.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from twin.assembly import python_source
from twin.kernel import clean_time, held
from twin.network import Array, Network, TwinFileError

Rhs = Callable[[Array, Array, Array], list[float]]


def right_side(network: Network) -> Rhs:
    """``rhs(T (k,), u (c,), p (full vector)) -> dT/dt`` in K/s, as plain Python."""
    scope: dict[str, Rhs] = {}
    exec(compile(python_source(network), f"<right side of {network.name}>", "exec"), scope)
    return scope["rhs"]


def simulate_exact(
    network: Network, time: ArrayLike, inputs: ArrayLike, state: ArrayLike, parameters: ArrayLike | None = None
) -> Array:
    """Node temperatures (n, k) in degC of a linear network, exact to rounding.

    Raises:
        TwinFileError: the network is not linear in its temperatures.
    """
    from scipy.linalg import expm

    t, u = clean_time(time), held(network, inputs)
    p = network.values if parameters is None else np.asarray(parameters, dtype=np.float64)
    rhs, k = right_side(network), len(network.nodes)
    known: dict[tuple[float, bytes], tuple[Array, Array]] = {}
    out = np.empty((t.size, k))
    out[0] = np.asarray(state, dtype=np.float64)
    for i in range(t.size - 1):
        dt = float(t[i + 1] - t[i])
        key = (round(dt, 12), u[i].tobytes())
        if key not in known:
            a, b = _affine(rhs, u[i], p, k, network.name)
            block = np.zeros((k + 1, k + 1))
            block[:k, :k], block[:k, k] = a * dt, b * dt
            e = expm(block)
            known[key] = (e[:k, :k], e[:k, k])
        transition, offset = known[key]
        out[i + 1] = transition @ out[i] + offset
    return out


def _affine(rhs: Rhs, u: Array, p: Array, k: int, name: str) -> tuple[Array, Array]:
    """A and b of dT/dt = A T + b at inputs `u`."""
    b = np.array(rhs(np.zeros(k), u, p))
    a = np.column_stack([np.array(rhs(np.eye(k)[j], u, p)) - b for j in range(k)])
    probe = np.linspace(-40.0, 90.0, k)
    if not np.allclose(rhs(probe, u, p), a @ probe + b, rtol=1e-9, atol=1e-9):
        raise TwinFileError(f"twin {name!r} is not linear in its temperatures; it has no matrix exponential")
    return a, b
