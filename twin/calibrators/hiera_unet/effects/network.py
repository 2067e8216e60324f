"""The network: one encoder over time shared by all hypotheses, attention across them, and heads for each.

Hypotheses are a set: in another order the answers come in that order. A window's answer depends on it and earlier
windows alone. Attention across a set follows Vaswani et al., NeurIPS 2017; Lee et al., Set Transformer, ICML 2019.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import torch
from torch import Tensor, nn

from twin.calibrators.hiera_unet.effects.memory import LAGS
from twin.calibrators.hiera_unet.effects.tokens import WIDTH

KERNEL = 3
DROPPED = 0.1
"""Share of a token's features that a training step leaves out."""
DILATIONS = (1, 3)
LEAST_SCALE = -4.0
"""Least logarithm of a scale."""
REACH = sum((KERNEL - 1) * d for d in DILATIONS)
"""Earlier windows that an answer depends on, beside the scores' own."""


@dataclass(frozen=True)
class EffectsConfig:
    """Sizes of the network."""

    width: int = 48
    heads: int = 4

    def document(self) -> dict[str, Any]:
        """Return the sizes as plain data."""
        return asdict(self)


@dataclass(frozen=True)
class Answers:
    """Answers for B records, K windows and H hypotheses.

    Attributes
    ----------
    log_odds
        Logarithm of the odds of each hypothesis against no effect (B, K, H).
    weight
        Share of each onset's fitted size in the size (B, K, H, M).
    size_scale
        Logarithm of the scale of the size's error over its standard deviation (B, K, H).
    since, since_scale
        Logarithm of the time since the onset in windows, and of the scale of its error (B, K, H).
    """

    log_odds: Tensor
    weight: Tensor
    size_scale: Tensor
    since: Tensor
    since_scale: Tensor


class _Block(nn.Module):
    def __init__(self, width: int, heads: int, dilation: int) -> None:
        super().__init__()
        self._dilation = dilation
        self.time = nn.Parameter(torch.randn(KERNEL, width) / KERNEL**0.5)
        self.offset = nn.Parameter(torch.zeros(width))
        self.first, self.second, self.third = nn.LayerNorm(width), nn.LayerNorm(width), nn.LayerNorm(width)
        self.heads = heads
        self.asked = nn.Linear(width, 3 * width)
        self.mixed = nn.Linear(width, width)
        self.wide = nn.Sequential(nn.Linear(width, 2 * width), nn.GELU(), nn.Linear(2 * width, width))

    def forward(self, x: Tensor, real: Tensor) -> Tensor:
        """Return tokens (B, K, H, width); `real` (B, H) is False for padding."""
        b, k, h, w = x.shape
        series = self.first(x)
        earlier = nn.functional.pad(series, (0, 0, 0, 0, (KERNEL - 1) * self._dilation, 0))
        taps = [tap * earlier[:, j * self._dilation : j * self._dilation + k] for j, tap in enumerate(self.time)]
        x = x + nn.functional.gelu(torch.stack(taps).sum(dim=0) + self.offset)
        q, key, value = self.asked(self.second(x)).reshape(b * k, h, 3, self.heads, -1).permute(2, 0, 3, 1, 4)
        mask = real[:, None, None, None, :].expand(b, k, 1, 1, h).reshape(b * k, 1, 1, h)
        seen = nn.functional.scaled_dot_product_attention(q, key, value, attn_mask=mask)
        x = x + self.mixed(seen.permute(0, 2, 1, 3).reshape(b, k, h, w))
        found: Tensor = x + self.wide(self.third(x))
        return found


class EffectsNetwork(nn.Module):
    """Network of effects."""

    def __init__(self, config: EffectsConfig | None = None) -> None:
        super().__init__()
        self.config = config or EffectsConfig()
        w = self.config.width
        self.register_buffer("mean", torch.zeros(WIDTH))
        self.register_buffer("spread", torch.ones(WIDTH))
        self.enter = nn.Linear(WIDTH, w)
        self.blocks = nn.ModuleList(_Block(w, self.config.heads, d) for d in DILATIONS)
        self.leave = nn.LayerNorm(w)
        self.heads = nn.Linear(w, 4 + len(LAGS))
        # Past the norms, so that odds may grow with the evidence without bound.
        self.direct = nn.Linear(WIDTH, 1)
        nn.init.zeros_(self.direct.weight)
        self.dropout = nn.Dropout(DROPPED)

    def forward(self, tokens: Tensor, real: Tensor) -> Answers:
        """Return the answers for tokens (B, K, H, WIDTH); `real` (B, H) is False for padding."""
        scaled = ((tokens - self.mean) / self.spread).clamp(-8.0, 8.0)
        x = self.dropout(self.enter(scaled))
        for block in self.blocks:
            x = block(x, real)
        found = self.heads(self.leave(x))
        return Answers(
            (found[..., 0] + self.direct(scaled)[..., 0]).masked_fill(~real[:, None], -1e4),
            found[..., 4:].softmax(dim=-1),
            found[..., 1],
            found[..., 2],
            found[..., 3],
        )

    def count(self) -> int:
        """Return the number of weights."""
        return sum(p.numel() for p in self.parameters())
