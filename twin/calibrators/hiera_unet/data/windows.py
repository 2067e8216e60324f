"""Windows for training, calibration and scoring: N windows of one twin as plain arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

CONTEXT = 1440
TARGET = 120


@dataclass(frozen=True)
class Windows:
    """N windows of `CONTEXT` steps, whose last `TARGET` steps are to be predicted; float32 unless stated.

    Attributes:
        x: (N, 1440, C) channels, normalised; 0 where missing.
        m: (N, 1440, C) bool, True where x is present.
        regime: (N, 1440) int8.
        clock: (N, 1440, 6) two harmonics of the day and one of the year; zeros where unknown.
        meta: (N, M) static tokens: rig figures, then the evidence (P deltas, P sd, log condition number).
        target: (N, 120, Y) degC, measured over the last 120 steps; NaN where missing.
        truth: (N, 120, Y) degC, readings of the plant without noise and faults, constant offsets included; NaN where
            unknown.
        base: (N, 120, Y) degC, the commissioned twin (theta = 0) from `state`.
        state: (N, K) float64, twin state at the first target step, estimated from data before the target.
        inputs: (N, 120, c) float64, the twin's inputs over the target.
        theta: (N, P) true parameter deviations, log-multipliers (or the specification's own scale); NaN where the plant
            has none.
        known: (N, P) bool, where theta is known and identifiable.
        changed: (N,) bool, whether an undeclared change is present.
        nominal: (N, p) float64, full parameter vector of the commissioned twin that theta deviates from: one network
            serves all rigs that share the twin's structure, each with values of its own.
    """

    x: NDArray[np.float32]
    m: NDArray[np.bool_]
    regime: NDArray[np.int8]
    clock: NDArray[np.float32]
    meta: NDArray[np.float32]
    target: NDArray[np.float32]
    truth: NDArray[np.float32]
    base: NDArray[np.float32]
    state: NDArray[np.float64]
    inputs: NDArray[np.float64]
    theta: NDArray[np.float32]
    known: NDArray[np.bool_]
    changed: NDArray[np.bool_]
    nominal: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.x)

    def take(self, rows: NDArray[np.intp] | slice | NDArray[np.bool_]) -> Windows:
        """Return the windows of the given rows."""
        return replace(self, **{f.name: getattr(self, f.name)[rows] for f in fields(self)})


def joined(parts: Sequence[Windows]) -> Windows:
    """Return the windows of all parts, in their order."""
    return Windows(**{f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Windows)})


def concatenate(parts: Sequence[Windows]) -> Windows:
    """Return all windows of several batches in order.

    Raises:
        ValueError: there is no batch.
    """
    if not parts:
        raise ValueError("there are no windows to put together; generate or read at least one batch")
    return Windows(**{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Windows)})
