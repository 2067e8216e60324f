"""Encoder: channel groups, four stages of windowed attention, mask-weighted merges between them.

It differs from Hiera in the merge (concatenate and project, as in the calibration paper, where Hiera pools the
queries) and in the bias B_tau. It needs no permutation, since in one dimension windows are contiguous.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from twin.calibrators.hiera_unet.model.blocks import AttentionBlock, LagBias, Local, masking
from twin.calibrators.hiera_unet.model.config import Config


@dataclass(frozen=True)
class Scale:
    """Output of a stage for the decoder, at its own stride.

    Attributes:
        h: (B, n, d) tokens. valid: (B, n), share of the record under a token that is present.
        raw: (B, n, 2 C) mask-weighted means of the channels, then their availability.
        regime: (B, n, R) share of each regime.
    """

    h: Tensor
    valid: Tensor
    raw: Tensor
    regime: Tensor

    def of_first(self, count: int | None) -> Scale:
        """Return the first windows of the batch; None for all."""
        if count is None:
            return self
        return Scale(self.h[:count], self.valid[:count], self.raw[:count], self.regime[:count])


class GroupEmbed(nn.Module):
    """Embedding of each group's channels as tokens. The weights of 1 - m are the learned tokens of a missing value."""

    def __init__(self, groups: tuple[int, ...], dim: int) -> None:
        super().__init__()
        self.groups = groups
        self.layers = nn.ModuleList(nn.Linear(2 * size, dim) for size in groups)

    def forward(self, x: Tensor, m: Tensor) -> tuple[list[Tensor], Tensor]:
        """Return tokens (B, n, d) of each group and validity (B, G, n), from values (B, n, C), 0 where missing, and a
        mask.
        """
        known, lost = (part.split(self.groups, -1) for part in (x, 1.0 - m))
        pairs = zip(self.layers, known, lost, strict=True)
        tokens = [layer(torch.cat([v, gone], -1)) for layer, v, gone in pairs]
        return tokens, torch.stack([k.mean(-1) for k in m.split(self.groups, -1)], 1)


class Merge(nn.Module):
    """Merge of neighbouring tokens into one, each weighted by its validity.

    y = W concat(v_i h_i) / mean(v) + b if any is valid, else 0; + embedding(mean v); + a link from the raw channels at
    the new stride, so that a trend survives the merging.
    """

    def __init__(self, factor: int, dim: int, out: int, channels: int) -> None:
        super().__init__()
        self.factor = factor
        self.norm = nn.LayerNorm(dim)
        self.proj = nn.Linear(factor * dim, out)
        self.validity = nn.Linear(1, out)
        self.link = nn.Linear(2 * channels, out)

    def forward(self, h: Tensor, valid: Tensor, raw: Tensor) -> tuple[Tensor, Tensor]:
        """Return merged tokens and their validity.

        Args:
            h: (B, n, d). valid: (B, n). raw: (B, n / factor, 2 C), at the new stride.

        Returns:
            Tokens (B, n / factor, out) and their validity (B, n / factor).
        """
        v = valid.unflatten(1, (-1, self.factor))
        mean = v.mean(-1, keepdim=True)
        weight = v / mean.clamp(min=1e-6)
        joined = (self.norm(h).unflatten(1, (-1, self.factor)) * weight[..., None]).flatten(2)
        y = self.proj(joined) * (mean > 0)
        return y + self.validity(mean) + self.link(raw), mean[..., 0]


class EncoderStage(nn.Module):
    """Blocks of one width; they share the bias B_tau."""

    def __init__(self, config: Config, index: int) -> None:
        super().__init__()
        dim, self.window = config.dims[index], config.windows[index]
        heads = dim // config.head_dim
        self.blocks = nn.ModuleList(AttentionBlock(dim, heads) for _ in range(config.depths[index]))
        self.bias = LagBias(heads, config.knots, self.window, config.strides[index])
        self.norm = nn.LayerNorm(dim)

    def forward(self, x: Tensor, valid: Tensor, time: Tensor, causal: bool, read: Tensor | None = None) -> Tensor:
        """Return normalised tokens (B, n, d), from x (B, n, d), valid (B, n), time (B or 1, n) in steps, read (B, r,
        d).

        If all windows have the same lags, `time` of one of them suffices.
        """
        bias = self.bias(time.unflatten(1, (-1, self.window)))
        score = masking(valid.unflatten(1, (-1, self.window)), causal) + bias
        for block in self.blocks:
            x = block(x, score, self.window, read)
        return self.norm(x)


class Encoder(nn.Module):
    """Encoder from a record of channels to one feature map a stage."""

    def __init__(self, config: Config) -> None:
        super().__init__()
        self.config = config
        count, dim = len(config.groups), config.group_dim
        self.embed = GroupEmbed(config.groups, dim)
        self.local = Local(count, dim, config.knots, config.group_window)
        self.fuse = nn.Linear(count * dim, config.dims[0])
        self.regime = nn.Embedding(config.regimes, config.dims[0])
        self.clock = nn.Linear(config.clock, config.dims[0])
        self.stages = nn.ModuleList(EncoderStage(config, i) for i in range(len(config.dims)))
        pairs = zip(config.merges, config.dims[:-1], config.dims[1:], strict=True)
        self.merges = nn.ModuleList(Merge(factor, dim, out, config.channels) for factor, dim, out in pairs)
        self.meta = nn.Linear(config.meta, config.meta_tokens * config.dims[-1])
        self.memory = nn.Linear(config.memory, config.dims[-1]) if config.memory else None

    def forward(
        self,
        x: Tensor,
        m: Tensor,
        regime: Tensor,
        clock: Tensor,
        meta: Tensor,
        causal: bool,
        memory: Tensor | None = None,
    ) -> tuple[Scale, ...]:
        """Return the feature maps of all stages.

        Args:
            x: (B, n, C). m: (B, n, C), 1 where x is present. regime: (B, n) integers. clock: (B, n, 6). meta: (B, M).
            memory: (B, r, `config.memory`) tokens of the plant's healthy record.
        """
        x = x * m
        tokens, group_valid = self.embed(x, m)
        tokens = self.local(tokens, group_valid, causal)
        h = self.fuse(torch.cat(tokens, -1)) + self.regime(regime) + self.clock(clock)
        valid = m.mean(-1)
        time = torch.arange(h.shape[1], device=h.device, dtype=torch.float32)[None]
        sums, shares = torch.cat([x, m], -1), nn.functional.one_hot(regime, self.config.regimes).to(h.dtype)
        raw = sums
        out: list[Scale] = []
        for index, stage in enumerate(self.stages):
            if index:
                factor = self.config.merges[index - 1]
                sums = sums.unflatten(1, (-1, factor)).sum(2)
                shares = shares.unflatten(1, (-1, factor)).mean(2)
                raw = averaged(sums, self.config.strides[index])
                h, merged = self.merges[index - 1](h, valid, raw)
                time, valid = when(time, valid, factor), merged
            last = index == len(self.stages) - 1
            read = self.meta(meta).unflatten(-1, (self.config.meta_tokens, -1)) if last else None
            if read is not None and memory is not None and self.memory is not None:
                read = torch.cat([read, self.memory(memory)], 1)
            h = stage(h, valid, time if index else time[:, : self.config.windows[0]], causal, read)
            out.append(Scale(h, valid, raw, shares))
        return tuple(out)


def averaged(sums: Tensor, stride: int) -> Tensor:
    """Return means and availability (B, n / stride, 2 C) of sums over `stride` steps of the channels and of their
    masks.
    """
    total, there = sums.chunk(2, -1)
    return torch.cat([total / there.clamp(min=1.0), there / stride], -1)


def when(time: Tensor, valid: Tensor, factor: int) -> Tensor:
    """Return the times of merged tokens: the validity-weighted mean of theirs, the plain mean if none is valid."""
    t = time.expand_as(valid).unflatten(1, (-1, factor))
    v = valid.unflatten(1, (-1, factor)).float()
    total = v.sum(-1)
    weighted = (t * v).sum(-1) / total.clamp(min=1e-6)
    return torch.where(total > 0, weighted, t.mean(-1))
