"""Reference simulations: slow, and independent of the generated kernels except for the elements' formulas.

`simulate_exact` is the exact zero-order-hold simulation of a linear network by matrix exponentials; it refuses a
network whose right-hand side is not affine in the temperatures. `simulate_fine_steps` takes small steps, for networks
with pipes and lags: it stores every piece of water that ever entered a pipe. Tests compare both with the kernels.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from twin.kernel import clean_time, define_functions, evaluate_formula, hold_inputs, with_stamps
from twin.network import Array, Network, TwinFileError
from twin.network.assembly import NetworkEquations
from twin.network.reference_source import python_source, stateful_source

Rhs = Callable[[Array, Array, Array], list[float]]


def right_hand_side(network: Network) -> Rhs:
    """Return ``rhs(T (k,), u (c,), p (full vector)) -> dT/dt`` in K/s, as plain Python."""
    rhs: Rhs = define_functions(python_source(network), f"<right side of {network.name}>")["rhs"]
    return rhs


def simulate_exact(
    network: Network, time: ArrayLike, inputs: ArrayLike, state: ArrayLike, parameters: ArrayLike | None = None
) -> Array:
    """Simulate a linear network exactly, to rounding, by matrix exponentials.

    Parameters
    ----------
    network, time, inputs, state, parameters
        As for `twin.kernel.simulate`.

    Returns
    -------
    ndarray
        Node temperatures (n, k) in degC.

    Raises
    ------
    TwinFileError
        The network is not linear in its temperatures.
    """
    from scipy.linalg import expm

    t = clean_time(time)
    u = with_stamps(network, t, hold_inputs(network, inputs))
    p = network.values if parameters is None else np.asarray(parameters, dtype=np.float64)
    rhs, k = right_hand_side(network), len(network.nodes)
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
    """Return A and b of dT/dt = A T + b at inputs `u`."""
    b = np.array(rhs(np.zeros(k), u, p))
    a = np.column_stack([np.array(rhs(np.eye(k)[j], u, p)) - b for j in range(k)])
    probe = np.linspace(-40.0, 90.0, k)
    if not np.allclose(rhs(probe, u, p), a @ probe + b, rtol=1e-9, atol=1e-9):
        raise TwinFileError(f"twin {name!r} is not linear in its temperatures; it has no matrix exponential")
    return a, b


def simulate_fine_steps(
    network: Network, time: ArrayLike, inputs: ArrayLike, state: ArrayLike, pieces: int = 100
) -> Array:
    """Simulate a network with pipes and lags, from node temperatures (k,) and all memory at rest.

    Parameters
    ----------
    network, time, inputs, state
        As for `twin.kernel.simulate`.
    pieces
        Equal steps per sample interval.

    Returns
    -------
    ndarray
        Readings (n, m) in degC.

    Raises
    ------
    TwinFileError
        The network has actuators, or elements with a memory of samples.

    Notes
    -----
    Heun's method. Water is followed by the volume that has been pushed in behind it, on a straight line between its
    values at the ends of steps: the error is of second order in the step.
    """
    system = NetworkEquations(network, ())
    if system.drives or system.memories:
        what = "actuators" if system.drives else "elements with a memory of samples"
        raise TwinFileError(f"twin {network.name!r} has {what}, which the slow simulation does not know")
    scope = define_functions(stateful_source(system), f"<{network.name}, remembering>")
    t, p = clean_time(time), network.values.tolist()
    u = with_stamps(network, t, hold_inputs(network, inputs))
    x = np.concatenate([np.asarray(state, dtype=np.float64), np.empty(len(system.states) - len(network.nodes))])
    at_rest = {f"x{j}": float(v) for j, v in enumerate(x)} | {f"u{j}": float(v) for j, v in enumerate(u[0])}
    at_rest |= {f"p{j}": float(v) for j, v in enumerate(p)}
    rest = [evaluate_formula(text, at_rest) for text in system.rest_values]
    x[len(network.nodes) :] = rest[: len(x) - len(network.nodes)]
    lagged = np.array(rest[len(x) - len(network.nodes) :])
    pipes = [_PipeWater(evaluate_formula(d.start, at_rest)) for d in system.delays]
    out = [scope["read"](x.tolist(), lagged.tolist(), u[0].tolist(), p, float(t[0]))]
    for i in range(t.size - 1):
        now, h = u[i].tolist(), float(t[i + 1] - t[i]) / pieces
        flows, volumes, constants = scope["pushed"](now, p)
        lag = np.array(constants)
        early = [q.outlet(v) for q, v in zip(pipes, volumes, strict=True)]
        for q, w in zip(pipes, scope["now"](x.tolist(), early, now, p)[1], strict=True):
            q.push(w, 0.0)  # inputs jump at samples, and the water with them
        for _ in range(pieces):
            early = [q.outlet(v) for q, v in zip(pipes, volumes, strict=True)]
            first, water, seen = map(np.array, scope["now"](x.tolist(), early, now, p))
            for q, w, flow in zip(pipes, water, flows, strict=True):
                q.push(w, flow * h)
            late = [q.outlet(v) for q, v in zip(pipes, volumes, strict=True)]
            second = np.array(scope["now"]((x + h * first).tolist(), late, now, p)[0])
            x = x + 0.5 * h * (first + second)
            _, water, seen_then = map(np.array, scope["now"](x.tolist(), late, now, p))
            for q, w in zip(pipes, water, strict=True):
                q.correct(w)
            lagged = _followed(lagged, seen, seen_then, lag, h)
        out.append(scope["read"](x.tolist(), lagged.tolist(), u[i + 1].tolist(), p, float(t[i + 1])))
    return np.array(out)


class _PipeWater:
    """All water that ever entered a pipe, at volumes counted from the beginning."""

    def __init__(self, water: float) -> None:
        self.volumes, self.waters, self.found = [-1.0e9, 0.0], [water, water], 0

    def outlet(self, volume: float) -> float:
        """Return the water that went in `volume` litres ago."""
        at, v = self.volumes[-1] - volume, self.volumes
        while self.found + 2 < len(v) and v[self.found + 1] <= at:
            self.found += 1
        k = self.found
        if v[k + 1] <= v[k]:
            return self.waters[k + 1]
        share = (at - v[k]) / (v[k + 1] - v[k])
        return self.waters[k] + share * (self.waters[k + 1] - self.waters[k])

    def push(self, water: float, litres: float) -> None:
        """Append water after `litres` more."""
        self.volumes.append(self.volumes[-1] + litres)
        self.waters.append(water)

    def correct(self, water: float) -> None:
        """Set the water at the end of the latest step, once it is known."""
        self.waters[-1] = water


def _followed(value: Array, before: Array, after: Array, constant: Array, h: float) -> Array:
    """Return a first-order lag after a step in which its input is a straight line; exact for that."""
    ratio = constant / max(h, 1e-300)
    decay = np.exp(-1.0 / np.maximum(ratio, 1e-12))
    rise = after - before
    return np.asarray(after - ratio * rise + decay * (value - before + ratio * rise))
