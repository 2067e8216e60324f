"""What a bootstrap of the whole pipeline found for a twin, and by how much thresholds have to be raised for it."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np

from twin.discovery.kept import store, stored
from twin.discovery.scoring.null import FALSE_ALARMS, Null
from twin.network import Array, Network

FEWEST = 10
"""Draws from which a tail can be fitted."""


@dataclass(frozen=True)
class Bootstrap:
    """What diagnoses of healthy records drawn from a twin came to.

    Attributes:
        scores, thresholds: best score of each record that the fit confirmed or was below the threshold, and the
            threshold that the scan drew for it.
        alarms: records whose verdict was not `adequate`.
    """

    scores: tuple[float, ...]
    thresholds: tuple[float, ...]
    alarms: int

    @property
    def draws(self) -> int:
        return len(self.scores)

    @property
    def wider(self) -> float:
        """Factor, 1 or more, by which thresholds of this twin have to be raised."""
        tail = Null(np.sort(np.array(self.scores))).quantile(FALSE_ALARMS)
        return max(1.0, tail / float(np.median(self.thresholds)))

    @property
    def sentence(self) -> str:
        """What came of it, for an operator."""
        raised = f"thresholds are raised by {100.0 * (self.wider - 1.0):.0f} % for it"
        return (
            f"of {self.draws} healthy records drawn from this twin, commissioned and diagnosed anew, {self.alarms} "
            f"gave an alarm; {raised if self.wider > 1.0 else 'the thresholds stand'}"
        )


def keep(found: Bootstrap, network: Network, *healthy: Array) -> None:
    """Keep a bootstrap for later diagnoses with this twin and the arrays of its healthy record, if there is a cache."""
    store("bootstrap", asdict(found), network, *healthy)


def kept(network: Network, *healthy: Array) -> Bootstrap | None:
    """The bootstrap that was kept for this twin and the arrays of its healthy record, if any."""
    found = stored("bootstrap", network, *healthy)
    if found is None:
        return None
    try:
        result = Bootstrap(tuple(found["scores"]), tuple(found["thresholds"]), int(found["alarms"]))
        numbers = (*result.scores, *result.thresholds)
        return result if result.draws >= FEWEST and all(map(math.isfinite, numbers)) else None
    except (ValueError, KeyError, TypeError):
        return None
