"""Batches for the review: values, estimates, states or texts of one entity, in the order they appear."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Rows:
    """Values of an entity: `time_s (n,)`, `values (n, k)`, NaN for no good value.

    A file may leave out rows that lie within `tolerance` of the straight line between those it keeps.
    """

    entity: str
    time_s: NDArray[np.float64]
    values: NDArray[np.float64]
    tolerance: float = 0.0


@dataclass(frozen=True, slots=True)
class Estimates:
    """Values (n,) of a parameter with `variances (n,)` (NaN where unknown), in `unit`, from `time_s (n,)` on."""

    entity: str
    name: str
    unit: str
    time_s: NDArray[np.float64]
    values: NDArray[np.float64]
    variances: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class States:
    """State changes of a lane; None ends a state without a next one."""

    entity: str
    time_s: NDArray[np.float64]
    states: list[str | None]


@dataclass(frozen=True, slots=True)
class Texts:
    """Log lines with their level, INFO, WARN or ERROR."""

    entity: str
    time_s: NDArray[np.float64]
    texts: list[str]
    levels: list[str]


ReviewBatch = Rows | Estimates | States | Texts


def merged(batches: list[ReviewBatch]) -> ReviewBatch:
    """Return one batch of several batches of the same entity, in order."""
    first = batches[0]
    if len(batches) == 1:
        return first
    time_s = np.concatenate([batch.time_s for batch in batches])
    match first:
        case Rows():
            return replace(
                first, time_s=time_s, values=np.concatenate([b.values for b in batches if isinstance(b, Rows)])
            )
        case Estimates():
            same = [batch for batch in batches if isinstance(batch, Estimates)]
            return replace(
                first,
                time_s=time_s,
                values=np.concatenate([batch.values for batch in same]),
                variances=np.concatenate([batch.variances for batch in same]),
            )
        case States():
            return replace(first, time_s=time_s, states=[s for b in batches if isinstance(b, States) for s in b.states])
        case Texts():
            same_texts = [batch for batch in batches if isinstance(batch, Texts)]
            return replace(
                first,
                time_s=time_s,
                texts=[text for batch in same_texts for text in batch.texts],
                levels=[level for batch in same_texts for level in batch.levels],
            )
