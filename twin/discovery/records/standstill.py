"""Standstills of pump or fan in a record whose healthy record has none, where a twin is not valid.

Stagnant water warms and cools by other laws than those of the commissioned loop, and it distorts the readings of the
next minutes as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.network import Array, Network

NEARLY = 0.5
"""Share of the least speed of the healthy record below which a speed counts as a standstill."""
LEAST_PERCENTILE = 0.1
"""Percentile of the healthy speeds that counts as the least, without short dips."""
AGAIN_S = 600.0
"""Time after a standstill, s, for which readings are of stagnant water."""
TURNS = 1.0
"""Speed, %, from which a drive turns: its own measurement may read a little beside 0."""
MOST = 0.5
"""Share of a record that may be excluded; a rig that mostly stands still is diagnosed as it is."""


@dataclass(frozen=True)
class Standstill:
    """Standstills: `rows` (N,) bool to be excluded; `columns` of the drives; `count` of them; `first_s`, `total_s`:
    s; `stood`: False if they turned, though more slowly than ever in health.
    """

    rows: np.ndarray
    columns: tuple[str, ...] = ()
    count: int = 0
    first_s: float = 0.0
    total_s: float = 0.0
    stood: bool = True

    @property
    def sentence(self) -> str:
        """Return a sentence about the excluded rows; "" if nothing stood still."""
        if not self.count:
            return ""
        what = " and ".join(c.removesuffix("_pct").removesuffix("_speed") for c in self.columns)
        often = "" if self.count == 1 else f" in {self.count} periods"
        how, least = ("stood", "") if self.stood else ("turned too slowly", ", below half of the least speed in health")
        return (
            f"{what} {how} for {self.total_s / 60.0:.3g} min{often} (first at {self.first_s / 3600.0:.1f} h){least}, "
            "as never in the healthy record: what was read then, and ten minutes after, is left aside"
        )


def standstill(network: Network, time_s: Array, inputs: Array, healthy_inputs: Array) -> Standstill:
    """Return the periods in which a speed, in %, was far below its least one in health.

    Args:
        time_s: (N,) s. inputs: (N, c). healthy_inputs: (M, c).
    """
    stood, turned = np.zeros(len(time_s), dtype=bool), False
    columns = []
    for j, column in enumerate(network.input_columns):
        speeds = healthy_inputs[np.isfinite(healthy_inputs[:, j]), j]
        if not column.endswith("_pct") or not speeds.size:
            continue
        below = inputs[:, j] < NEARLY * np.percentile(speeds, LEAST_PERCENTILE)
        if below.any():
            columns.append(column)
            stood |= below
            turned = turned or bool((inputs[below, j] > TURNS).any())
    edges = np.flatnonzero(np.diff(np.concatenate([[False], stood, [False]]).astype(int)))
    rows, total_s = np.zeros(len(time_s), dtype=bool), 0.0
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        until_s = float(time_s[last - 1])
        total_s += until_s - float(time_s[first])
        rows[first : np.searchsorted(time_s, until_s + AGAIN_S, side="right")] = True
    if not columns or rows.mean() > MOST:
        return Standstill(np.zeros(len(time_s), dtype=bool))
    return Standstill(rows, tuple(columns), len(edges) // 2, float(time_s[edges[0]]), total_s, not turned)
