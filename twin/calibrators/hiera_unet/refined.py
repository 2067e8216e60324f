"""The network proposes, least squares disposes: two fits of each window, of which the better one counts.

One begins where least squares alone would, the other from the network's proposal with its own uncertainty, for the
parameters whose gates are open. The second counts only if it explains the window's own data clearly better. So what
the network has seen in two hours can lead the fit out of a wrong place, and can never make it explain less.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from twin.calibrators.base import Calibration, Window, misfit
from twin.calibrators.hiera_unet.service import HieraUNetCalibrator, Proposal
from twin.calibrators.least_squares import QUIET_SHARE, LeastSquares
from twin.calibrators.outcome import conclude
from twin.calibrators.posterior import Posterior, fit_window, no_wider
from twin.network import Array, Network

BETTER = 0.98
"""Share of the weighted squares that the second fit must stay below."""


class RefinedCalibrator(LeastSquares):
    """Network, then least squares; satisfies `Calibrator`. Deterministic.

    Args:
        network_calibrator: the network.
    """

    name = "hiera_ls"

    def __init__(self, network: Network, network_calibrator: HieraUNetCalibrator, tunables: str = "nine") -> None:
        super().__init__(network, tunables)
        self.proposing = network_calibrator

    def calibrate(self, window: Window) -> Calibration:
        sigma, scaling = self.network.sigma, self._scaling
        wide = scaling.prior_sd()
        opened = np.clip(0.3 * (misfit(window, sigma) - 1.0), QUIET_SHARE, 1.0)
        prior = self._covariance + np.diag((opened * wide) ** 2)
        proposal = self.proposing.propose(window)
        done = fit_window(self.kernel, scaling, sigma, window, self._mean, prior, window.state)
        evaluations, led = done.fit.evaluations, False
        if not proposal.held.all():
            mean, covariance = self._led(proposal, prior)
            second = fit_window(
                self.kernel, scaling, sigma, window, mean, covariance, window.state, told=done.told
            )  # fmt: skip
            evaluations += second.fit.evaluations
            led = float(second.fit.sse.sum()) < BETTER * float(done.fit.sse.sum())
            done = second if led else done
        self._keep(done, wide)
        report = done.report(scaling)
        said = "led by the network" if led else "on its own: the network's proposal explains no more"
        flags = (*report.flags, said if not proposal.held.all() else "on its own: the network's gates are closed")
        return conclude(
            self.network, window, self.ids, done.fit.values, done.fit.state, done.fit.data.readings, done.fit.data.end,
            cost=float(np.sqrt(done.chi)), evaluations=evaluations * (1 + done.fit.v.size) + proposal.evaluations,
            report=type(report)(report.covariance, flags, report.frozen, report.alone, report.condition),
        )  # fmt: skip

    def _led(self, proposal: Proposal, prior: Array) -> tuple[Array, Array]:
        """Mean (q,) and covariance (q, q) in z with the network's where its gates are open."""
        free, scaling = ~proposal.held, self._scaling
        mean, covariance = self._mean.copy(), prior.copy()
        mean[free] = scaling.to_z(proposal.values)[free]
        covariance[free, :] = 0.0
        covariance[:, free] = 0.0
        sd = np.minimum(proposal.sd / np.abs(scaling.slope(proposal.values)), scaling.prior_sd())
        covariance[free, free] = sd[free] ** 2
        return mean, covariance

    def _keep(self, done: Posterior, wide: Array) -> None:
        if np.isfinite(done.fit.cost) and np.isfinite(done.covariance).all():
            self._mean = done.fit.v[: len(self.ids)].copy()
            self._covariance = no_wider(done.covariance, wide)

    def state(self) -> dict[str, Any]:
        return {**super().state(), "network": self.proposing.state()}

    def restore(self, state: Mapping[str, Any]) -> None:
        super().restore(state)
        self.proposing.restore(state["network"])
