"""Unscented Kalman filter of filterpy over state and parameters together, one pass through the window."""

from __future__ import annotations

import warnings

import numpy as np

from hil.bench.kernel import SIGMA_K, Problem
from hil.bench.peers import Absent
from hil.bench.peers.formulas import sensor_rows
from twin import Array, right_hand_side


def joint_ukf(problem: Problem, seed: int) -> Array:
    """Return the positions (q,) of the filter at the end; NaN if it loses positive definiteness."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
        except ImportError:
            raise Absent("filterpy: not installed (pip install -e '.[bench]')") from None
    window, network = problem.window, problem.network
    k, q, m = len(network.nodes), len(problem.ids), len(network.sensors)
    reads, rhs = sensor_rows(network), right_hand_side(network)

    def forward(x: Array, dt: float, u: Array) -> Array:
        p = problem.full(x[k:])[0]
        temperatures = x[:k]
        k1 = np.array(rhs(temperatures, u, p))
        k2 = np.array(rhs(temperatures + 0.5 * dt * k1, u, p))
        k3 = np.array(rhs(temperatures + 0.5 * dt * k2, u, p))
        k4 = np.array(rhs(temperatures + dt * k3, u, p))
        problem.evaluations += 1
        return np.concatenate([temperatures + dt / 6.0 * (k1 + 2.0 * (k2 + k3) + k4), x[k:]])

    points = MerweScaledSigmaPoints(k + q, alpha=0.3, beta=2.0, kappa=0.0)
    ukf = UnscentedKalmanFilter(k + q, m, 1.0, lambda x: x[reads], forward, points)
    ukf.x = np.concatenate([window.state, problem.start])
    ukf.P = np.diag(np.concatenate([np.full(k, 0.05**2), np.full(q, 0.15**2)]))
    ukf.Q = np.diag(np.concatenate([np.full(k, 1e-8), np.full(q, 1e-10)]))
    ukf.R = np.eye(m) * SIGMA_K**2
    try:
        for i in range(len(window.time) - 1):
            ukf.predict(dt=float(window.time[i + 1] - window.time[i]), u=window.inputs[i])
            y = window.measured[i + 1]
            if np.isfinite(y).all():
                ukf.update(y)
    except np.linalg.LinAlgError:
        return np.full(q, np.nan)
    problem.evaluations = max(problem.evaluations // max(len(window.time) - 1, 1), 1)
    return np.asarray(ukf.x[k:])
