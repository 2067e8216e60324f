"""Bounded least squares, window by window, with what earlier windows told as the prior.

The posterior of a window (parameters, in the optimiser's variables) widened by a process noise is the prior of
the next, so that a direction that no single window can tell is still pinned by many. The process noise grows
with the error that the live twin made: a change of the rig opens the parameters, quiet closes them. The
initial state is estimated with the carried state as its prior.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from twin.calibrators.base import Calibration, Window
from twin.calibrators.outcome import conclude
from twin.gauss_newton import Data, Prior, Scaling, descend
from twin.kernel import Kernel, masked
from twin.network import Array, Network

FIRST_SHARE = 0.3
"""Width of the first prior, round the commissioned values, as a share of the full prior."""
QUIET_SHARE = 0.02
"""Process noise per window, as a share of the full prior, while the live twin errs by noise only."""
CANNOT_TELL = 0.5


class LeastSquares:
    """The least-squares calibrator; satisfies `Calibrator`. Deterministic."""

    name = "least_squares"

    def __init__(self, network: Network, tunables: str = "nine") -> None:
        self.network = network
        self.ids = network.tunables(tunables)
        self.kernel = Kernel(network, self.ids)
        self._scaling = Scaling.of(network, self.ids)
        self._index = network.index(self.ids)
        self._mean = self._scaling.to_z(network.values[self._index])
        self._covariance = np.diag((FIRST_SHARE * self._scaling.prior_sd()) ** 2)

    def calibrate(self, window: Window) -> Calibration:
        q, k = len(self.ids), window.state.size
        sigma = self.network.sigma
        y, weight = masked(window.measured, sigma)
        data = Data(window.time, window.inputs, y, weight)
        count = max(int((weight > 0.0).sum()), 1)
        misfit = float(np.sqrt((((window.live - y) * weight) ** 2).sum() / count))
        wide = self._scaling.prior_sd()
        opened = np.clip(0.3 * (misfit - 1.0), QUIET_SHARE, 1.0)
        covariance = self._covariance + np.diag((opened * wide) ** 2)
        state_sd = max(window.error_K, 0.02)
        prior = Prior(
            np.concatenate([self._mean, window.state]),
            _blocks(np.asarray(np.linalg.inv(covariance)), np.eye(k) / state_sd**2),
        )
        start = self._scaling.to_values(self._mean)
        fit = descend(self.kernel, self._scaling, window.parameters, data, start, window.state, prior, most=25)
        chi = max(float(fit.sse.sum()) / count, 1.0)
        posterior = np.linalg.inv(fit.normal / chi + prior.precision)[:q, :q]
        self._mean = self._scaling.to_z(fit.values)
        self._covariance = _no_wider(0.5 * (posterior + posterior.T), wide)
        spread = np.sqrt(np.diag(posterior))
        flags = [
            f"cannot tell {name}" for name, s, w in zip(self.ids, spread, wide, strict=True) if s > CANNOT_TELL * w
        ]
        flags += [f"{name} at its bound" for name, hit in zip(self.ids, fit.at_bound, strict=True) if hit]
        slope = self._scaling.slope(fit.values)
        return conclude(
            self.network, self.kernel, window, self.ids, fit.values, fit.state,
            cost=np.sqrt(chi), covariance=posterior * np.outer(slope, slope), flags=tuple(flags),
            evaluations=fit.evaluations * (1 + q + k),
        )  # fmt: skip

    def state(self) -> dict[str, Any]:
        return {"mean": self._mean.tolist(), "covariance": self._covariance.tolist()}

    def restore(self, state: Mapping[str, Any]) -> None:
        self._mean = np.array(state["mean"], dtype=np.float64)
        self._covariance = np.array(state["covariance"], dtype=np.float64)


def _blocks(a: Array, b: Array) -> Array:
    out = np.zeros((len(a) + len(b), len(a) + len(b)))
    out[: len(a), : len(a)], out[len(a) :, len(a) :] = a, b
    return out


def _no_wider(covariance: Array, wide: Array) -> Array:
    """Shrink a covariance whose standard deviations exceed `wide`, keeping its correlations."""
    factor = np.minimum(wide / np.sqrt(np.diag(covariance)), 1.0)
    return covariance * np.outer(factor, factor)
