"""Parametric bootstrap of the claim threshold: healthy records are simulated, commissioned and diagnosed anew.

Posterior odds take the noise and the spread of the tunables as known, although both are estimated from one healthy
record. The bootstrap repeats that estimate (Efron & Tibshirani, An Introduction to the Bootstrap, 1993, ch. 6): it
draws a rig and two of its records, commissions a twin on the one, and diagnoses the other. If healthy records reach
odds that allow a claim, the threshold for this twin rises. A bootstrap takes minutes, and its result is kept in the
cache.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from twin.commissioning import CommissionOptions, commission
from twin.discovery.engine import diagnose
from twin.discovery.healthy.basis import Columns, basis
from twin.discovery.healthy.claim_threshold import FEWEST, Bootstrap
from twin.discovery.healthy.simulated_records import simulated_records
from twin.discovery.records.grid import on_grid
from twin.network import Network

DRAWS = 40
"""Healthy records that are drawn by default. A judgement: the tail is extrapolated from them (`scoring.null`)."""
LEAST_ODDS = -12.0
"""Log odds below which all records count alike; only the upper tail is fitted."""


def bootstrap_claims(
    network: Network,
    healthy: Columns,
    draws: int = DRAWS,
    *,
    seed: int = 0,
    done: Callable[[int], None] = lambda _: None,
) -> Bootstrap:
    """Commission and diagnose `draws` pairs of healthy records drawn from a commissioned twin.

    Parameters
    ----------
    healthy
        The record that the twin was commissioned on.
    done
        Called with the number of draws made so far.

    Raises
    ------
    ValueError
        Fewer than ten draws.
    TwinFileError
        As `diagnose`.
    """
    if draws < FEWEST:
        raise ValueError(f"a tail is fitted to {FEWEST} draws or more, not {draws}")
    known = basis(network, healthy, on_grid(network, healthy.time_s, healthy.inputs, healthy.measured))
    odds, needed, alarms = [], 0.0, 0
    for i in range(draws):
        records = simulated_records(known, healthy, np.random.default_rng([seed, i]))
        first, second = next(records), next(records)
        again = commission(network, first.time_s, first.inputs, first.measured, CommissionOptions(starts=1))
        found = diagnose(again.network, second, first)
        needed = max(needed, found.claim)
        odds.append(max(found.odds, LEAST_ODDS))
        alarms += found.verdict != "adequate"
        done(i + 1)
    return Bootstrap(tuple(odds), needed, alarms)
