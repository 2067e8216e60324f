"""Queries and heads: read-out of the features, which starts from the commissioned twin."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from twin.calibrators.hiera_unet.model.blocks import INVALID
from twin.calibrators.hiera_unet.model.config import Config

OVERREACH = 1.25
"""Factor of the tanh that limits deviations to 1.25 bounds: its gradient vanishes near its limit."""
LEAST_SD = 0.004
"""Least standard deviation of a deviation, in units of its bound."""
FIRST_WEIGHT = -2.0
"""Initial logit of a token's weight in `WeightedStep`: an eighth of a reading with the tolerance as its noise."""
SHARE_RATE = 20.0
"""Ratio of the learning rate of a `WeightedStep`'s share to that of a weight: it starts at zero and is of order one."""
WIDEST = 3.0
"""Largest log factor by which a `WeightedStep` changes the standard deviation of its prior."""
RECENT = (60, 240)
"""Steps before the target over which mean residuals are inputs of the output head, beside those of the context."""
LARGEST_LOG = 6.0
"""Largest log variance, so that an exponential never overflows."""


@dataclass(frozen=True)
class Evident:
    """Evidence about deviations among the static numbers, (B, P) each.

    A fit and its standard errors; means, standard deviations and change probabilities of the sparse posterior
    (`sparse`).
    """

    fit: Tensor
    fit_sd: Tensor
    mean: Tensor
    sd: Tensor
    chance: Tensor


def evidence_of(config: Config, meta: Tensor) -> Evident | None:
    """Return the evidence among the static numbers (B, M); None for a network without it."""
    if not config.evidence:
        return None
    fit, fit_sd, mean, sd, chance = meta[:, -config.told : -1].float().chunk(5, -1)
    return Evident(fit, fit_sd, mean, sd, chance)


class Queries(nn.Module):
    """Learned queries to the coarsest tokens; their attention is returned for audit."""

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
        """Return answers (B, Q, d) and attention (B, Q, n), the mean over heads, from tokens (B, n, d), validity (B,
        n).
        """

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
    """Gauss-Newton step about the sparse posterior with learned weights, from the evidence over time.

    A token of stride 30 has the mean residual r of the twin at the posterior, in tolerances, its share n of steps with
    a reading, and the derivatives s by deviations in bounds, which follow from the information rates. With a weight w
    of each token and a prior standard deviation p of each deviation the step is

        (sum of w n s s' + diag(1/p^2))^-1 (sum of w n r s)

    A network that reads only pooled features learns to ignore them: their constant part outweighs the differences
    between windows. This step depends on the residuals from the first training step on.
    """

    def __init__(self, config: Config) -> None:
        super().__init__()
        self.config = config
        self.weigh = nn.Linear(config.dims[2], 1)
        self.widen = nn.Linear(config.head_hidden, config.parameters)
        self.share = nn.Parameter(torch.zeros(config.parameters))
        self.register_buffer("signs", torch.tensor(config.slope_signs, dtype=torch.float32), persistent=False)

    def start(self) -> None:
        """Initialise with equal small weights, since the posterior has used the same readings, and no share of the
        step.
        """
        nn.init.zeros_(self.weigh.weight)
        nn.init.constant_(self.weigh.bias, FIRST_WEIGHT)
        nn.init.zeros_(self.widen.weight)

    def forward(self, d3: Tensor, raw: Tensor, hidden: Tensor, sd: Tensor) -> Tensor:
        """Return the step.

        Args:
            d3: (B, n, d3). raw: (B, n, 2 C) means of the channels, then their availability. hidden: (B, h) of the head.
            sd: (B, P) of the sparse posterior, in bounds.

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
    """Head for deviations and their log-variances, from the pooled features of stride 30 and the queries' answers.

    Without evidence, theta = reach tanh(change). With it, theta = reach tanh(trust atanh(mean / reach) + change), where
    mean is that of the sparse posterior, and trust, between 0 and 2, weights it. Log-variances are then changes of the
    posterior's, and the head reads the static numbers too. The last layer starts at zero: no change and a trust of 1,
    so the twin is as commissioned, or as in the posterior.
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
        """Return deviations and log-variances.

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
    """Return the log variance with the variance of `LEAST_SD` added."""
    least = torch.full_like(log_variance, 2.0 * math.log(LEAST_SD))
    return torch.logaddexp(log_variance.clamp(max=LARGEST_LOG), least)


class OutputHead(nn.Module):
    """Head for corrections and their log-scales at each step of the target; the last layer starts at zero."""

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
        """Return corrections in the outputs' own units and log-scales in units of the tolerances, (B, n, Y) each, of
        (B, n, d1).

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
