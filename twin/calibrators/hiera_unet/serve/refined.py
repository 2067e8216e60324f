"""Network calibrator refined by least squares.

Least squares runs as if it were alone, except for thermometers that the network excludes: its twin, prior and state are
independent of the network's. Beside it, a second fit covers the longest segment up to now that one set of parameters
explains (`evidence`), with the network's prediction as the prior where its gates are open. The second fit replaces the
first only if it explains the latest minutes far better. That is so after a change of the rig inside the window, which
least squares alone fits as a whole. In the middle of a window, too, the live twin switches to the second fit if that
explains the latest minutes far better than the twin itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twin.calibrators.base import Calibration, Window, from_json, to_json
from twin.calibrators.hiera_unet.context_fit.evidence import (
    HORIZONS,
    LEAST_CHI,
    ContextFit,
    ParameterPrior,
    estimate,
    step_noise,
)
from twin.calibrators.hiera_unet.context_fit.holding import NARROWEST
from twin.calibrators.hiera_unet.data.features import Frame
from twin.calibrators.hiera_unet.data.series import STEP_S, binned
from twin.calibrators.hiera_unet.data.windows import CONTEXT, TARGET
from twin.calibrators.hiera_unet.serve import gates
from twin.calibrators.hiera_unet.serve.proposal import Proposal
from twin.calibrators.hiera_unet.serve.service import CYCLE_S, HieraUNetCalibrator
from twin.calibrators.least_squares import LeastSquares
from twin.calibrators.results import CalibrationReport, WindowFit, fitted_calibration
from twin.calibrators.windows import WindowSamples, make_window
from twin.network import Array, Network

BETTER = 3.0
"""Ratio of mean squares over the latest minutes by which the second fit must be better."""
LATEST_S = HORIZONS[-1] * STEP_S


@dataclass(frozen=True)
class _LeastSquaresState:
    """State of the twin of least squares alone: time s, inputs (c,), state, full parameters (p,)."""

    time: float
    inputs: Array
    state: Array
    parameters: Array


class RefinedCalibrator(LeastSquares):
    """Network, then least squares; satisfies `Calibrator` and `Proposer`. Deterministic.

    Args:
        network_calibrator: the network.
    """

    name = "hiera_ls"
    cycle_s = CYCLE_S

    def __init__(self, network: Network, network_calibrator: HieraUNetCalibrator, tunables: str = "nine") -> None:
        super().__init__(network, tunables)
        self.proposing = network_calibrator
        self._left: _LeastSquaresState | None = None

    def calibrate(self, window: Window) -> Calibration:
        before = self._scaling.to_values(self._parameters.mean)
        proposal = self.proposing.propose(window)
        window = self.proposing.trusted(window)
        alone = super().calibrate(self._apart(window))
        self._left = _LeastSquaresState(float(window.time[-1]), window.inputs[-1].copy(), alone.end, self._full(alone))
        if any(r.code in gates.UNREADABLE for r in proposal.reasons):
            return self._said(alone, window, proposal, "on its own: the network's gates are closed")
        led = self._led(window, self._belief(proposal, before), alone)
        if not self._far_better(window, led.fitted, alone.fitted):
            return self._said(
                alone, window, proposal, "on its own: the network's proposal explains no more", led.evaluations
            )
        return self._said(led, window, proposal, "led by the network", alone.evaluations)

    def between(self, window: Window) -> tuple[Array, Array] | None:
        """Return values and state of the second fit if it explains the latest minutes far better than the live twin,
        else None.

        Least squares alone is not affected.
        """
        proposal = self.proposing.propose(window)
        window = self.proposing.trusted(window)
        if any(r.code in gates.UNREADABLE for r in proposal.reasons):
            return None
        values, readings, end, _ = self._fit(
            window, self._belief(proposal, self._scaling.to_values(self._parameters.mean))
        )
        better = self._far_better(window, _over(window.live, readings), window.live)
        return (values, end) if better else None

    def take(self) -> tuple[dict[str, Any], ...]:
        """Return nothing: the network's proposals are those of `hiera_unet`, and are discarded here."""
        self.proposing.take()
        return ()

    def _apart(self, window: Window) -> Window:
        """Return the window as least squares alone would have received it."""
        left, rules = self._left, self.network.rules
        if left is None or window.time[0] - left.time > rules.window_s:
            return window
        time = np.concatenate([[left.time], window.time[:1]])
        inputs = np.vstack([left.inputs, window.inputs[:1]])
        state = self.kernel.trace(left.parameters, left.state, time, inputs)[1][0]
        live = self.kernel.trace(left.parameters, state, window.time, window.inputs)[0][0]
        found = make_window(
            window.number,
            WindowSamples(window.time, window.inputs, window.measured, window.read),
            state,
            left.parameters,
            live,
            rules,
        )
        return replace(found, kind=window.kind)

    def _led(self, window: Window, belief: ParameterPrior, alone: Calibration) -> Calibration:
        """Return the fit from a prior; before its segment the readings are those of `alone`."""
        features, nominal = self.proposing.features, self.proposing.network.values
        values, readings, end, found = self._fit(window, belief)
        fitted = _over(alone.fitted, readings)
        slope = features.deviations.scaling(nominal).slope(values)
        flags = [
            f"cannot tell {i} apart: it leans on the network"
            for i, t in zip(self.ids, found.told, strict=True)
            if not t
        ]
        evaluations = found.evaluations * (1 + len(self.ids) + len(alone.state))
        fit = WindowFit(values, alone.state, fitted, end, float(np.sqrt(found.chi)), evaluations)
        report = CalibrationReport(np.diag((found.sd * slope) ** 2), tuple(flags), condition=found.condition)
        return fitted_calibration(self.network, window, self.ids, fit, report)

    def _fit(self, window: Window, belief: ParameterPrior) -> tuple[Array, Array, Array, ContextFit]:
        """Return values (q,), readings (n', m) at the last samples of the window, state at the last, and the fit
        itself.
        """
        features, nominal = self.proposing.features, self.proposing.network.values
        series = self.proposing.series().ahead(TARGET)
        frame = features.frame(series, len(series), nominal)
        found = estimate(features, frame, nominal, belief=belief)
        return features.deviations.values(found.theta, nominal), *self._traced(window, frame, found), found

    def _belief(self, proposal: Proposal, before: Array) -> ParameterPrior:
        """Return the prior: the network's prediction where its gates are open, elsewhere a wide one about the values
        (q,) before.
        """
        deviations, nominal = self.proposing.features.deviations, self.proposing.network.values
        sd = proposal.sd / np.abs(deviations.scaling(nominal).slope(proposal.said))
        wide = deviations.prior_sd
        mean = deviations.theta(np.where(proposal.closed, before, proposal.said), nominal)
        return ParameterPrior(mean, np.where(proposal.closed, wide, np.clip(sd, NARROWEST * wide, wide)))

    def _traced(self, window: Window, frame: Frame, found: ContextFit) -> tuple[Array, Array]:
        """Return the readings (n', m) at the last samples of the window, which the fit covers, and the state at the
        last.
        """
        features, nominal = self.proposing.features, self.proposing.network.values
        first = max(CONTEXT - TARGET - found.steps, frame.begin)
        begin = min(int(np.searchsorted(window.time, frame.time[first])), len(window.time) - 1)
        upto = max(int(np.searchsorted(frame.time, window.time[begin])), first)
        time = np.concatenate([frame.time[first:upto], window.time[begin:]])
        inputs = np.vstack([frame.held[first:upto], window.inputs[begin:]])
        full = features.deviations.full(found.theta, nominal)
        readings, end = features.kernel.trace(full, found.start, time, inputs)
        return readings[0][upto - first :], end[0]

    def _far_better(self, window: Window, readings: Array, others: Array) -> bool:
        """Return True if readings (n, m) explain the latest minutes far better than `others` do."""
        return self._recent(window, others) > BETTER * max(self._recent(window, readings), LEAST_CHI)

    def _recent(self, window: Window, readings: Array) -> float:
        """Return the mean square of the residual of readings (n, m) over the latest minutes, in units of a step's
        noise.
        """
        since = int(np.searchsorted(window.time, window.time[-1] - LATEST_S))
        place = ((window.time[since:] - window.time[since]) / STEP_S + 1e-9).astype(np.intp)
        left = binned((readings - window.measured)[since:], place, int(place[-1]) + 1)
        squares = (left / step_noise(self.proposing.features)) ** 2
        good = np.isfinite(squares)
        return float(squares[good].mean()) if good.any() else 0.0

    def _said(self, done: Calibration, window: Window, proposal: Proposal, flag: str, more: int = 0) -> Calibration:
        """Return a calibration with the excluded thermometers, a flag and further evaluations.

        The error before it is that of the live twin, whichever fit concluded.
        """
        aside = (d.sentence(self.network) for d in proposal.doubts)
        return replace(
            done,
            flags=(*aside, *done.flags, flag),
            evaluations=done.evaluations + proposal.evaluations + more,
            error_before_K=window.error_K,
        )

    def _full(self, calibration: Calibration) -> Array:
        full = self.network.values.copy()
        full[self.network.index(self.ids)] = list(calibration.values.values())
        return full

    def state(self) -> dict[str, Any]:
        left = self._left
        kept = None if left is None else {"time": left.time, **{name: to_json(getattr(left, name)) for name in _ARRAYS}}
        return {**super().state(), "network": self.proposing.state(), "left": kept}

    def restore(self, state: Mapping[str, Any]) -> None:
        super().restore(state)
        self.proposing.restore(state["network"])
        left = state["left"]
        self._left = (
            None if left is None else _LeastSquaresState(left["time"], *(from_json(left[name]) for name in _ARRAYS))
        )


def _over(readings: Array, latest: Array) -> Array:
    """Return readings (n, m), the last of them replaced by `latest` (n', m)."""
    out = readings.copy()
    out[len(out) - len(latest) :] = latest
    return out


_ARRAYS = ("inputs", "state", "parameters")
