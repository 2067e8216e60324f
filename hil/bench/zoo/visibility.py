"""True score of an effect: its misfit in standard deviations, after re-tuning to first order.

    score^2 = min over theta of  sum over sensors and blocks ((d - J theta)^2 / v)  +  sum (theta / sd)^2

d is the change of the residual (reading minus twin) that the effect makes, without noise, in means over blocks. J holds
the twin's sensitivities to its tunables and initial state; sd is what commissioning leaves open. v is the variance of a
healthy residual in such a mean: noise and model error of the healthy record, times its
correlation time. The score of noise alone has the noise alone in v; the structure usually lowers it a good deal.

Source: Rao, Proc. Camb. Phil. Soc. 44 (1948) 50, with the tunables projected out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from twin import Array, CommissionResult, simulate

BLOCKS = 240
STATE_SD_K = 0.5
"""Standard deviation of the initial temperatures, K."""
STEP = 0.02
"""Step of a finite difference, as a share of a tunable's value."""


@dataclass(frozen=True)
class Yardstick:
    """Sensitivities and variances by which an effect in one record is measured; everything in block means."""

    twin: Callable[[Array], Array]
    jacobian: Array
    variance: Array
    noise: Array

    def scores(self, readings: Array, inputs: Array, calm_readings: Array, calm_inputs: Array) -> tuple[float, float]:
        """Return the score and the score of noise alone; readings (n, m) degC without noise, inputs (n, c)."""
        change = readings - calm_readings
        if not np.array_equal(inputs, calm_inputs):
            change = change - (self.twin(inputs) - self.twin(calm_inputs))
        d = blocks(change)
        return _misfit(d, self.jacobian, self.variance), _misfit(d, self.jacobian, self.noise)


def yardstick(
    fit: CommissionResult, healthy: tuple[Array, Array, Array], time_s: Array, inputs: Array, first: Array
) -> Yardstick:
    """Return the yardstick of a record.

    Parameters
    ----------
    fit
        The commissioned twin with its standard errors.
    healthy
        Time (N,), inputs (N, c) and measured (N, m) of the record it was commissioned on.
    time_s, inputs, first
        Time (n,) and inputs (n, c) of the record, and its first readings (m,) degC.
    """
    network = fit.network
    state = network.initial_state(first)

    def twin(u: Array, values: Array | None = None, at: Array = state) -> Array:
        return simulate(network, time_s, u, at, values)

    base = blocks(twin(inputs))
    rows = []
    for name in fit.values:
        k = int(network.index([name])[0])
        values = network.values.copy()
        p = network.parameters[name]
        step = STEP * max(abs(values[k]), 1e-3)
        step = -step if values[k] + step > p.upper else step
        values[k] += step
        rows.append((blocks(twin(inputs, values)) - base).ravel() / step * fit.standard_error[name])
    for k in range(len(state)):
        moved = state.copy()
        moved[k] += STATE_SD_K
        rows.append((blocks(twin(inputs, None, moved)) - base).ravel())
    n = len(time_s) / len(base)
    noise = network.sigma**2 / n
    t, u, y = healthy
    free = blocks(y - simulate(network, t, u, network.initial_state(y[: max(int(60.0 / (t[1] - t[0])), 1)])))
    structure = np.array([_long_variance(free[:, j]) for j in range(free.shape[1])])
    shape = base.shape
    return Yardstick(
        twin,
        np.array(rows).T,
        np.broadcast_to(np.maximum(structure, noise), shape).ravel(),
        np.broadcast_to(noise, shape).ravel(),
    )


def blocks(course: Array) -> Array:
    """Return means (b, m) of a course (n, m) over at most `BLOCKS` blocks of equal length; the rest is left out."""
    size = max(len(course) // BLOCKS, 1)
    count = len(course) // size
    return np.asarray(course[: count * size].reshape(count, size, -1).mean(axis=1))


def _long_variance(r: Array) -> float:
    """Return the variance of r (b,) times its correlation time (initial positive sequence, Geyer 1992)."""
    c = r - r.mean()
    spectrum = np.abs(np.fft.rfft(c, 2 * len(c))) ** 2
    correlation = np.fft.irfft(spectrum)[: len(c) // 2]
    if correlation[0] <= 0.0:
        return 0.0
    correlation /= correlation[0]
    below = np.flatnonzero(correlation < 0.05)
    until = int(below[0]) if below.size else len(correlation)
    return float(np.mean(r**2) * (1.0 + 2.0 * correlation[1:until].sum()))


def _misfit(d: Array, jacobian: Array, variance: Array) -> float:
    weight = 1.0 / np.sqrt(variance)
    # The prior's rows stand below the data's: theta is in units of its standard deviation.
    a = np.vstack([jacobian * weight[:, None], np.eye(jacobian.shape[1])])
    b = np.concatenate([d.ravel() * weight, np.zeros(jacobian.shape[1])])
    theta = np.linalg.lstsq(a, b, rcond=None)[0]
    return float(np.linalg.norm(b - a @ theta))
