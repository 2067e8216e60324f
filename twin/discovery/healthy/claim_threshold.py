"""Claim threshold of a twin: log odds that diagnoses of its simulated healthy records exceed once in a hundred."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np

from twin.discovery.cache import store, stored
from twin.discovery.scoring.null import FALSE_ALARMS, Null
from twin.network import Array, Network

FEWEST = 10
"""Least number of simulated records to which a tail is fitted."""


@dataclass(frozen=True)
class Bootstrap:
    """Diagnoses of simulated healthy records of a twin.

    Attributes
    ----------
    odds
        Log posterior odds of the likeliest effect in each record.
    needed
        Those from which one was claimed.
    alarms
        Records whose verdict was not `adequate`.
    """

    odds: tuple[float, ...]
    needed: float
    alarms: int

    @property
    def draws(self) -> int:
        return len(self.odds)

    @property
    def claim(self) -> float:
        """Return the log odds that one healthy record in a hundred exceeds, and at least those needed before."""
        return max(self.needed, Null(np.sort(np.array(self.odds))).quantile(FALSE_ALARMS))

    @property
    def sentence(self) -> str:
        """Return the outcome in a sentence."""
        raised = f"a claim with it needs log odds of {self.claim:.1f} instead of {self.needed:.1f}"
        return (
            f"of {self.draws} healthy records drawn from this twin, commissioned and diagnosed anew, {self.alarms} "
            f"gave an alarm; {raised if self.claim > self.needed else 'the odds needed for a claim stand'}"
        )


def keep_bootstrap(found: Bootstrap, network: Network, *healthy: Array) -> None:
    """Keep a bootstrap for later diagnoses with this twin and the arrays of its healthy record, if there is a cache."""
    store("bootstrap", asdict(found), network, *healthy)


def kept(network: Network, *healthy: Array) -> Bootstrap | None:
    """Return the bootstrap from the cache for this twin and the arrays of its healthy record, or None."""
    found = stored("bootstrap", network, *healthy)
    if found is None:
        return None
    try:
        result = Bootstrap(tuple(found["odds"]), float(found["needed"]), int(found["alarms"]))
        numbers = (*result.odds, result.needed)
        return result if result.draws >= FEWEST and all(map(math.isfinite, numbers)) else None
    except (ValueError, KeyError, TypeError):
        return None
