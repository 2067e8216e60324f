"""Hiding of inputs in training: the answer that the target's readings reveal, and channels that rigs lose.

The measurements of the target are inputs as well, so that copying the residual would be a perfect answer. In most
windows all of them are hidden, in the others random blocks.
"""

from __future__ import annotations

import torch
from torch import Tensor

from twin.calibrators.hiera_unet.training.plan import Hiding


def hide(mask: Tensor, told: Tensor, target: int, rules: Hiding, rng: torch.Generator) -> Tensor:
    """Return the mask (B, n, C) without the hidden values.

    Args:
        told: (C,) bool, channels that reveal the answer: measurements and residuals. Only those are ever hidden, so
            that a command is never present without its consequence.
    """
    b, n, c = mask.shape
    device = mask.device

    def draw(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=rng).to(device)

    gone = torch.zeros(b, n, dtype=torch.bool, device=device)
    count = -(-target // rules.block_steps)
    some = (draw(b, count) < draw(b, 1)).repeat_interleave(rules.block_steps, 1)[:, :target] & rules.blocks
    gone[:, n - target :] = (draw(b, 1) < rules.whole) | some
    length = 2 + (draw(b, 1) * (rules.burst_steps - 2)).long()
    start = (draw(b, 1) * n).long()
    step = torch.arange(n, device=device)
    gone |= (draw(b, 1) < rules.burst) & (step >= start) & (step < start + length)
    lost = (draw(b, 1) < rules.dropped) & (draw(b, c) < rules.each)
    return mask & ~(told & (gone[..., None] | lost[:, None]))


def blind(mask: Tensor, told: Tensor, target: int) -> Tensor:
    """Return the mask with the target's answer hidden: the protocol of a blind score."""
    out = mask.clone()
    out[:, -target:] &= ~told
    return out
