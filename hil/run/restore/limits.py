"""Limits of a thermal restore: noise of the sensors and steady state of the plant."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

REST_S = 600.0
"""Time, s, over which trends are estimated: at a noise of 0.05 K a drift of 0.1 K/h is significant."""
ESTIMATE_EVERY_S = 30.0
"""Time, s, between two estimates."""
STEADY = 0.05
"""Share of its range by which a set-point may move over `REST_S` and still count as constant."""
NOISE_S, NOISE_ROWS = 120.0, 60
"""Time, s, and rows from which on the noise is known to some ten percent."""
LEAST_PROBABILITY = 0.01
"""Probability of settling within the time-out below which the restore is refused."""
SIGMAS = 4.0
"""Standard deviations of noise within a proposed band: one value in 16 000 is outside."""
SIGNIFICANT = 3.0
"""Standard errors by which an estimate must exceed a bound."""


class ThermalLimits:
    """Forecast from the deviations of the last `REST_S`: can they stay in `band_K` for `settle_s` before the time-out?

    `obstacle` is the reason against it as a sentence, None where there is none. `in_time` is False where the present
    rate is too slow. `sufficient_K` is a band, K, that would hold all deviations now. `timeout_s` is in s of rig time.
    """

    def __init__(self, names: Sequence[str], band_K: float, settle_s: float, timeout_s: float) -> None:
        self.obstacle: str | None = None
        self.in_time = True
        self.sufficient_K: float | None = None
        self._names, self._band_K, self._settle_s, self._timeout_s = tuple(names), band_K, settle_s, timeout_s
        self._rows: deque[tuple[float, list[float], list[float]]] = deque()
        self._estimated_s = -math.inf

    def clear(self) -> None:
        """Forget all deviations: somebody else has moved the plant."""
        self._rows.clear()
        self.obstacle = self.sufficient_K = None
        self.in_time = True

    def take(
        self, now_s: float, off_K: Sequence[float], outputs: Sequence[float], left_s: float, *, full: bool
    ) -> None:
        """Update the forecast with one tick.

        Parameters
        ----------
        now_s
            Rig time, s.
        off_K
            Deviation of each temperature, K.
        outputs
            Outputs as shares of their ranges, 0 to 1.
        left_s
            Time left until the time-out, s.
        full
            The outputs cannot reduce the mean deviation any further.
        """
        rows = self._rows
        rows.append((now_s, list(off_K), list(outputs)))
        while now_s - rows[0][0] > REST_S:
            rows.popleft()
        if now_s - self._estimated_s < ESTIMATE_EVERY_S or now_s - rows[0][0] < NOISE_S or len(rows) < NOISE_ROWS:
            return
        self._estimated_s = now_s
        time, off, moved = (np.array([row[i] for row in rows]) for i in range(3))
        noise, period_s = _noise(off), float(np.median(np.diff(time)))
        t = time - time[-1]
        design = np.stack([np.ones_like(t), t], axis=1)
        (level, rate), *_ = np.linalg.lstsq(design, off, rcond=None)
        self.sufficient_K = _rounded_up(float((np.abs(level) + SIGMAS * noise).max()))
        self.obstacle, self.in_time = None, True
        if not self._may_settle(np.zeros_like(noise), noise, period_s):
            j = int(np.argmax(noise))
            least_K = _rounded_up(SIGMAS * float(noise[j]))
            self.obstacle = (
                f"{self._names[j]} cannot stay within the band of {self._band_K:g} K for {self._settle_s:g} s, since "
                f"its noise is {noise[j]:.2g} K; `hil resume` again with --band {least_K:g}"
            )
        elif now_s - rows[0][0] >= REST_S - ESTIMATE_EVERY_S and (np.ptp(moved, axis=0) <= STEADY).all():
            # The outputs can at best remove the mean deviation.
            remaining = np.abs(level) if full else np.minimum(np.abs(level), np.abs(level - level.mean()))
            errors = SIGNIFICANT * np.sqrt(np.diag(np.linalg.inv(design.T @ design)))
            # A stable plant under constant inputs slows down: the fastest rate now bounds every later one.
            fastest = float((np.abs(rate) + errors[1] * noise).max())
            least = remaining - errors[0] * noise
            self.in_time = self._may_settle(np.maximum(least - fastest * max(left_s, 0.0), 0.0), noise, period_s)
            # A slow plant is waited for: it is refused only if another whole time-out would not be enough.
            if not self._may_settle(np.maximum(least - fastest * self._timeout_s, 0.0), noise, period_s):
                j = int(np.argmax(remaining + SIGMAS * noise))
                self.obstacle = (
                    f"{self._names[j]} stays {abs(level[j]):.2g} K {'above' if level[j] > 0.0 else 'below'} the "
                    f"temperature that it had when the run was cut, at a noise of {noise[j]:.2g} K, and nothing moves "
                    f"any more, so that the band of {self._band_K:g} K is out of reach; `hil resume` again with "
                    f"--band {self.sufficient_K:g}"
                )

    def _may_settle(self, off_K: NDArray[np.float64], noise: NDArray[np.float64], period_s: float) -> bool:
        """Return True where temperatures that deviate by `off_K` may all stay within the band for the settling time.

        The expected number of such times within the time-out bounds the probability of one (Markov's inequality).
        """
        root, stays = math.sqrt(2.0), 1.0
        for off, s in zip(off_K, noise, strict=True):
            ends = (self._band_K - off, self._band_K + off)
            stays *= 0.5 * sum(math.erf(e / (s * root)) for e in ends) if s > 0.0 else float(off <= self._band_K)
        rows, needed = self._timeout_s / period_s, self._settle_s / period_s
        return bool((1.0 + rows * (1.0 - stays)) * stays**needed >= LEAST_PROBABILITY)


def _noise(off: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the standard deviation (m,) of white noise in `off (n, m)`, from second differences without trend."""
    if len(off) < 3:
        return np.zeros(off.shape[1])
    return np.asarray(np.sqrt((np.diff(off, n=2, axis=0) ** 2).mean(axis=0) / 6.0))


def _rounded_up(value: float) -> float:
    """Return `value` rounded up to two significant digits."""
    step = 10.0 ** (math.floor(math.log10(max(value, 1e-6))) - 1)
    return float(f"{math.ceil(value / step - 1e-9) * step:.6g}")
