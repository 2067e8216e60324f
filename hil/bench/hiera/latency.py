"""Latency of one causal forward pass of the network, for `hil bench hiera`. Needs torch."""

from __future__ import annotations

import statistics
from dataclasses import dataclass

from hil.training import features_of
from twin.calibrators.hiera_unet.weights.device import ready


@dataclass(frozen=True)
class Latency:
    """Causal forward pass of one window, on one thread.

    Attributes
    ----------
    config
        Small or full.
    weights
        How many it has.
    repetitions
        Timed forwards.
    minimum_ms, median_ms
        Of them.
    """

    config: str
    weights: int
    repetitions: int
    minimum_ms: float
    median_ms: float


def latency(config: str, repetitions: int = 50) -> Latency:
    """Time the configuration ``small`` or ``full`` with the coolant loop's sizes and random weights.

    Raises
    ------
    HieraError
        Torch is missing, or there is no such configuration.
    ValueError
        No repetition is asked for.
    """
    ready()
    from twin.calibrators.hiera_unet.weights.binding import config_for
    from twin.calibrators.hiera_unet.weights.latency import forward_ms

    features = features_of()
    sizes = config_for(config, features.network, features.table, features.deviations)
    weights, times = forward_ms(sizes, repetitions)
    return Latency(config, weights, repetitions, min(times), statistics.median(times))
