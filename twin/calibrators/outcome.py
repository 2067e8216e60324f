"""The last step of every calibrator: run the window once with the values found, and say how it went."""

from __future__ import annotations

import numpy as np

from twin.calibrators.base import Calibration, Window, total_rmse
from twin.kernel import Kernel
from twin.network import Array, Network


def conclude(
    network: Network,
    kernel: Kernel,
    window: Window,
    ids: tuple[str, ...],
    values: Array,
    start: Array,
    *,
    cost: float,
    covariance: Array | None,
    flags: tuple[str, ...],
    evaluations: int,
) -> Calibration:
    """Calibration of `window` with tunables `ids` at `values` (q,) and initial state `start` (k,)."""
    from twin.commission import rmse

    full = window.parameters.copy()
    full[network.index(ids)] = values
    fitted, end = kernel.trace(full, start, window.time, window.inputs)
    residual = fitted[0] - window.measured
    error = total_rmse(residual)
    return Calibration(
        window=window.number,
        start_s=float(window.time[0]),
        end_s=float(window.time[-1]),
        kind=window.kind,
        values=dict(zip(ids, values.tolist(), strict=True)),
        covariance=covariance,
        cost=float(cost),
        rmse=dict(zip(network.sensor_names, rmse(residual), strict=True)),
        error_before_K=window.error_K,
        error_K=error,
        calibrated=bool(np.isfinite(window.measured).any()) and error < network.rules.calibrated_K,
        fitted=fitted[0],
        state=start.copy(),
        end=end[0].copy(),
        flags=flags,
        evaluations=evaluations + 1,
    )


def skip(network: Network, window: Window, ids: tuple[str, ...], end: Array) -> Calibration:
    """A window with too little data: nothing moves."""
    from twin.commission import rmse

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
