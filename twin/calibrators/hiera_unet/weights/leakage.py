"""Leakage test: dependence of a network's parameters on the noise of a record's last minutes."""

from __future__ import annotations

import torch
from torch import Tensor

from twin.calibrators.hiera_unet.model.network import HieraUNet

SHUFFLED = 30
"""Shuffled steps at the end of the record: as many as the paper's last half hour of a day."""
ALLOWED = 0.05


def leakage(network: HieraUNet, x: Tensor, m: Tensor, regime: Tensor, clock: Tensor, meta: Tensor) -> float:
    """Return the largest |change of a deviation| / bound, averaged over windows, when the last steps are shuffled.

    A checkpoint with more than `ALLOWED` is rejected: its parameters are not slow.
    """
    order = torch.arange(x.shape[1])
    tail = torch.randperm(SHUFFLED, generator=torch.Generator().manual_seed(0))
    order[-SHUFFLED:] = order[-SHUFFLED:][tail]
    order = order.to(x.device)
    bounds = torch.tensor(network.config.bounds, device=x.device)
    with torch.inference_mode():
        before = network(x, m, regime, clock, meta).theta
        after = network(x[:, order], m[:, order], regime[:, order], clock[:, order], meta).theta
    return float(((after - before).abs() / bounds).max(dim=1).values.mean())
