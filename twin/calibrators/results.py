"""Last step of every calibrator: the calibration of a window from the fitted values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from twin.calibrators.base import Calibration, Window, rmse, total_rmse
from twin.gauss_newton import GaussNewtonFit
from twin.network import Array, Network


@dataclass(frozen=True)
class CalibrationReport:
    """Additional results of a calibrator beside its values; the names are those of `Calibration`."""

    covariance: Array | None = None
    flags: tuple[str, ...] = ()
    frozen: tuple[str, ...] = ()
    window_errors: Mapping[str, float] = field(default_factory=dict)
    condition: float | None = None


@dataclass(frozen=True)
class WindowFit:
    """Fitted values of a window and its simulation with them.

    Attributes
    ----------
    values
        (q,) of the tunables.
    start, end
        State at the first and last sample.
    readings
        (n, m) degC.
    cost
        Dimensionless cost.
    evaluations
        Simulations of the window.
    """

    values: Array
    start: Array
    readings: Array
    end: Array
    cost: float
    evaluations: int

    @classmethod
    def of(cls, fit: GaussNewtonFit, cost: float, evaluations: int) -> WindowFit:
        """Return the window at the minimum of a descent."""
        return cls(fit.values, fit.state, fit.data.readings, fit.data.end, cost, evaluations)


def fitted_calibration(
    network: Network, window: Window, ids: tuple[str, ...], fit: WindowFit, report: CalibrationReport
) -> Calibration:
    """Return the calibration of `window` for the tunables `ids`."""
    residual = fit.readings - window.measured
    error = total_rmse(residual * network.kelvin_per_unit)
    return Calibration(
        window=window.number,
        start_s=float(window.time[0]),
        end_s=float(window.time[-1]),
        kind=window.kind,
        values=dict(zip(ids, fit.values.tolist(), strict=True)),
        covariance=report.covariance,
        cost=float(fit.cost),
        rmse=dict(zip(network.sensor_names, rmse(residual), strict=True)),
        error_before_K=window.error_K,
        error_K=error,
        calibrated=bool(np.isfinite(window.measured).any()) and error < network.rules.calibrated_K,
        fitted=fit.readings,
        state=fit.start.copy(),
        end=fit.end.copy(),
        flags=report.flags,
        evaluations=fit.evaluations,
        frozen=report.frozen,
        window_errors=report.window_errors,
        condition=report.condition,
    )


def skipped_calibration(network: Network, window: Window, ids: tuple[str, ...], end: Array) -> Calibration:
    """Return the calibration of a window with too little data: nothing moves."""
    residual = window.live - window.measured
    values = window.parameters[network.index(ids)]
    return Calibration(
        window=window.number,
        start_s=float(window.time[0]),
        end_s=float(window.time[-1]),
        kind="skipped",
        values=dict(zip(ids, values.tolist(), strict=True)),
        covariance=None,
        cost=0.0,
        rmse=dict(zip(network.sensor_names, rmse(residual), strict=True)),
        error_before_K=window.error_K,
        error_K=window.error_K,
        calibrated=False,
        fitted=window.live,
        state=window.state,
        end=end,
        flags=("too little data in this window: parameters kept",),
        evaluations=0,
    )
