"""Bounded least squares, window by window, with earlier windows as the prior.

The posterior of a window (parameters, in the optimiser's variables), widened by a process noise, is the prior of
the next. The process noise grows with the error of the live twin: a change of the rig opens the parameters, quiet
closes them. Parameters that are not identifiable in a window are held (see `posterior`). The initial state is estimated
with the carried state as its prior. Samples are weighed, and standard errors widened, for the structural error of the
twin (see `structural_error`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from twin.calibrators.base import Calibration, Window, normalised_misfit
from twin.calibrators.posterior import WindowPosterior, WindowPrior, fit_window, limit_covariance, window_data
from twin.calibrators.results import CalibrationReport, WindowFit, fitted_calibration
from twin.calibrators.structural_error import HeldParameters, model_error, sample_sd, structural_covariance
from twin.gauss_newton import FitProblem, Scaling
from twin.kernel import Kernel
from twin.network import Array, Network

FIRST_SHARE = 0.3
"""Width of the first prior, around the commissioned values, as a share of the full prior."""
QUIET_SHARE = 0.02
"""Process noise per window, as a share of the full prior, while the live twin's error is that of a healthy one."""


class LeastSquares:
    """Least-squares calibrator; satisfies `Calibrator`. Deterministic."""

    name = "least_squares"

    def __init__(self, network: Network, tunables: str | tuple[str, ...] = "nine") -> None:
        self.network = network
        self.ids = network.tunables(tunables)
        self.kernel = Kernel(network, self.ids)
        self._scaling = Scaling.of(network, self.ids)
        self._mean = self._scaling.to_z(network.values[self._scaling.index])
        self._covariance = np.diag((FIRST_SHARE * self._scaling.prior_sd()) ** 2)

    def calibrate(self, window: Window) -> Calibration:
        """Fit the tunables and the initial state to a window."""
        sigma, scaling = self.network.sigma, self._scaling
        wide = scaling.prior_sd()
        opened = np.clip(
            0.3 * (normalised_misfit(window, np.hypot(sigma, model_error(self.network))) - 1.0), QUIET_SHARE, 1.0
        )
        prior = self._covariance + np.diag((opened * wide) ** 2)
        weight = sample_sd(self.network, window.time)
        noise = float(np.mean((sigma / weight) ** 2))
        before = WindowPrior(self._mean, prior, window.state)
        done = fit_window(self.kernel, scaling, weight, window, before, noise=noise)
        if np.isfinite(done.fit.cost) and np.isfinite(done.covariance).all():
            self._mean = done.fit.v[: len(self.ids)].copy()
            self._covariance = limit_covariance(done.covariance, wide)
        evaluations = (done.fit.evaluations + 1) * (1 + done.fit.v.size)
        result = WindowFit.of(done.fit, float(np.sqrt(done.chi)), evaluations)
        return fitted_calibration(self.network, window, self.ids, result, self._report(window, done, weight))

    def _report(self, window: Window, done: WindowPosterior, weight: Array) -> CalibrationReport:
        """Return the report; its covariance includes the twin's structural error, the next window's prior does not.

        With it in the prior, every window would begin with parameters that are as good as unknown.
        """
        scaling, wide = self._scaling, self._scaling.prior_sd()
        problem = FitProblem(self.kernel, scaling, window.parameters, window_data(window, weight), window.state)
        held = HeldParameters.of(done)
        lasts = structural_covariance(problem, done.fit.v, done.fit.normal, held, window, wide, done.chi)
        return replace(done, covariance=limit_covariance(done.covariance + lasts, wide)).report(scaling)

    def state(self) -> dict[str, Any]:
        """Return everything needed to continue, as plain data."""
        return {"mean": self._mean.tolist(), "covariance": self._covariance.tolist()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from a saved `state`."""
        self._mean = np.array(state["mean"], dtype=np.float64)
        self._covariance = np.array(state["covariance"], dtype=np.float64)
