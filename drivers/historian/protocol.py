"""Protocol of a historian's store: list tags, state the time span, read and append raw samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from drivers.signals import DriverError

GOOD, UNCERTAIN, BAD = 192, 64, 0
"""Quality codes of OPC (OPC DA 3.0, 6.8)."""
COLUMNS = ("timestamp", "tag", "value", "quality")
"""Columns of every store: UTC, name, number, quality code."""


class HistorianError(DriverError):
    """A store that is not there or not as it must be; the message is one sentence with the remedy."""


class HistorianFailedError(HistorianError):
    """A store that fails while it is used: a full disk, a database that went away."""


class HistorianAwayError(HistorianFailedError):
    """A store that does not answer for now: the same may be asked of it again later."""


@dataclass(frozen=True)
class Samples:
    """Raw samples of a tag in the order in which the store keeps them: seconds since 1970 (UTC), value, quality,
    (n,)."""

    time_s: NDArray[np.float64]
    value: NDArray[np.float64]
    quality: NDArray[np.int16]

    def __len__(self) -> int:
        return len(self.time_s)


class HistorianStore(Protocol):
    """A store of raw samples. Every method raises HistorianError with one sentence where the store fails."""

    @property
    def zoned(self) -> bool | None:
        """True where the time stamps carry a zone of their own, False where none does, None where some do."""

    def tags(self) -> tuple[str, ...]:
        """Return the names of the tags that have samples, sorted."""

    def span(self) -> tuple[float, float] | None:
        """Return the times of the first and the last sample, s since 1970; None for an empty store."""

    def read(self, tags: Sequence[str], start_s: float = -np.inf, end_s: float = np.inf) -> dict[str, Samples]:
        """Return the raw samples of the tags from `start_s` to before `end_s`; a tag without any has none."""

    def append(self, samples: Mapping[str, Samples]) -> None:
        """Append samples; they are kept when the call returns."""

    def close(self) -> None:
        """Close the store; never raises."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


def empty() -> Samples:
    """Return no samples."""
    return Samples(np.zeros(0), np.zeros(0), np.zeros(0, dtype=np.int16))
