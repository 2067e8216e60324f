"""Rivals of the Hiera-UNet: four plain networks on tokens of ten minutes, with its inputs and its output head.

Each reads channels, their availability, regime and clock of a day, as well as the static numbers and the memory of the
plant, and answers with a correction of the given outlet. The last layer starts at zero: no correction.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from twin.calibrators.hiera_unet.model.config import Config
from twin.calibrators.hiera_unet.model.heads import OutputHead, recent_of

WIDTH = 96
PATCH_MIN = 10
"""Minutes of a token, the blocks in which boosted trees correct the outlet."""
FARTHEST = 5.0
"""Standard deviations at which a static number is clipped, as in the Hiera-UNet."""


class Rival(nn.Module):
    """Tokens of ten minutes, one of the networks below on them, and the output head of the Hiera-UNet.

    Parameters
    ----------
    config
        Of the Hiera-UNet on the same windows.
    body
        Builds a module from tokens (B, n, width) to tokens of the same shape, given the width and n.
    """

    middle: Tensor
    spread: Tensor

    def __init__(self, config: Config, body: Callable[[int, int], nn.Module]) -> None:
        super().__init__()
        self.config = replace(config, dims=(WIDTH, *config.dims[1:]))
        self.regimes = config.regimes
        inputs = 2 * config.channels + config.regimes + config.clock
        self.patch = nn.Linear(PATCH_MIN * inputs, WIDTH)
        self.statics = nn.Linear(config.meta, WIDTH)
        self.memory = nn.Linear(config.memory, WIDTH)
        self.body = body(WIDTH, config.context // PATCH_MIN)
        self.norm = nn.LayerNorm(WIDTH)
        self.head = OutputHead(self.config)
        self.register_buffer("middle", torch.zeros(config.meta))
        self.register_buffer("spread", torch.ones(config.meta))
        nn.init.zeros_(self.head.out.weight)
        nn.init.zeros_(self.head.out.bias)
        if self.head.lasting is not None:
            nn.init.zeros_(self.head.lasting.weight)
            nn.init.zeros_(self.head.lasting.bias)

    def forward(self, x: Tensor, m: Tensor, regime: Tensor, clock: Tensor, meta: Tensor, memory: Tensor) -> Tensor:
        """Return corrections of the outlet in the target (B, 120), K, from inputs as those of the Hiera-UNet."""
        there = m.to(x.dtype)
        read = torch.cat([x * there, there, F.one_hot(regime.long(), self.regimes).to(x.dtype), clock], -1)
        statics = ((meta - self.middle) / self.spread).clamp(-FARTHEST, FARTHEST)
        tokens = self.patch(read.unflatten(1, (-1, PATCH_MIN)).flatten(2))
        plant = self.statics(statics) + self.memory(memory).relu().mean(1)
        found = self.norm(self.body(tokens + plant[:, None]))
        last = found[:, -(self.config.target // PATCH_MIN) :].repeat_interleave(PATCH_MIN, 1)
        delta: Tensor = self.head(last, recent_of(self.config, x, m), statics)[0][..., 0]
        return delta


class TCN(nn.Module):
    """Temporal convolutional network (Bai, Kolter, Koltun 2018, arXiv:1803.01271): residual blocks of two causal
    convolutions, with dilations that double.
    """

    DILATIONS = (1, 2, 4, 8, 16, 32)

    def __init__(self, width: int, tokens: int) -> None:
        super().__init__()
        del tokens
        pairs = [nn.ModuleList([nn.Conv1d(width, width, 3, dilation=d) for _ in range(2)]) for d in self.DILATIONS]
        self.blocks = nn.ModuleList(pairs)

    def forward(self, h: Tensor) -> Tensor:
        """Return tokens (B, n, width) that depend on no later token."""
        h = h.transpose(1, 2)
        for dilation, block in zip(self.DILATIONS, self.blocks, strict=True):
            change = h
            for layer in block:
                change = F.gelu(layer(F.pad(change, (2 * dilation, 0))))
            h = h + change
        return h.transpose(1, 2)


class BiLSTM(nn.Module):
    """Two layers of a long short-term memory that reads the tokens in both directions."""

    def __init__(self, width: int, tokens: int) -> None:
        super().__init__()
        del tokens
        self.lstm = nn.LSTM(width, width, num_layers=2, batch_first=True, bidirectional=True)
        self.out = nn.Linear(2 * width, width)

    def forward(self, h: Tensor) -> Tensor:
        """Return tokens (B, n, width)."""
        found: Tensor = self.out(self.lstm(h)[0])
        return found


class TemporalUNet(nn.Module):
    """U-Net (Ronneberger, Fischer, Brox 2015) in one dimension: three times half the tokens, and back with skips."""

    GROUPS = 8

    def __init__(self, width: int, tokens: int) -> None:
        super().__init__()
        del tokens
        self.first = self._block(width, width)
        self.down = nn.ModuleList([self._block(width, width) for _ in range(3)])
        self.up = nn.ModuleList([self._block(2 * width, width) for _ in range(3)])

    def _block(self, of: int, to: int) -> nn.Module:
        norm = nn.GroupNorm(self.GROUPS, to)
        return nn.Sequential(nn.Conv1d(of, to, 5, padding=2), norm, nn.GELU(), nn.Conv1d(to, to, 3, padding=1))

    def forward(self, h: Tensor) -> Tensor:
        """Return tokens (B, n, width); n is a multiple of eight."""
        levels = [self.first(h.transpose(1, 2))]
        for block in self.down:
            levels.append(block(F.avg_pool1d(levels[-1], 2)))
        found = levels.pop()
        for block in self.up:
            found = block(torch.cat([found.repeat_interleave(2, -1), levels.pop()], 1))
        return found.transpose(1, 2)


class FlatTransformer(nn.Module):
    """Transformer encoder of four layers over all tokens at one scale, with learned positions."""

    def __init__(self, width: int, tokens: int) -> None:
        super().__init__()
        self.position = nn.Parameter(0.02 * torch.randn(tokens, width))
        layers = [
            nn.TransformerEncoderLayer(width, 6, 2 * width, 0.0, F.gelu, batch_first=True, norm_first=True)
            for _ in range(4)
        ]
        self.layers = nn.ModuleList(layers)

    def forward(self, h: Tensor) -> Tensor:
        """Return tokens (B, n, width)."""
        h = h + self.position
        for layer in self.layers:
            h = layer(h)
        return h


BODIES: dict[str, Callable[[int, int], nn.Module]] = {
    "TCN": TCN,
    "BiLSTM": BiLSTM,
    "temporal U-Net": TemporalUNet,
    "flat transformer": FlatTransformer,
}
