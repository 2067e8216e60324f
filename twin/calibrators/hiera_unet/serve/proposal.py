"""Proposal of one cycle of the network as plain data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.calibrators.hiera_unet.context_fit.contradicted import Doubt
from twin.calibrators.hiera_unet.serve.gates import EVERY, Reason
from twin.network import Array, Network


@dataclass(frozen=True)
class Proposal:
    """One cycle: the network's prediction at a time, and the part of it that may be adopted.

    Attributes:
        time_s: of the latest sample. said, sd: (P,) predicted parameters and standard errors in their own units.
            closed: (P,) bool, held by gates that depend on this proposal alone. held: (P,) bool, these and those that
            earlier proposals do not confirm. values: (P,) adopted by the live twin: a fit of the record with the prior
            `said`, held parameters fixed. reasons: closed gates. adrift: whether the live twin's error is so large that
            it adopts held parameters too. If only the sum of two parameters is identifiable, neither value is reliable,
            but both together give correct readings.
        half_width: (Y,) K mean half widths of the outputs' 90 % intervals. condition: see `Calibration`.
        doubts: excluded thermometers.
        attention: (Q, 12), attention of each query. evaluations: simulations and forward passes.
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
        """Return the standard errors (P,) of the adopted values: the network's own, and the difference from its
        prediction.
        """
        return np.asarray(np.hypot(self.sd, np.where(self.held, 0.0, self.values - self.said)))

    def document(self, network: Network, ids: tuple[str, ...]) -> dict[str, Any]:
        """Return plain data for a log; `held` gives the code of the gate."""
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
