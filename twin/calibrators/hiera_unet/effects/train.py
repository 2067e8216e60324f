"""Training of the network of effects: crops of records with and without effects, in a fixed order."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from twin.calibrators.hiera_unet.effects.labels import Example
from twin.calibrators.hiera_unet.effects.memory import LAGS
from twin.calibrators.hiera_unet.effects.network import LEAST_SCALE, REACH, Answers, EffectsConfig, EffectsNetwork
from twin.calibrators.hiera_unet.effects.tokens import WIDTH
from twin.calibrators.hiera_unet.model.config import HieraError

CROP = 24
"""Windows of a crop that count; `REACH` more come before them."""
EARLY, LATE = 12, 0.3
"""Windows after the onset that count in full, and the share of later ones."""
KIND, SINCE, SIZE = 0.3, 0.1, 0.1
"""Shares of the kind, the onset and the size in the loss."""


@dataclass(frozen=True)
class EffectsPlan:
    """Plan of a training: steps, crops a step, learning rate, seed."""

    steps: int = 2000
    batch: int = 12
    rate: float = 2e-3
    seed: int = 0


class EffectsTrainer:
    """Training that can be continued: `state` and `restore` hold everything, so that it ends the same."""

    def __init__(self, examples: Sequence[Example], plan: EffectsPlan, config: EffectsConfig | None = None) -> None:
        self._with = [e for e in examples if e.onset < len(e.state)]
        self._without = [e for e in examples if e.onset >= len(e.state)]
        if not self._with or not self._without:
            raise HieraError("the training has no records with and without effects; simulate rigs first")
        self.plan = plan
        torch.manual_seed(plan.seed)
        self.network = EffectsNetwork(config)
        mean, spread = _statistics(examples)
        self.network.mean.copy_(mean)
        self.network.spread.copy_(spread)
        self.average = EffectsNetwork(self.network.config)
        self.average.load_state_dict(self.network.state_dict())
        self._optimiser = torch.optim.AdamW(self.network.parameters(), plan.rate, weight_decay=0.02)
        self.done = 0
        self._of = _digest(examples)

    def step(self) -> dict[str, float]:
        """Take one step; return the parts of the loss."""
        rng = np.random.default_rng([self.plan.seed, self.done])
        rate = self.plan.rate * min(1.0, (self.done + 1) / 100.0)
        rate *= 0.5 * (1.0 + np.cos(np.pi * self.done / self.plan.steps))
        for group in self._optimiser.param_groups:
            group["lr"] = rate
        batch = _Batch.drawn(self._with, self._without, self.plan.batch, rng)
        self.network.train()
        parts = loss(self.network(batch.tokens, batch.real), batch)
        total = parts["place"] + KIND * parts["kind"] + SINCE * parts["since"] + SIZE * parts["size"]
        self._optimiser.zero_grad()
        total.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), 1.0)
        self._optimiser.step()
        keep = min(0.998, self.done / (self.done + 10.0))
        with torch.no_grad():
            for mean, now in zip(self.average.parameters(), self.network.parameters(), strict=True):
                mean.lerp_(now, 1.0 - keep)
        self.done += 1
        return {"loss": float(total.detach()), **{k: float(v.detach()) for k, v in parts.items()}}

    def state(self) -> dict[str, Any]:
        """Return everything that continues the training."""
        return {
            "plan": asdict(self.plan),
            "data": self._of,
            "done": self.done,
            "network": self.network.state_dict(),
            "average": self.average.state_dict(),
            "optimiser": self._optimiser.state_dict(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state; raises HieraError for that of another training."""
        if state.get("plan") != asdict(self.plan) or state.get("data") != self._of:
            raise HieraError(
                "the training in this folder has another plan or other data; give its options, or another folder",
                code="OTHER_PLAN",
            )
        self.network.load_state_dict(state["network"])
        self.average.load_state_dict(state["average"])
        self._optimiser.load_state_dict(state["optimiser"])
        self.done = int(state["done"])


@dataclass(frozen=True)
class _Batch:
    tokens: Tensor
    real: Tensor
    place: Tensor
    kind: Tensor
    state: Tensor
    weight: Tensor
    since: Tensor
    size: Tensor
    sized: Tensor
    fitted: Tensor
    error: Tensor

    @classmethod
    def drawn(
        cls, with_effect: Sequence[Example], without: Sequence[Example], count: int, rng: np.random.Generator
    ) -> _Batch:
        """Draw crops: half of records with an effect, about its onset; half of records without."""
        crops = []
        for k in range(count):
            source = with_effect if k % 2 == 0 else without
            one = source[int(rng.integers(len(source)))]
            windows = len(one.state)
            middle = one.onset if k % 2 == 0 and rng.random() < 0.75 else int(rng.integers(windows))
            first = int(np.clip(middle - rng.integers(0, CROP), 0, max(windows - CROP, 0)))
            crops.append((one, max(first - REACH, 0), first, min(first + CROP, windows)))
        length = max(last - begin for _, begin, _, last in crops)
        most = max(one.tokens.shape[1] for one, *_ in crops)
        shape = count, length, most
        found = {
            "tokens": np.zeros((*shape, WIDTH), np.float32),
            "real": np.zeros((count, most), bool),
            "place": np.zeros((count, most), bool),
            "kind": np.zeros((count, most), bool),
            "state": np.full((count, length), 2),
            "weight": np.zeros((count, length), np.float32),
            "since": np.zeros((count, length), np.float32),
            "size": np.full((count, length), np.nan, np.float32),
            "sized": np.zeros((count, most), bool),
            "fitted": np.zeros((*shape, len(LAGS)), np.float32),
            "error": np.ones((*shape, len(LAGS)), np.float32),
        }
        for k, (one, begin, first, last) in enumerate(crops):
            h, n = one.tokens.shape[1], last - begin
            order = rng.permutation(h)
            for name in ("tokens", "fitted", "error"):
                found[name][k, :n, :h] = getattr(one, name)[begin:last][:, order]
            for name in ("place", "kind", "sized"):
                found[name][k, :h] = getattr(one, name)[order]
            for name in ("state", "since", "size"):
                found[name][k, :n] = getattr(one, name)[begin:last]
            found["real"][k, :h] = True
            late = one.since[begin:last] > EARLY
            found["weight"][k, :n] = np.where(late, LATE, 1.0) * (np.arange(begin, last) >= first)
        return cls(**{name: torch.from_numpy(values) for name, values in found.items()})


def loss(answers: Answers, batch: _Batch) -> dict[str, Tensor]:
    """Return the parts of the loss: place or none, kind, onset, size."""
    odds = torch.cat([torch.zeros_like(answers.log_odds[..., :1]), answers.log_odds], dim=-1)
    log_p = odds.log_softmax(dim=-1)
    acting, none = batch.state == 1, batch.state == 0
    right = _log_sum(log_p[..., 1:], batch.place)
    exact = _log_sum(log_p[..., 1:], batch.kind & batch.place)
    weight = batch.weight
    # An effect that need not show yet may be named or not, but nothing else.
    either = torch.logaddexp(right, log_p[..., 0])
    told = torch.where(acting, right, torch.where(none, log_p[..., 0], either))
    parts = {"place": -(weight * told).sum() / weight.sum().clamp_min(1.0)}
    shown = weight * acting
    has_kind = (batch.kind & batch.place).any(dim=-1)[:, None]
    parts["kind"] = -_mean((exact - right).clamp_min(-20.0), shown * has_kind)
    at = batch.place[:, None].expand_as(answers.since)
    each = (shown * (batch.since <= LAGS[-1]))[..., None] * at
    parts["since"] = _mean(
        _laplace(batch.since.clamp_min(0.3).log()[..., None] - answers.since, answers.since_scale), each
    )
    fitted = (answers.weight * batch.fitted).sum(dim=-1)
    error = (answers.weight * batch.error).sum(dim=-1) + 0.02 * fitted.abs()
    off = (batch.size.nan_to_num()[..., None] - fitted) / error.clamp_min(1e-9)
    each = (shown * batch.size.isfinite())[..., None] * batch.sized[:, None].expand_as(off)
    parts["size"] = _mean(_laplace(off.clamp(-1e3, 1e3), answers.size_scale), each)
    return parts


def _laplace(off: Tensor, log_scale: Tensor) -> Tensor:
    scale = log_scale.clamp(LEAST_SCALE, 8.0)
    return off.abs() * (-scale).exp() + scale


def _log_sum(log_p: Tensor, chosen: Tensor) -> Tensor:
    return log_p.masked_fill(~chosen[:, None], -1e4).logsumexp(dim=-1).clamp_min(-50.0)


def _mean(values: Tensor, weight: Tensor) -> Tensor:
    return (values * weight).sum() / weight.sum().clamp_min(1.0)


def _statistics(examples: Sequence[Example]) -> tuple[Tensor, Tensor]:
    """Return mean and standard deviation (WIDTH,) of the tokens."""
    total, square, count = np.zeros(WIDTH), np.zeros(WIDTH), 0
    for one in examples:
        flat = one.tokens.reshape(-1, WIDTH).astype(np.float64)
        total, square, count = total + flat.sum(axis=0), square + (flat**2).sum(axis=0), count + len(flat)
    mean = total / count
    spread = np.sqrt(np.maximum(square / count - mean**2, 1e-4))
    return torch.from_numpy(mean).float(), torch.from_numpy(spread).float()


def _digest(examples: Sequence[Example]) -> str:
    found = hashlib.sha256()
    for one in examples:
        found.update(one.state.tobytes())
        found.update(np.ascontiguousarray(one.tokens[-1]).tobytes())
    return found.hexdigest()
