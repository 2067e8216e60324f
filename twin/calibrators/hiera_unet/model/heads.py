"""Queries and heads: what is read out of the features, and starts at the commissioned twin."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from twin.calibrators.hiera_unet.model.blocks import INVALID
from twin.calibrators.hiera_unet.model.config import Config

OVERREACH = 1.25
"""A tanh cannot reach its bound and dies near it, so deviations are 1.25 bounds times tanh."""
LEAST_SD = 0.004
"""Least standard deviation of a deviation, in units of its bound."""
FIRST_WEIGHT = -2.0
"""Logit of a token's weight in an untrained `WeightedStep`: an eighth of a reading as good as the tolerance."""
SHARE_RATE = 20.0
"""By which the share of a `WeightedStep` is learned faster than a weight: it starts at none and is of order one."""
WIDEST = 3.0
"""Logarithm of the most by which a `WeightedStep` widens or narrows the belief."""
RECENT = (60, 240)
"""Steps before the target over which mean residuals are given to the output head, beside those of the context."""
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


class WeightedStep(nn.Module):
    """A Gauss-Newton step about the belief whose weights are learned, from the evidence over time.

    A token of stride 30 has the mean residual r of the twin at the belief, in tolerances, its share n of steps with a
    reading, and the slopes s by deviations in bounds, which follow from the information rates. With a weight w of each
    token and a standard deviation p of each deviation about its belief the step is

        (sum of w n s s' + diag(1/p^2))^-1 (sum of w n r s)

    A network that reads only pooled features learns to ignore them: their constant part outweighs what differs between
    windows. This step depends on the residuals from the first training step on.
    """

    def __init__(self, config: Config) -> None:
        super().__init__()
        self.config = config
        self.weigh = nn.Linear(config.dims[2], 1)
        self.widen = nn.Linear(config.head_hidden, config.parameters)
        self.share = nn.Parameter(torch.zeros(config.parameters))
        self.register_buffer("signs", torch.tensor(config.slope_signs, dtype=torch.float32), persistent=False)

    def start(self) -> None:
        """Begin with equal weights, small ones: the belief knows the same readings. No share of the step is taken."""
        nn.init.zeros_(self.weigh.weight)
        nn.init.constant_(self.weigh.bias, FIRST_WEIGHT)
        nn.init.zeros_(self.widen.weight)

    def forward(self, d3: Tensor, raw: Tensor, hidden: Tensor, sd: Tensor) -> Tensor:
        """
        Args:
            d3: (B, n, d3). raw: (B, n, 2 C) means of the channels, then their availability. hidden: (B, h) of the head.
            sd: (B, P) of the belief, in bounds.

        Returns:
            The step (B, P) in bounds.
        """
        count, at = self.config.parameters, self.config.residual
        values, there = raw.float().chunk(2, -1)
        slopes = 2.0 * values[..., -count:].clamp(min=0.0).sqrt() * self.signs
        weight = F.softplus(self.weigh(d3).float())[..., 0] * there[..., at]
        wider = torch.exp(self.widen(hidden).float().clamp(-WIDEST, WIDEST))
        # In single precision whatever the network's products are in: normal equations lose half of their digits.
        with torch.autocast(raw.device.type, enabled=False):
            pull = torch.einsum("bn,bn,bnp->bp", weight, values[..., at], slopes)
            diagonal = torch.diag_embed(1.0 / (sd.float() * wider) ** 2)
            matrix = torch.einsum("bn,bnp,bnq->bpq", weight, slopes, slopes) + diagonal
            # Positive definite by its diagonal; without the check, which would wait for a device.
            step: Tensor = torch.linalg.solve_ex(matrix, pull[..., None], check_errors=False).result[..., 0]
        return step * torch.tanh(SHARE_RATE * self.share)


class ParameterHead(nn.Module):
    """Deviations and their log-variances from the pooled features of stride 30 and the queries' answers.

    Without evidence, theta = reach tanh(change). With it, theta = reach tanh(trust atanh(mean / reach) + change), where
    mean is what is believed if few parameters have moved, and trust, between 0 and 2, says how far; log-variances are
    then changes of that belief's, and the head sees the static numbers too. The last layer starts at zero: no change
    and a trust of 1, so the twin is as commissioned, or as that belief has it.
    """

    shrink: Tensor | None

    def __init__(self, config: Config) -> None:
        super().__init__()
        self.config = config
        width = config.dims[2] + len(config.queries) * config.query_dim + config.evidence * config.meta
        self.reduce = nn.Linear(config.dims[-1], config.query_dim)
        self.hidden = nn.Linear(width, config.head_hidden)
        self.out = nn.Linear(config.head_hidden, (2 + config.evidence) * config.parameters)
        self.step = WeightedStep(config) if config.slope_signs else None
        self.register_buffer("bounds", torch.tensor(config.bounds), persistent=False)
        self.register_buffer("shrink", torch.ones(config.parameters) if config.corrects else None)

    def forward(
        self,
        d3: Tensor,
        valid: Tensor,
        answers: Tensor,
        meta: Tensor,
        raw: Tensor | None = None,
        statics: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """
        Args:
            d3: (B, n, d3). valid: (B, n). answers: (B, Q, d4). meta: (B, M), its end the evidence. raw: (B, n, 2 C) of
                a configuration with `slope_signs`. statics: (B, M) that are read in place of `meta`, standardised.

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
        pooled = torch.cat([pooled, (meta if statics is None else statics).to(pooled.dtype)], -1)
        hidden = F.gelu(self.hidden(pooled))
        change, wider, trust = self.out(hidden).float().chunk(3, -1)
        given = evidence_of(self.config, meta)
        assert given is not None
        if self.step is not None and raw is not None:
            change = change + self.step(d3, raw, hidden, given.sd.clamp(min=1e-4) / self.bounds) / OVERREACH
        believed = torch.atanh((given.mean / top).clamp(-0.99, 0.99))
        theta = top * torch.tanh(2.0 * torch.sigmoid(trust) * believed + change)
        if self.shrink is not None:
            theta = given.mean + self.shrink * (theta - given.mean)
        return theta, _no_less(2.0 * torch.log(given.sd.clamp(min=1e-4) / self.bounds) + wider)


def _no_less(log_variance: Tensor) -> Tensor:
    """The same with the variance of `LEAST_SD` added."""
    least = torch.full_like(log_variance, 2.0 * math.log(LEAST_SD))
    return torch.logaddexp(log_variance.clamp(max=LARGEST_LOG), least)


class OutputHead(nn.Module):
    """Corrections and their log-scales, a step of the target at a time; the last layer starts at zero."""

    shrink: Tensor | None

    def __init__(self, config: Config) -> None:
        super().__init__()
        dim = config.dims[0]
        self.hidden, self.out = nn.Linear(dim, dim), nn.Linear(dim, 2 * config.outputs)
        self.lasting = nn.Linear(dim, (len(RECENT) + 1) * config.outputs) if config.slope_signs else None
        self.direct = nn.Linear(config.meta, dim) if config.corrects else None
        self.lead = nn.Parameter(torch.zeros(config.target, dim)) if config.corrects else None
        self.register_buffer("shrink", torch.ones(config.outputs) if config.corrects else None)
        self.register_buffer("tolerances", torch.tensor(config.tolerances), persistent=False)

    def forward(self, d1: Tensor, recent: Tensor | None = None, statics: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """(B, n, d1) -> corrections in the outputs' own units, log-scales in units of the tolerances; (B, n, Y).

        Args:
            recent: (B, 3) mean residuals before the target (`recent_of`), of which each step keeps a learned share.
            statics: (B, M) standardised static numbers of a configuration that `corrects`.
        """
        before = self.hidden(d1)
        if self.direct is not None and self.lead is not None and statics is not None:
            before = before + self.direct(statics)[:, None] + self.lead[-d1.shape[1] :]
        hidden = F.gelu(before)
        delta, log_scale = self.out(hidden).float().chunk(2, -1)
        if self.lasting is not None and recent is not None:
            share = self.lasting(hidden).float().unflatten(-1, (-1, recent.shape[-1]))
            delta = delta + (share * recent[:, None, None, :]).sum(-1)
        if self.shrink is not None:
            delta = self.shrink * delta
        return delta * self.tolerances, log_scale


def recent_of(config: Config, x: Tensor, m: Tensor) -> Tensor | None:
    """Return the mean residuals (B, 3), in tolerances, of the last steps before the target and of all before it.

    It is 0 where there is none, and None for a configuration without `slope_signs`.
    """
    if not config.slope_signs:
        return None
    before = config.context - config.target
    there = m[:, :before, config.residual].float()
    values = x[:, :before, config.residual].float() * there
    means = [values[:, -k:].sum(1) / there[:, -k:].sum(1).clamp(min=1.0) for k in (*RECENT, before)]
    return torch.stack(means, 1)
