"""Steady states: the temperatures at which nothing changes while the inputs are held.

Newton steps on the right-hand side find them; one step is exact for a network that is affine in its temperatures.
Where they go to and fro, as across the opening of a valve, implicit Euler steps of doubling length come to rest.
Simulating until it rests would take as long as the slowest node.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from twin.kernel import Kernel, hold_inputs
from twin.network import Array, Network, TwinFileError
from twin.reference_simulation import right_hand_side

_MOST_STATES = 1024
_PROBE_K = 1.0e-3
_RESTS_K = 1.0e-9
_SLOWEST_S = 1.0e9
"""A node slower than this never comes to rest; its heat has no way out."""
_FIRST_S, _DOUBLINGS = 1.0, 40
"""First implicit Euler step, of a fast volume's seconds, and its doublings: beyond `_SLOWEST_S` such a step is a Newton
step."""


def steady_state(
    network: Network,
    inputs: ArrayLike,
    parameters: ArrayLike | None = None,
    start: ArrayLike | None = None,
    most: int = 50,
) -> Array:
    """Find the node temperatures at rest.

    Parameters
    ----------
    network
        The network.
    inputs
        (c,) or (n, c), held; each row has a steady state of its own.
    parameters
        Full vector (p,); the network's own by default.
    start
        (k,) degC to begin from; matters only where a network has several steady states.
    most
        Largest number of Newton steps.

    Returns
    -------
    ndarray
        (k,) or (n, k) in degC, in the order of ``network.nodes``. Delays and lags have passed; memory is at rest.

    Raises
    ------
    TwinFileError
        A row has no steady state, because heat has no way out or too much comes in.
    """
    u = hold_inputs(network, inputs)
    values = network.values if parameters is None else np.asarray(parameters, dtype=np.float64)
    rhs = right_hand_side(network)
    # The right-hand side also takes the states of elements, after the nodes; the length of its result is their number.
    size, nodes = len(rhs(np.full(_MOST_STATES, 25.0), u[0], values)), len(network.nodes)
    guess = np.full(size, 25.0)
    if start is not None:
        guess[:nodes] = np.asarray(start, dtype=np.float64)
        guess[nodes:] = guess[:nodes].mean()
    rows = []
    for i, row in enumerate(u):
        state = guess.copy()
        steps_s = [np.inf] * most + [_FIRST_S * 2.0**k for k in range(_DOUBLINGS)]
        for k, step_s in enumerate(steps_s):
            if k == most:
                state = guess.copy()
            rate = np.array(rhs(state, row, values))
            probes = state + np.diag(np.full(state.size, _PROBE_K))
            slope = (np.array([rhs(probe, row, values) for probe in probes]) - rate).T / _PROBE_K
            # Heat that cannot leave shows as a rate that no temperature of its own opposes.
            if np.linalg.eigvals(slope).real.max() > -1.0 / _SLOWEST_S:
                raise TwinFileError(
                    f"twin {network.name!r} has no steady state at row {i} of the inputs: heat has no way out of it"
                )
            step = np.linalg.solve(slope - np.eye(state.size) / step_s, -rate)
            state = state + np.clip(step, -100.0, 100.0)
            if np.abs(step).max() < _RESTS_K * max(1.0, float(np.abs(state).max())) and step_s > _SLOWEST_S:
                break
        else:
            raise TwinFileError(f"twin {network.name!r} does not come to rest at row {i} of the inputs")
        rows.append(state[:nodes])
    return rows[0] if np.ndim(inputs) == 1 else np.array(rows)


def steady_readings(network: Network, inputs: ArrayLike, parameters: ArrayLike | None = None) -> Array:
    """Return the sensors' readings at rest, (n, m) degC in the order of ``network.sensor_names``, for inputs (n, c)."""
    u = hold_inputs(network, inputs)
    values = network.values if parameters is None else np.asarray(parameters, dtype=np.float64)
    states = steady_state(network, u, values)
    kernel = Kernel(network, ())
    now = np.zeros(1)
    return np.array([kernel.trace(values, s, now, u[i : i + 1])[0][0, 0] for i, s in enumerate(states)])
