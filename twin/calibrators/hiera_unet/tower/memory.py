"""Memory tokens of a plant: residuals of its commissioned twin over the healthy record, in bins of the operating point.

A bin is a token: mean residual and its spread in tolerances, logarithm of the minutes in it, its middle, and the kind
of the bin. An empty bin has a count of zero and no residual.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twin.tower.air import Array
from twin.tower.identifiability.identify import TOLERANCE
from twin.tower.minutes import Minutes

EDGES = {
    "load": (0.0, 0.35, 0.55, 0.75, 0.95, 2.0),
    "flow": (0.2, 0.8, 0.95, 1.05, 2.0),
    "fan": (-0.01, 0.15, 0.4, 0.6, 0.8, 1.3),
    "wet": (-3.0, -1.5, -1.0, -0.5, -0.2, 0.1, 1.0),
}
"""Edges of the bins: heat and flow over their design values, fan speed, wet bulb from design in tens of kelvins."""


def memory_of(
    minutes: Minutes, clean: Array, m_w0: float, fall: float, wet0: float, healthy: slice
) -> NDArray[np.float32]:
    """Return the tokens (20, 8) of a healthy record.

    Parameters:
        clean: outlet of the commissioned twin, degC (n,). m_w0: design flow, kg/s. fall, wet0: design range K and wet
        bulb degC.
    """
    u = minutes.operation.inputs
    residual = ((minutes.outlet - clean) / TOLERANCE["outlet"])[healthy]
    points = {
        "load": (u.m_w * (u.t_in - clean) / (m_w0 * fall))[healthy],
        "flow": (u.m_w / m_w0)[healthy],
        "fan": u.speed[healthy],
        "wet": ((u.wet - wet0) / 10.0)[healthy],
    }
    there = np.isfinite(residual) & minutes.steady[healthy]
    tokens = []
    for kind, (name, edges) in enumerate(EDGES.items()):
        number = np.digitize(np.nan_to_num(points[name], nan=-99.0), edges) - 1
        for k in range(len(edges) - 1):
            rows = residual[there & (number == k)]
            token = np.zeros(8)
            if len(rows):
                token[0], token[1] = np.clip(rows.mean(), -6.0, 6.0), np.clip(rows.std(), 0.0, 6.0)
            token[2] = np.log1p(len(rows)) / 8.0
            token[3] = 0.5 * (max(edges[k], -2.0) + min(edges[k + 1], 1.5))
            token[4 + kind] = 1.0
            tokens.append(token)
    return np.asarray(tokens, dtype=np.float32)
