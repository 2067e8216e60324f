"""Times in which pump or fan stood still, as they never did in health: nobody knows what a twin is worth there.

Water that does not flow is warmed and cooled in other ways than a loop that was commissioned with it flowing can tell,
and it is not where the readings of the next minutes say either.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.network import Array, Network

NEARLY = 0.5
"""Share of the least speed of the healthy record from which something counts as standing."""
LEAST_PERCENTILE = 0.1
"""Of the speeds in health, which is taken for the least: what lasts for a moment is no level."""
AGAIN_S = 600.0
"""How long after a standstill what is read is of water that had stood."""
MOST = 0.5
"""Share of a record that may be left aside; a rig that mostly stands is judged as it is."""


@dataclass(frozen=True)
class Standstill:
    """`rows` (N,) bool to be left aside; `columns`: what stood; `spells`: how often; `first_s`, `total_s`: s."""

    rows: np.ndarray
    columns: tuple[str, ...] = ()
    spells: int = 0
    first_s: float = 0.0
    total_s: float = 0.0

    @property
    def sentence(self) -> str:
        """What becomes of it, for an operator; "" where nothing stood."""
        if not self.spells:
            return ""
        what = " and ".join(c.removesuffix("_pct").removesuffix("_speed") for c in self.columns)
        often = "" if self.spells == 1 else f" in {self.spells} spells"
        return (
            f"{what} stood for {self.total_s / 60.0:.3g} min{often} (first at {self.first_s / 3600.0:.1f} h), as never "
            "in the healthy record: what was read then, and ten minutes after, is left aside"
        )


def standstill(network: Network, time_s: Array, inputs: Array, healthy_inputs: Array) -> Standstill:
    """Where a speed, in %, was far below the least that it had in health.

    Args:
        time_s: (N,) s. inputs: (N, c). healthy_inputs: (M, c).
    """
    stood = np.zeros(len(time_s), dtype=bool)
    columns = []
    for j, column in enumerate(network.input_columns):
        speeds = healthy_inputs[np.isfinite(healthy_inputs[:, j]), j]
        if not column.endswith("_pct") or not speeds.size:
            continue
        below = inputs[:, j] < NEARLY * np.percentile(speeds, LEAST_PERCENTILE)
        if below.any():
            columns.append(column)
            stood |= below
    edges = np.flatnonzero(np.diff(np.concatenate([[False], stood, [False]]).astype(int)))
    rows, total_s = np.zeros(len(time_s), dtype=bool), 0.0
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        until_s = float(time_s[last - 1])
        total_s += until_s - float(time_s[first])
        rows[first : np.searchsorted(time_s, until_s + AGAIN_S, side="right")] = True
    if not columns or rows.mean() > MOST:
        return Standstill(np.zeros(len(time_s), dtype=bool))
    return Standstill(rows, tuple(columns), len(edges) // 2, float(time_s[edges[0]]), total_s)
