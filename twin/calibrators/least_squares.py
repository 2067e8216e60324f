"""Bounded least squares, window by window, with what earlier windows told as the prior.

The posterior of a window (parameters, in the optimiser's variables) widened by a process noise is the prior of
the next. The process noise grows with the error that the live twin made: a change of the rig opens the
parameters, quiet closes them. What a window cannot tell is held (see `posterior`). The initial state is estimated
with the carried state as its prior. The twin is not taken for the rig: samples are weighed, and standard errors
widened, for what its structure errs by (see `structure_error`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from twin.calibrators.base import Calibration, Window, normalised_misfit
from twin.calibrators.posterior import WindowPosterior, fit_window, limit_covariance, window_data
from twin.calibrators.results import CalibrationReport, fitted_calibration
from twin.calibrators.structural_error import MODEL_K, sample_sd, structural_covariance
from twin.gauss_newton import FitProblem, Scaling
from twin.kernel import Kernel
from twin.network import Array, Network

FIRST_SHARE = 0.3
"""Width of the first prior, round the commissioned values, as a share of the full prior."""
QUIET_SHARE = 0.02
"""Process noise per window, as a share of the full prior, while the live twin errs as a healthy one does."""


class LeastSquares:
    """The least-squares calibrator; satisfies `Calibrator`. Deterministic."""

    name = "least_squares"

    def __init__(self, network: Network, tunables: str | tuple[str, ...] = "nine") -> None:
        self.network = network
        self.ids = network.tunables(tunables)
        self.kernel = Kernel(network, self.ids)
        self._scaling = Scaling.of(network, self.ids)
        self._mean = self._scaling.to_z(network.values[self._scaling.index])
        self._covariance = np.diag((FIRST_SHARE * self._scaling.prior_sd()) ** 2)

    def calibrate(self, window: Window) -> Calibration:
        sigma, scaling = self.network.sigma, self._scaling
        wide = scaling.prior_sd()
        opened = np.clip(0.3 * (normalised_misfit(window, np.hypot(sigma, MODEL_K)) - 1.0), QUIET_SHARE, 1.0)
        prior = self._covariance + np.diag((opened * wide) ** 2)
        weight = sample_sd(sigma, window.time)
        noise = float(np.mean((sigma / weight) ** 2))
        done = fit_window(self.kernel, scaling, weight, window, self._mean, prior, window.state, noise=noise)
        if np.isfinite(done.fit.cost) and np.isfinite(done.covariance).all():
            self._mean = done.fit.v[: len(self.ids)].copy()
            self._covariance = limit_covariance(done.covariance, wide)
        return fitted_calibration(
            self.network, window, self.ids, done.fit.values, done.fit.state, done.fit.data.readings, done.fit.data.end,
            cost=float(np.sqrt(done.chi)), evaluations=(done.fit.evaluations + 1) * (1 + done.fit.v.size),
            report=self._report(window, done, weight),
        )  # fmt: skip

    def _report(self, window: Window, done: WindowPosterior, weight: Array) -> CalibrationReport:
        """What goes with the values: their covariance has the twin's structure in it, the next window's prior has not.

        Were it in the prior too, every window would begin with parameters that are as good as unknown.
        """
        scaling, wide = self._scaling, self._scaling.prior_sd()
        problem = FitProblem(self.kernel, scaling, window.parameters, window_data(window, weight), window.state)
        lasts = structural_covariance(problem, done.fit.v, done.fit.normal, done.held, window, wide, done.chi)
        return replace(done, covariance=limit_covariance(done.covariance + lasts, wide)).report(scaling)

    def state(self) -> dict[str, Any]:
        return {"mean": self._mean.tolist(), "covariance": self._covariance.tolist()}

    def restore(self, state: Mapping[str, Any]) -> None:
        self._mean = np.array(state["mean"], dtype=np.float64)
        self._covariance = np.array(state["covariance"], dtype=np.float64)
