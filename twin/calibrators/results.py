"""The last step of every calibrator: how the window went with the values found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from twin.calibrators.base import Calibration, Window, rmse, total_rmse
from twin.network import Array, Network


@dataclass(frozen=True)
class CalibrationReport:
    """What a calibrator says beside its values; the names are those of `Calibration`."""

    covariance: Array | None = None
    flags: tuple[str, ...] = ()
    frozen: tuple[str, ...] = ()
    alone: Mapping[str, float] = field(default_factory=dict)
    condition: float | None = None


def fitted_calibration(
    network: Network,
    window: Window,
    ids: tuple[str, ...],
    values: Array,
    start: Array,
    readings: Array,
    end: Array,
    *,
    cost: float,
    evaluations: int,
    report: CalibrationReport,
) -> Calibration:
    """Calibration of `window`.

    Args:
        values: (q,) of the tunables `ids`. start, end: (k,) state at the first and last sample.
        readings: (n, m) degC, simulated with these.
    """
    residual = readings - window.measured
    error = total_rmse(residual)
    return Calibration(
        window=window.number,
        start_s=float(window.time[0]),
        end_s=float(window.time[-1]),
        kind=window.kind,
        values=dict(zip(ids, values.tolist(), strict=True)),
        covariance=report.covariance,
        cost=float(cost),
        rmse=dict(zip(network.sensor_names, rmse(residual), strict=True)),
        error_before_K=window.error_K,
        error_K=error,
        calibrated=bool(np.isfinite(window.measured).any()) and error < network.rules.calibrated_K,
        fitted=readings,
        state=start.copy(),
        end=end.copy(),
        flags=report.flags,
        evaluations=evaluations,
        frozen=report.frozen,
        alone=report.alone,
        condition=report.condition,
    )


def skipped_calibration(network: Network, window: Window, ids: tuple[str, ...], end: Array) -> Calibration:
    """A window with too little data: nothing moves."""
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
