"""Bounded least squares, window by window, with earlier windows as the prior.

The posterior of a window (parameters, in the optimiser's variables), widened by a process noise, is the prior of
the next. The process noise grows with the error of the live twin: a change of the rig opens the parameters, quiet
closes them. Parameters that are not identifiable in a window are held (see `posterior`). The initial state is estimated
with the carried state as its prior. Samples are weighed, and standard errors widened, for the structural error of the
twin (see `structural_error`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from twin.calibrators.base import Calibration, Window
from twin.calibrators.posterior import ParameterBelief, fit_window
from twin.calibrators.results import WindowFit, fitted_calibration
from twin.gauss_newton import Scaling
from twin.kernel import Kernel
from twin.network import Network


class LeastSquares:
    """Least-squares calibrator; satisfies `Calibrator`. Deterministic."""

    name = "least_squares"

    def __init__(self, network: Network, tunables: str | tuple[str, ...] = "nine") -> None:
        self.network = network
        self.ids = network.tunables(tunables)
        self.kernel = Kernel(network, self.ids)
        self._scaling = Scaling.of(network, self.ids)
        self._parameters = ParameterBelief(network, self._scaling)

    def calibrate(self, window: Window) -> Calibration:
        """Fit the tunables and the initial state to a window."""
        belief = self._parameters
        weight, noise = belief.weight(window)
        done = belief.take(fit_window(self.kernel, self._scaling, weight, window, belief.before(window), noise=noise))
        evaluations = (done.fit.evaluations + 1) * (1 + done.fit.v.size)
        result = WindowFit.of(done.fit, float(np.sqrt(done.chi)), evaluations)
        return fitted_calibration(self.network, window, self.ids, result, done.report(self._scaling))

    def state(self) -> dict[str, Any]:
        """Return everything needed to continue, as plain data."""
        return {"mean": self._parameters.mean.tolist(), "covariance": self._parameters.covariance.tolist()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from a saved `state`."""
        self._parameters.mean = np.array(state["mean"], dtype=np.float64)
        self._parameters.covariance = np.array(state["covariance"], dtype=np.float64)
