"""Diagnoses of healthy records that were drawn from a twin, and the odds that a claim with that twin needs for them."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np

from twin.discovery.cache import store, stored
from twin.discovery.scoring.null import FALSE_ALARMS, Null
from twin.network import Array, Network

FEWEST = 10
"""Draws from which a tail can be fitted."""


@dataclass(frozen=True)
class Bootstrap:
    """Diagnoses of healthy records drawn from a twin.

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
        """Log odds that one healthy record in a hundred exceeds, and no less than were needed before."""
        return max(self.needed, Null(np.sort(np.array(self.odds))).quantile(FALSE_ALARMS))

    @property
    def sentence(self) -> str:
        """The outcome, for an operator."""
        raised = f"a claim with it needs log odds of {self.claim:.1f} instead of {self.needed:.1f}"
        return (
            f"of {self.draws} healthy records drawn from this twin, commissioned and diagnosed anew, {self.alarms} "
            f"gave an alarm; {raised if self.claim > self.needed else 'the odds needed for a claim stand'}"
        )


def keep_bootstrap(found: Bootstrap, network: Network, *healthy: Array) -> None:
    """Keep a bootstrap for later diagnoses with this twin and the arrays of its healthy record, if there is a cache."""
    store("bootstrap", asdict(found), network, *healthy)


def kept(network: Network, *healthy: Array) -> Bootstrap | None:
    """The bootstrap that was kept for this twin and the arrays of its healthy record, if any."""
    found = stored("bootstrap", network, *healthy)
    if found is None:
        return None
    try:
        result = Bootstrap(tuple(found["odds"]), float(found["needed"]), int(found["alarms"]))
        numbers = (*result.odds, result.needed)
        return result if result.draws >= FEWEST and all(map(math.isfinite, numbers)) else None
    except (ValueError, KeyError, TypeError):
        return None
