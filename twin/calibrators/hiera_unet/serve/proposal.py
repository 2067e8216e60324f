"""What one cycle of the network comes to, as plain data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.calibrators.hiera_unet.context_fit.contradicted import Doubt
from twin.calibrators.hiera_unet.serve.gates import EVERY, Reason
from twin.network import Array, Network


@dataclass(frozen=True)
class Proposal:
    """One cycle: what the network says at a moment, and what may be written of it.

    Attributes:
        time_s: of the latest sample that it has seen. said, sd: (P,) the network's parameters and standard errors in
            their own units. closed: (P,) bool, those that gates hold which look at this proposal alone. held: (P,)
            bool, those of which nothing may be said: these, and what proposals before do not bear out. values: (P,)
            what the live twin takes on: the record fitted from `said`, what is held where it stands. reasons: closed
            gates. adrift: whether the live twin is so far off that it takes on what is held, too: of two parameters
            that a record does not tell apart neither can be believed, but both together read right.
        half_width: (Y,) K mean half widths of the outputs' 90 % intervals. condition: see `Calibration`.
        doubts: thermometers that were left aside.
        attention: (Q, 12), what each query looked at. evaluations: simulations and forward passes.
    """

    time_s: float
    said: Array
    sd: Array
    closed: np.ndarray
    held: np.ndarray
    values: Array
    reasons: tuple[Reason, ...]
    half_width: Array
    condition: float
    attention: Array
    evaluations: int
    adrift: bool = False
    doubts: tuple[Doubt, ...] = ()

    @property
    def spread(self) -> Array:
        """Standard errors (P,) of what is taken on, as far as the network knows: its own, and how far that is off."""
        return np.asarray(np.hypot(self.sd, np.where(self.held, 0.0, self.values - self.said)))

    def document(self, network: Network, ids: tuple[str, ...]) -> dict[str, Any]:
        """Plain data for a log; `held` says by which gate's code."""
        own = {r.parameter: r.code for r in reversed(self.reasons) if r.parameter}
        whole = next((r.code for r in self.reasons if not r.parameter), "")
        whole, own = (whole, {}) if whole else (own.get(EVERY, ""), own)
        return {
            "time_s": self.time_s,
            "values": dict(zip(ids, np.where(self.held, self.said, self.values).tolist(), strict=True)),
            "standard_errors": dict(zip(ids, self.spread.tolist(), strict=True)),
            "held": {i: own.get(i, whole) for i, h in zip(ids, self.held, strict=True) if h},
            "reasons": [str(r) for r in self.reasons],
            "half_width_K": self.half_width.tolist(),
            "condition": self.condition,
            "adrift": self.adrift,
            "doubted": [d.document(network) for d in self.doubts],
        }
