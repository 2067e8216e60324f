"""Steady states of one network at many operating points and parameter sets at once.

Newton steps on the right-hand side, vectorised by numpy; `twin.steady` computes a single state.
"""

from __future__ import annotations

import numpy as np

from twin.discovery.effects.formulas import ARRAYS
from twin.kernel import Kernel, define_functions
from twin.network import Array, Network, TwinFileError
from twin.network.reference_source import python_source

MOST = 60
"""Newton steps at most."""
RESTS_K = 1.0e-7
"""Largest step at which a state is steady, K."""
LONGEST_K = 50.0
"""Longest step of a temperature, K: rates are not linear further off."""
_PROBE_K = 1.0e-3
"""Step of the differences, K."""


class SteadyStates:
    """Steady states of a network; parameters without influence on them (of masses, lags, delays) must not be varied."""

    def __init__(self, network: Network, kernel: Kernel) -> None:
        self.network, self._kernel = network, kernel
        self._rhs = define_functions(python_source(network), f"<{network.name} at rest>", ARRAYS)["rhs"]

    def readings(self, inputs: Array, parameters: Array) -> Array:
        """Return the readings of the sensors (P, n, m), degC.

        Args:
            inputs: (n, c), each row an operating point. parameters: (P, p) full vectors.

        Raises:
            TwinFileError: a point has no steady state.
        """
        states = self._states(inputs, parameters)
        now, out = np.zeros(1), np.empty((len(parameters), len(inputs), len(self.network.sensors)))
        for i in range(len(inputs)):
            out[:, i] = self._kernel.trace(parameters, np.ascontiguousarray(states[:, i]), now, inputs[i : i + 1])[0][
                :, 0
            ]
        return out

    def _states(self, inputs: Array, parameters: Array) -> Array:
        """Return the node temperatures (P, n, k), degC."""
        count, n, k = len(parameters), len(inputs), len(self.network.nodes)
        p = np.repeat(parameters, n, axis=0).T
        u = np.tile(inputs, (count, 1)).T
        x = np.full((k, count * n), 25.0)

        def rates(at: Array) -> Array:
            return np.stack(
                [np.broadcast_to(np.asarray(r, dtype=np.float64), at.shape[1]) for r in self._rhs(at, u, p)]
            )

        for _ in range(MOST):
            now = rates(x)
            if len(now) != k:
                raise TwinFileError(f"twin {self.network.name!r} has elements that remember; at rest they tell nothing")
            slope = np.stack([(rates(x + _PROBE_K * np.eye(k)[:, [j]]) - now) / _PROBE_K for j in range(k)], axis=1)
            try:
                step = np.linalg.solve(np.moveaxis(slope, 2, 0), -now.T[:, :, None])[:, :, 0].T
            except np.linalg.LinAlgError:
                raise TwinFileError(f"twin {self.network.name!r} has no steady state: heat has no way out") from None
            x = x + np.clip(step, -LONGEST_K, LONGEST_K)
            if not np.abs(step).max() > RESTS_K:
                break
        return x.T.reshape(count, n, k)
