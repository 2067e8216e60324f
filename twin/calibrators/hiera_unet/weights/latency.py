"""Latency of one causal forward pass, on one thread of this machine's processor."""

from __future__ import annotations

import time

import torch

from twin.calibrators.hiera_unet.model.config import Config
from twin.calibrators.hiera_unet.model.network import HieraUNet


def forward_ms(config: Config, repetitions: int, seed: int = 0) -> tuple[int, list[float]]:
    """Return the number of weights, and the wall time, ms, of each of so many causal forward passes of one window.

    Weights and window are random, since the time depends on the sizes alone. The number of torch's threads is restored.

    Raises:
        ValueError: `repetitions` is not positive.
    """
    if repetitions < 1:
        raise ValueError(f"{repetitions} repetitions of a forward time nothing; ask for one or more")
    torch.manual_seed(seed)
    network = HieraUNet(config).eval()
    steps = (1, config.context)
    window = (
        torch.randn(*steps, config.channels),
        torch.ones(*steps, config.channels, dtype=torch.bool),
        torch.zeros(*steps, dtype=torch.int8),
        torch.randn(*steps, config.clock),
        torch.randn(1, config.meta),
    )
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with torch.inference_mode():
            network(*window, causal=True)  # the first one allocates
            return network.count(), [_ms(network, window) for _ in range(repetitions)]
    finally:
        torch.set_num_threads(threads)


def _ms(network: HieraUNet, window: tuple[torch.Tensor, ...]) -> float:
    began = time.perf_counter()
    network(*window, causal=True)
    return 1e3 * (time.perf_counter() - began)
