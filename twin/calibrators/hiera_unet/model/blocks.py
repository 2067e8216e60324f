"""Blocks of encoder and decoder: attention in windows with a relative-time bias, half kernels.

Tokens are (B, n, d). In one dimension neighbouring tokens are contiguous, so a window is a view: (B * n / w, w, d).
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor, nn

INVALID, FUTURE = -1e4, -1e5
"""Terms added to the score of a key without a valid token, and of a future one.

They are finite, so that a row without any valid key stays finite. The future is far below the invalid, so that such a
row attends to invalid keys of its past and never to valid ones of its future."""


class LagBias(nn.Module):
    """Bias B_tau of eq. 5: a learned bias of each head as a function of the time between query and key.

    Piecewise linear between `knots` knots, evenly spaced in sign(dt) log(1 + |dt| / stride) over the window. It uses
    true times, so a gap counts by its length and not by its number of tokens.
    """

    def __init__(self, heads: int, knots: int, window: int, stride: int) -> None:
        super().__init__()
        self.stride, self.half = stride, (knots - 1) // 2
        self.reach = float(torch.log1p(torch.tensor(float(window))))
        self.table = nn.Parameter(torch.zeros(knots, heads))
        self.register_buffer("knots", torch.arange(-self.half, self.half + 1, dtype=torch.float32), persistent=False)
        self._kept: tuple[Tensor, int, Tensor] | None = None

    def forward(self, time: Tensor) -> Tensor:
        """Return the bias (..., heads, w, w) for the times (..., w), in steps, of the tokens.

        The last bias is cached unless the table is being trained: most windows have the same lags.
        """
        if not torch.is_inference_mode_enabled():
            return self._bias(time)
        kept, version = self._kept, self.table._version
        if kept is not None and kept[1] == version and kept[2].device == time.device and torch.equal(kept[0], time):
            return kept[2]
        bias = self._bias(time)
        self._kept = time, version, bias
        return bias

    def _bias(self, time: Tensor) -> Tensor:
        dt = (time[..., :, None] - time[..., None, :]) / self.stride
        place = torch.sign(dt) * torch.log1p(dt.abs()) * (self.half / self.reach)
        hats = (1.0 - (place.clamp(-self.half, self.half)[..., None] - self.knots).abs()).clamp(min=0.0)
        return (hats @ self.table.to(hats.dtype)).movedim(-1, -3)


def masking(valid: Tensor, causal: bool) -> Tensor:
    """Return the terms (..., 1, w, w) that are added to the scores of keys with validity (..., w)."""
    w = valid.shape[-1]
    score = torch.where(valid > 0, 0.0, INVALID)[..., None, None, :].expand(*valid.shape[:-1], 1, w, w)
    if causal:
        score = torch.minimum(score, torch.full((w, w), FUTURE, device=valid.device).triu(1))
    return score


class AttentionBlock(nn.Module):
    """Attention in windows, then a two-layer perceptron, each on normalised tokens with a residual connection."""

    def __init__(self, dim: int, heads: int, ratio: int = 4) -> None:
        super().__init__()
        self.heads = heads
        self.norm1, self.norm2 = nn.LayerNorm(dim), nn.LayerNorm(dim)
        self.qkv, self.proj = nn.Linear(dim, 3 * dim), nn.Linear(dim, dim)
        self.mlp = nn.Sequential(nn.Linear(dim, ratio * dim), nn.GELU(), nn.Linear(ratio * dim, dim))

    def forward(self, x: Tensor, score: Tensor, window: int, read: Tensor | None = None) -> Tensor:
        """Return the tokens (B, n, d).

        Args:
            x: (B, n, d). score: (B, n / window or 1, heads or 1, window, window), added to the attention scores.
            read: (B, r, d) tokens that every token of a window may read; they are never written. Written metadata
                tokens would carry the future of one block into the past of the next.
        """
        b, n, d = x.shape
        q, k, v = self.split(x.reshape(-1, window, d))
        score = score.expand(b, n // window, *score.shape[2:]).reshape(-1, *score.shape[2:])
        if read is not None:
            _, more_k, more_v = (t.repeat_interleave(n // window, 0) for t in self.split(read))
            k, v = torch.cat([k, more_k], 2), torch.cat([v, more_v], 2)
            score = F.pad(score, (0, read.shape[1]))
        return self.after(x, attention(q, k, v, score))

    def split(self, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return q, k, v, each (B', heads, w, d / heads), of tokens (B', w, d)."""
        q, k, v = self.qkv(self.norm1(x)).unflatten(-1, (3, self.heads, -1)).permute(2, 0, 3, 1, 4)
        return q, k, v

    def after(self, x: Tensor, read: Tensor) -> Tensor:
        """Return tokens (B, n, d) after attention, from tokens (B, n, d) and the heads' output (B', heads, w, d /
        heads).
        """
        x = x + self.proj(read.transpose(1, 2).reshape(x.shape))
        return x + self.mlp(self.norm2(x))


def attention(q: Tensor, k: Tensor, v: Tensor, score: Tensor) -> Tensor:
    """Return the attention output (B', heads, w, d / heads), with `score` (B', heads or 1, w, keys) added."""
    # A float mask on purpose: it carries the bias, and a boolean one is no faster.
    return F.scaled_dot_product_attention(q, k, v, attn_mask=score.to(q.dtype))


class Local(nn.Module):
    """First block: an `AttentionBlock` with one head for each channel group, independent of the other groups."""

    def __init__(self, groups: int, dim: int, knots: int, window: int) -> None:
        super().__init__()
        self.window = window
        self.blocks = nn.ModuleList(AttentionBlock(dim, 1) for _ in range(groups))
        self.bias = LagBias(groups, knots, window, 1)

    def forward(self, tokens: Sequence[Tensor], valid: Tensor, causal: bool) -> list[Tensor]:
        """Return the tokens (B, n, d) of each group.

        Args:
            tokens: (B, n, d) of each group. valid: (B, G, n), share of a group's channels that are present.
        """
        w = self.window
        bias = self.bias(torch.arange(w, device=valid.device, dtype=torch.float32))
        score = masking(valid.unflatten(2, (-1, w)).transpose(1, 2), causal)[..., 0, :, :] + bias
        parts = [block.split(x.reshape(-1, w, x.shape[-1])) for block, x in zip(self.blocks, tokens, strict=True)]
        # One head a group: their attention is worked out together, and mixes nothing.
        q, k, v = (torch.cat(part, 1) for part in zip(*parts, strict=True))
        read = attention(q, k, v, score.flatten(0, 1)).split(1, 1)
        return [block.after(x, own) for block, x, own in zip(self.blocks, tokens, read, strict=True)]


class HalfConv(nn.Module):
    """Depth-wise convolution in time whose weights are one half kernel.

    Causal: y_t = sum_j w_j x_(t-j). Symmetric: the mean of that and its mirror image, y_t = sum_j w_j (x_(t-j) +
    x_(t+j)) / 2; so both have the same response to slow signals. `weight` has the oldest step first.
    """

    def __init__(self, dim: int, taps: int) -> None:
        super().__init__()
        self.weight, self.bias = nn.Parameter(torch.empty(taps, dim)), nn.Parameter(torch.zeros(dim))
        nn.init.trunc_normal_(self.weight, std=taps**-0.5)

    def forward(self, x: Tensor, causal: bool) -> Tensor:
        """Return the convolution (B, n, d) of x (B, n, d)."""
        past, now, reach = self.weight[:-1], self.weight[-1:], len(self.weight) - 1
        kernel = self.weight if causal else torch.cat([past, 2.0 * now, past.flip(0)]) / 2.0
        padded = F.pad(x, (0, 0, reach, 0 if causal else reach))
        # So short a kernel is faster as a sum of shifted records than as torch's convolution.
        y = self.bias
        for j, weight in enumerate(kernel.unbind()):
            y = torch.addcmul(y, padded[:, j : j + x.shape[1]], weight)
        return y


def upsample(coarse: Tensor, factor: int, causal: bool) -> Tensor:
    """Return (B, n * factor, d): linear interpolation between centres of (B, n, d), or, if causal, the last complete
    token.
    """
    if not causal:
        return F.interpolate(coarse.transpose(1, 2), scale_factor=factor, mode="linear").transpose(1, 2)
    held = coarse.repeat_interleave(factor, dim=1)
    # A coarse token is complete with the last fine token that it covers: one fine token sooner than its successor
    # begins. Before the first is complete there is nothing.
    return F.pad(held, (0, 0, factor - 1, 0))[:, : held.shape[1]]
