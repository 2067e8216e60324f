"""Decoder: coarse features upsampled to full resolution, joined at each stride by gated encoder features."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from twin.calibrators.hiera_unet.model.blocks import HalfConv, upsample
from twin.calibrators.hiera_unet.model.config import Config
from twin.calibrators.hiera_unet.model.encoder import Scale


class Gate(nn.Module):
    """Gate G_s of eq. 7: raw channels and regime weight the features of a skip; the raw channels join them."""

    def __init__(self, config: Config, dim: int) -> None:
        super().__init__()
        raw = 2 * config.channels
        self.open = config.gated
        self.raw = nn.Linear(raw, dim)
        self.gate = nn.Sequential(
            nn.Linear(raw + config.regimes, config.gate_dim), nn.GELU(), nn.Linear(config.gate_dim, dim)
        )

    def forward(self, scale: Scale) -> Tensor:
        """Return the gated features (B, n, d)."""
        skip = scale.h + self.raw(scale.raw)
        if not self.open:
            return skip
        return torch.sigmoid(self.gate(torch.cat([scale.raw, scale.regime], -1))) * skip


class Up(nn.Module):
    """Upsampling D_s = Up(D_(s+1)) ⊕ G_s(H_s): two depth-wise convolutions in time, then a point-wise projection."""

    def __init__(self, config: Config, index: int) -> None:
        super().__init__()
        coarse, dim = config.dims[index + 1], config.dims[index]
        width = coarse + dim
        self.factor = config.merges[index]
        self.gate = Gate(config, dim)
        self.norm = nn.LayerNorm(width)
        self.conv1, self.conv2 = HalfConv(width, config.taps), HalfConv(width, config.taps)
        self.proj = nn.Linear(width, dim)

    def forward(self, coarse: Tensor, scale: Scale, causal: bool, last: int) -> Tensor:
        """Return the last tokens (B, last, d) of this stride, from coarse features (B, n / factor, c) and this
        stride's.
        """
        up = upsample(coarse, self.factor, causal)[:, -last:]
        own = Scale(scale.h[:, -last:], scale.valid[:, -last:], scale.raw[:, -last:], scale.regime[:, -last:])
        z = self.norm(torch.cat([up, self.gate(own)], -1))
        z = z + self.conv2(F.gelu(self.conv1(z, causal)), causal)
        return F.gelu(self.proj(z))


class Decoder(nn.Module):
    """D3 over the whole context (the parameter head pools it), D2 and D1 over target and margin only."""

    def __init__(self, config: Config) -> None:
        super().__init__()
        self.config = config
        self.context = nn.Linear(config.dims[-1], config.dims[-1])
        self.ups = nn.ModuleList(Up(config, index) for index in range(len(config.merges)))

    def forward(
        self,
        scales: tuple[Scale, ...],
        summary: Tensor,
        causal: bool,
        crop: bool = True,
        corrected: int | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Return the features that the heads read.

        Args:
            summary: (B, d4) of the whole record; it is left out in causal mode, since it contains the future.
            crop: False computes the decoder over the whole context, to measure the influence of cropping.
            corrected: number of windows, the first ones, for which D1 is computed; None for all.

        Returns:
            D3 (B, 48, d3) and D1 over the target (B or `corrected`, 120, d1).
        """
        deep = scales[-1].h
        if not causal:
            deep = deep + self.context(summary)[:, None]
        keep = self.config.target + self.config.margin if crop else self.config.context
        d3 = self.ups[2](deep, scales[2], causal, scales[2].h.shape[1])
        first, second = (scale.of_first(corrected) for scale in scales[:2])
        d2 = self.ups[1](d3[:corrected], second, causal, keep // self.config.strides[1])
        d1 = self.ups[0](d2, first, causal, keep)
        return d3, d1[:, -self.config.target :]
