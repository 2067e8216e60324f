"""Limits of what a plant that is led back to given temperatures can reach: its sensors' noise and its steady state."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

REST_S = 600.0
"""Time, s, over which trends are estimated: at a noise of 0.05 K a drift of 0.1 K/h stands out of it."""
LOOK_S = 30.0
"""Time, s, between two estimates."""
STEADY = 0.05
"""Share of its range by which a set-point may have moved over that time and still count as constant."""
NOISE_S, NOISE_ROWS = 120.0, 60
"""Time, s, and rows from which on the noise is known to some ten percent."""
HOPELESS = 0.01
"""Probability of settling within the time-out, below which waiting for it is refused."""
SIGMAS = 4.0
"""Standard deviations that a band which is proposed leaves for noise: once in 16 000 values it is left."""
SURE = 3.0
"""Standard errors by which an estimate must be beyond a bound."""


class ThermalLimits:
    """Deviations of the last `REST_S`, and why they cannot stay within `band_K` for `settle_s` within `timeout_s`.

    `why` is None where they may; `in_time` is False where they do not at their present rate. `enough_K` is a band that
    they would be within now.
    """

    def __init__(self, names: Sequence[str], band_K: float, settle_s: float, timeout_s: float) -> None:
        self.why: str | None = None
        self.in_time = True
        self.enough_K: float | None = None
        self._names, self._band_K, self._settle_s, self._timeout_s = tuple(names), band_K, settle_s, timeout_s
        self._rows: deque[tuple[float, list[float], list[float]]] = deque()
        self._looked_s = -math.inf

    def clear(self) -> None:
        """Forget what was seen: another has moved the plant."""
        self._rows.clear()
        self.why = self.enough_K = None
        self.in_time = True

    def take(
        self, now_s: float, off_K: Sequence[float], outputs: Sequence[float], left_s: float, *, full: bool
    ) -> None:
        """Take in one tick: deviations, K, and outputs as shares of their ranges; `left_s` remain.

        `full` says that the outputs can do no more about the mean deviation.
        """
        rows = self._rows
        rows.append((now_s, list(off_K), list(outputs)))
        while now_s - rows[0][0] > REST_S:
            rows.popleft()
        if now_s - self._looked_s < LOOK_S or now_s - rows[0][0] < NOISE_S or len(rows) < NOISE_ROWS:
            return
        self._looked_s = now_s
        time, off, moved = (np.array([row[i] for row in rows]) for i in range(3))
        noise, period_s = _noise(off), float(np.median(np.diff(time)))
        t = time - time[-1]
        design = np.stack([np.ones_like(t), t], axis=1)
        (level, rate), *_ = np.linalg.lstsq(design, off, rcond=None)
        self.enough_K = _above(float((np.abs(level) + SIGMAS * noise).max()))
        self.why, self.in_time = None, True
        if not self._may_settle(np.zeros_like(noise), noise, period_s):
            j = int(np.argmax(noise))
            self.why = (
                f"{self._names[j]} cannot stay within the band of {self._band_K:g} K for {self._settle_s:g} s, since "
                f"its noise is {noise[j]:.2g} K; `hil resume` again with --band {_above(SIGMAS * float(noise[j])):g}"
            )
        elif now_s - rows[0][0] >= REST_S - LOOK_S and (np.ptp(moved, axis=0) <= STEADY).all():
            # The outputs can at best take away what all temperatures have in common.
            kept = np.abs(level) if full else np.minimum(np.abs(level), np.abs(level - level.mean()))
            errors = SURE * np.sqrt(np.diag(np.linalg.inv(design.T @ design)))
            # A stable plant under constant inputs slows down: no temperature goes further than at the fastest rate now.
            fastest = float((np.abs(rate) + errors[1] * noise).max())
            least = kept - errors[0] * noise
            self.in_time = self._may_settle(np.maximum(least - fastest * max(left_s, 0.0), 0.0), noise, period_s)
            # Refused is only what another whole time-out would not bring: a slow plant is waited for.
            if not self._may_settle(np.maximum(least - fastest * self._timeout_s, 0.0), noise, period_s):
                j = int(np.argmax(kept + SIGMAS * noise))
                self.why = (
                    f"{self._names[j]} stays {abs(level[j]):.2g} K {'above' if level[j] > 0.0 else 'below'} the "
                    f"temperature that it had when the run was cut, at a noise of {noise[j]:.2g} K, and nothing moves "
                    f"any more, so that the band of {self._band_K:g} K is out of reach; `hil resume` again with "
                    f"--band {self.enough_K:g}"
                )

    def _may_settle(self, off_K: NDArray[np.float64], noise: NDArray[np.float64], period_s: float) -> bool:
        """Whether temperatures that are `off_K` at a noise may all be within the band for the time to settle.

        The expected number of such times within the time-out bounds the probability of one (Markov's inequality).
        """
        root, stays = math.sqrt(2.0), 1.0
        for off, s in zip(off_K, noise, strict=True):
            ends = (self._band_K - off, self._band_K + off)
            stays *= 0.5 * sum(math.erf(e / (s * root)) for e in ends) if s > 0.0 else float(off <= self._band_K)
        rows, needed = self._timeout_s / period_s, self._settle_s / period_s
        return bool((1.0 + rows * (1.0 - stays)) * stays**needed >= HOPELESS)


def _noise(off: NDArray[np.float64]) -> NDArray[np.float64]:
    """Standard deviation (m,) of white noise in `off (n, m)`, from second differences, which no trend is in."""
    if len(off) < 3:
        return np.zeros(off.shape[1])
    return np.asarray(np.sqrt((np.diff(off, n=2, axis=0) ** 2).mean(axis=0) / 6.0))


def _above(value: float) -> float:
    """Return `value` rounded up to two significant digits."""
    step = 10.0 ** (math.floor(math.log10(max(value, 1e-6))) - 1)
    return float(f"{math.ceil(value / step - 1e-9) * step:.6g}")
