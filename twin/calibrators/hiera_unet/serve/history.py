"""History of a stream over the last two hours, in the network's steps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from twin.calibrators.base import from_json, to_json
from twin.calibrators.hiera_unet.data.series import STEP_S, ResampledSeries, binned, filled_forward, lasting, latest
from twin.calibrators.hiera_unet.data.windows import CONTEXT
from twin.network import Array

SPAN_S = CONTEXT * STEP_S
LASTS = 12
"""Steps for which an input counts as read: a minute. Slow ones are logged no more often."""
USUALLY, JUDGED = 0.5, 60
"""Share of the steps up to its last value from which an input counts as regularly read, and the steps for this
decision. Other inputs are logged on change or rarely, and their last value holds."""


class History:
    """Raw samples of the last two hours, and their even steps.

    Steps lie on a grid from the very first sample on, so that a window's steps are independent of the time of a query.
    A reading belongs to the step with the nearest stamp, an input to the step that it lies in.
    """

    def __init__(self, inputs: int, sensors: int) -> None:
        self._origin: float | None = None
        self._time = np.zeros(0)
        self._inputs, self._measured = np.zeros((0, inputs)), np.zeros((0, sensors))
        self._earlier = np.full(inputs, np.nan)
        self._usual = np.zeros(inputs, dtype=bool)

    @property
    def last_s(self) -> float:
        """Return the time of the latest sample, s; minus infinity before the first."""
        return float(self._time[-1]) if self._time.size else -np.inf

    def push(self, time: Array, inputs: Array, measured: Array) -> None:
        """Add samples in order: time (n,) s, inputs (n, c), measured (n, m) degC; NaN where not read.

        Samples that are present already are left out.
        """
        new = time > self.last_s
        if not new.any():
            return
        time, inputs, measured = time[new], inputs[new], measured[new]
        if self._origin is None:
            self._origin = float(time[0])
        self._time = np.concatenate([self._time, time])
        self._inputs = np.vstack([self._inputs, inputs])
        self._measured = np.vstack([self._measured, measured])
        keep = self._time >= self._time[-1] - SPAN_S - 2.0 * STEP_S
        self._earlier = latest(self._inputs[~keep], self._earlier)
        self._time, self._inputs, self._measured = self._time[keep], self._inputs[keep], self._measured[keep]

    def series(self) -> ResampledSeries:
        """Return the steps up to the latest sample."""
        assert self._origin is not None
        place = (self._time - self._origin) / STEP_S
        before, near = np.floor(place + 1e-9).astype(np.intp), np.floor(place + 0.5 - 1e-9).astype(np.intp)
        first, n = int(before[0]), int(before[-1] - before[0]) + 1
        measured = binned(self._measured, np.clip(near - first, 0, n - 1), n)
        return ResampledSeries(
            time=np.asarray(self._origin + STEP_S * np.arange(first, first + n), dtype=np.float64),
            inputs=self._given(binned(self._inputs, before - first, n)),
            measured=measured,
            spread=np.full(measured.shape, np.nan),
            earlier=self._earlier.copy(),
        )

    def _given(self, read: Array) -> Array:
        """Return inputs (n, c) as read, with NaN for the gaps of one that was regularly read before."""
        kept = lasting(read, LASTS)
        for j, good in enumerate(np.isfinite(read).T):
            until = int(np.flatnonzero(good)[-1]) + 1 if good.any() else 0
            if until >= JUDGED:
                self._usual[j] = np.isfinite(kept[:until, j]).mean() >= USUALLY
        return np.where(self._usual, kept, filled_forward(read, self._earlier, self._earlier))

    def state(self) -> dict[str, Any]:
        """Return plain data for resuming."""
        arrays = {
            "time": self._time,
            "inputs": self._inputs,
            "measured": self._measured,
            "earlier": self._earlier,
            "usual": self._usual,
        }
        return {"origin": self._origin, **{key: to_json(a) for key, a in arrays.items()}}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Resume from the result of `state`."""
        self._origin = state["origin"]
        self._time = from_json(state["time"]).reshape(-1)
        self._inputs = from_json(state["inputs"]).reshape(-1, self._inputs.shape[1])
        self._measured = from_json(state["measured"]).reshape(-1, self._measured.shape[1])
        self._earlier = from_json(state.get("earlier", [None] * self._inputs.shape[1])).reshape(-1)
        self._usual = from_json(state.get("usual", [False] * self._inputs.shape[1])).reshape(-1).astype(bool)
