"""Queries and heads: what is read out of the features, and starts at the commissioned twin."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from twin.calibrators.hiera_unet.blocks import INVALID
from twin.calibrators.hiera_unet.config import Config

OVERREACH = 1.25
"""A tanh cannot reach its bound and dies near it, so deviations are 1.25 bounds times tanh."""
LEAST_SD = 0.004
"""Least standard deviation of a deviation, in units of its bound."""
LARGEST_LOG = 6.0
"""Of a variance, so that an exponential never overflows."""


@dataclass(frozen=True)
class Evident:
    """What the static numbers say of deviations, (B, P) each: a fit and its standard errors; means, standard deviations
    and chances that they moved, if few have (`sparse`)."""

    fit: Tensor
    fit_sd: Tensor
    mean: Tensor
    sd: Tensor
    chance: Tensor


def evidence_of(config: Config, meta: Tensor) -> Evident | None:
    """The evidence among the static numbers (B, M); None for a network without."""
    if not config.evidence:
        return None
    fit, fit_sd, mean, sd, chance = meta[:, -config.told : -1].float().chunk(5, -1)
    return Evident(fit, fit_sd, mean, sd, chance)


class Queries(nn.Module):
    """Learned questions to the coarsest tokens; the attention they pay is returned, for audit."""

    def __init__(self, config: Config) -> None:
        super().__init__()
        dim = config.dims[-1]
        self.heads = dim // config.head_dim
        self.query = nn.Parameter(torch.empty(len(config.queries), dim))
        nn.init.trunc_normal_(self.query, std=0.02)
        self.q, self.k, self.v, self.proj = (nn.Linear(dim, dim) for _ in range(4))
        self.norm1, self.norm2 = nn.LayerNorm(dim), nn.LayerNorm(dim)
        self.mlp = nn.Sequential(nn.Linear(dim, dim), nn.GELU(), nn.Linear(dim, dim))

    def forward(self, h: Tensor, valid: Tensor) -> tuple[Tensor, Tensor]:
        """Tokens (B, n, d), validity (B, n) -> answers (B, Q, d), attention (B, Q, n), the mean over heads."""

        def split(t: Tensor) -> Tensor:
            return t.unflatten(-1, (self.heads, -1)).transpose(1, 2)

        q = split(self.q(self.query)[None].expand(len(h), -1, -1))
        k, v = split(self.k(h)), split(self.v(h))
        score = q @ k.transpose(-1, -2) * q.shape[-1] ** -0.5
        attention = (score.float() + torch.where(valid > 0, 0.0, INVALID)[:, None, None]).softmax(-1)
        out = (attention.to(v.dtype) @ v).transpose(1, 2).flatten(2)
        answers = self.query + self.proj(out)
        return self.norm2(answers + self.mlp(self.norm1(answers))), attention.mean(1)


class ParameterHead(nn.Module):
    """Deviations and their log-variances from the pooled features of stride 30 and the queries' answers.

    Without evidence, theta = reach tanh(change). With it, theta = reach tanh(trust atanh(mean / reach) + change), where
    mean is what is believed if few parameters have moved, and trust, between 0 and 2, says how far; log-variances are
    then changes of that belief's, and the head sees the static numbers too. The last layer starts at zero: no change
    and a trust of 1, so the twin is as commissioned, or as that belief has it.
    """

    def __init__(self, config: Config) -> None:
        super().__init__()
        self.config = config
        width = config.dims[2] + len(config.queries) * config.query_dim + config.evidence * config.meta
        self.reduce = nn.Linear(config.dims[-1], config.query_dim)
        self.hidden = nn.Linear(width, config.head_hidden)
        self.out = nn.Linear(config.head_hidden, (2 + config.evidence) * config.parameters)
        self.register_buffer("bounds", torch.tensor(config.bounds), persistent=False)

    def forward(self, d3: Tensor, valid: Tensor, answers: Tensor, meta: Tensor) -> tuple[Tensor, Tensor]:
        """
        Args:
            d3: (B, n, d3). valid: (B, n). answers: (B, Q, d4). meta: (B, M), its end the evidence.

        Returns:
            Deviations (B, P) in their own units, and log-variances (B, P) in units of the bounds.
        """
        weight = valid / valid.sum(1, keepdim=True).clamp(min=1e-6)
        seen = torch.cat([(d3 * weight[..., None]).sum(1), self.reduce(answers).flatten(1)], -1)
        pooled = F.layer_norm(seen, seen.shape[-1:])
        top: Tensor = OVERREACH * self.bounds
        if not self.config.evidence:
            change, log_variance = self.out(F.gelu(self.hidden(pooled))).float().chunk(2, -1)
            return top * torch.tanh(change), _no_less(log_variance)
        pooled = torch.cat([pooled, meta.to(pooled.dtype)], -1)
        change, wider, trust = self.out(F.gelu(self.hidden(pooled))).float().chunk(3, -1)
        given = evidence_of(self.config, meta)
        assert given is not None
        believed = torch.atanh((given.mean / top).clamp(-0.99, 0.99))
        theta = top * torch.tanh(2.0 * torch.sigmoid(trust) * believed + change)
        return theta, _no_less(2.0 * torch.log(given.sd.clamp(min=1e-4) / self.bounds) + wider)


def _no_less(log_variance: Tensor) -> Tensor:
    """The same with the variance of `LEAST_SD` added."""
    least = torch.full_like(log_variance, 2.0 * math.log(LEAST_SD))
    return torch.logaddexp(log_variance.clamp(max=LARGEST_LOG), least)


class OutputHead(nn.Module):
    """Corrections and their log-scales, a step of the target at a time; the last layer starts at zero."""

    def __init__(self, config: Config) -> None:
        super().__init__()
        dim = config.dims[0]
        self.hidden, self.out = nn.Linear(dim, dim), nn.Linear(dim, 2 * config.outputs)
        self.register_buffer("tolerances", torch.tensor(config.tolerances), persistent=False)

    def forward(self, d1: Tensor) -> tuple[Tensor, Tensor]:
        """(B, n, d1) -> corrections in the outputs' own units, log-scales in units of the tolerances; (B, n, Y)."""
        delta, log_scale = self.out(F.gelu(self.hidden(d1))).float().chunk(2, -1)
        return delta * self.tolerances, log_scale
