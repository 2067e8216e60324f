"""The odds of a claim by the whole pipeline: healthy records drawn from the twin, commissioned and diagnosed anew.

Posterior odds take the noise, the tunables' spread and the twin as known. They come from one healthy record, and so are
off by chance. A parametric bootstrap of everything (Efron & Tibshirani, An Introduction to the Bootstrap, 1993, ch. 6)
repeats that chance: draw a rig, its commissioning and one record more, commission, learn the noise, scan, fit, judge.
Where healthy records reach odds that allow a claim, more is needed of this twin. It takes minutes once, and is kept
beside the kernels.
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
LEAST_ODDS = -12.0
"""Log odds below which records in which nothing leads count alike: their tail is what is asked for."""


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
