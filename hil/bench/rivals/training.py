"""Training of one contestant for a number of processor seconds, with early stopping on validation stations.

All contestants draw from one pool of windows of the training stations, cut once by the sampler of `hil train tower`
with its jumps and offsets; hiding is drawn anew in each step. The loss is that of `hil train tower` for the outlet.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from hil.bench.rivals.contestants import Contestant, Corrector
from twin.calibrators.hiera_unet.model.network import decayed
from twin.calibrators.hiera_unet.tower import Fleet
from twin.calibrators.hiera_unet.tower.plan import TowerPlan
from twin.calibrators.hiera_unet.tower.table import SUBJECT
from twin.calibrators.hiera_unet.tower.train import TowerTrainer
from twin.calibrators.hiera_unet.tower.windows import TOLERANCE, CellBatch
from twin.tower.air import Array

BATCH = 12
RATE, WARM_UP, DECAY, CLIP, PRICE = 1e-3, 0.05, 0.1, 1.0, 0.01
"""AdamW's rate at its peak, share of the time in which it rises, weight decay, bound of the gradient, and price of a
correction: for all contestants alike."""
LOOKS = 5
"""Evaluations on validation stations in a training."""
CUT = 24


@dataclass(frozen=True)
class Trained:
    """Result of one training.

    Attributes
    ----------
    weights, steps, chosen
        Number of weights, steps taken, and step of the least validation error; 0: the start was best.
    seconds, stopped_s
        Processor seconds of the steps, and of the evaluations.
    validation, learned
        Error of the last weights over that of the start, less one, on validation and on training stations.
    chosen_validation
        The same of the chosen weights on validation stations.
    stopped, last
        (K, 120) corrections of the test windows, K, by the chosen and by the last weights.
    """

    weights: int
    steps: int
    chosen: int
    seconds: float
    stopped_s: float
    validation: float
    learned: float
    chosen_validation: float
    stopped: Array
    last: Array


class WindowPool:
    """Windows of the training stations with added jumps and offsets, and the sampler that hides parts of them."""

    def __init__(self, fleet: Fleet, count: int, seed: int) -> None:
        config = replace(SUBJECT.config("small"), trees=())
        plan = TowerPlan(steps=1, batch=CUT, pairs=0.0, seed=seed)
        self.sampler = TowerTrainer(config, fleet, plan)
        parts = [self.sampler.sampled()[0] for _ in range(max(count // CUT, 1))]
        self.windows = _joined(parts)
        network = self.sampler.network
        assert network.middle is not None and network.spread is not None
        self.middle, self.spread = network.middle, network.spread

    def __len__(self) -> int:
        return len(self.windows.x)

    def drawn(self, index: Tensor) -> tuple[CellBatch, Tensor]:
        """Return windows (B,) with hidden names of their plants, and their mask with hidden parts."""
        batch = taken(self.windows, index)
        meta, memory, clock = self.sampler.unnamed(batch)
        return replace(batch, meta=meta, memory=memory, clock=clock), self.sampler.hidden(batch)


def cut(fleet: Fleet, rows: NDArray[np.int64]) -> CellBatch:
    """Return the windows of cycles `rows` (K,) with channels in half precision."""
    return _joined([fleet.batch(torch.from_numpy(rows[at : at + CUT])) for at in range(0, len(rows), CUT)])


def taken(windows: CellBatch, index: Tensor) -> CellBatch:
    """Return some windows (B,) with channels in single precision."""
    found: dict[str, Any] = {
        f.name: value[index] if isinstance(value := getattr(windows, f.name), Tensor) else value
        for f in fields(CellBatch)
    }
    return CellBatch(**{**found, "x": found["x"].float()})


def _joined(parts: list[CellBatch]) -> CellBatch:
    found: dict[str, Any] = {}
    for f in fields(CellBatch):
        values = [getattr(one, f.name) for one in parts]
        if not isinstance(values[0], Tensor):
            found[f.name] = values[0]
        else:
            found[f.name] = torch.cat([v.half() for v in values] if f.name == "x" else values)
    return CellBatch(**found)


@torch.no_grad()
def corrections(one: Contestant, network: nn.Module, windows: CellBatch) -> Array:
    """Return the corrections (K, 120) of windows, K."""
    network.eval()
    parts = []
    for at in range(0, len(windows.x), CUT):
        batch = taken(windows, torch.arange(at, min(at + CUT, len(windows.x))))
        parts.append(one.correction(network, batch, batch.m).numpy())
    return np.concatenate(parts)


def error_of(windows: CellBatch, correction: Array | None = None) -> float:
    """Return the mean absolute error of the start, K, or of its corrected outlet, against the truth."""
    water = windows.base_water.numpy() if correction is None else windows.base_water.numpy() + correction
    return float(np.nanmean(np.abs(water - windows.true_water.numpy())))


def loss_of(one: Contestant, delta: Tensor, batch: CellBatch) -> Tensor:
    """Return the mean absolute error of the outlet in tolerances, and the price of its correction."""
    given = torch.where(batch.judged[:, None], batch.base_water - batch.true_water, torch.nan)
    if one.centred:
        given = given - torch.nanmean(given, 1, keepdim=True)
    there = torch.isfinite(given)
    size = ((torch.nan_to_num(given) + delta) / TOLERANCE).abs() * there
    return size.sum() / there.sum().clamp(min=1) + PRICE * ((delta / TOLERANCE) ** 2).mean()


class RivalTraining:
    """Training of one contestant with one seed."""

    def __init__(self, one: Contestant, pool: WindowPool, seed: int) -> None:
        self.one, self.pool = one, pool
        torch.manual_seed(seed)
        pool.sampler.generator.manual_seed(seed)
        self.network = one.build()
        reader: Any = self.network.network if isinstance(self.network, Corrector) else self.network
        reader.middle.copy_(pool.middle)
        reader.spread.copy_(pool.spread)
        heavy, light = decayed(reader)
        groups = [{"params": heavy, "weight_decay": DECAY}, {"params": light, "weight_decay": 0.0}]
        self.optimiser = torch.optim.AdamW(groups, lr=RATE)
        self.order = torch.Generator().manual_seed(seed)
        self.steps = 0

    def step(self, along: float) -> None:
        """Take one step, `along` from 0 to 1 of the training."""
        rise = min((along + 1e-3) / WARM_UP, 1.0)
        for group in self.optimiser.param_groups:
            group["lr"] = RATE * rise * (0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * along)))
        self.network.train()
        batch, mask = self.pool.drawn(torch.randint(len(self.pool), (BATCH,), generator=self.order))
        loss = loss_of(self.one, self.one.correction(self.network, batch, mask), batch)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), CLIP)
        self.optimiser.step()
        self.steps += 1

    def run(self, seconds: float, validation: CellBatch, learned: CellBatch, test: CellBatch) -> Trained:
        """Train for so many processor seconds; return what early stopping and the last step leave.

        Parameters
        ----------
        seconds
            Processor time of all steps.
        validation, learned, test
            Windows of validation, training and test stations.
        """
        start = error_of(validation)
        best = (start, 0, {k: v.clone() for k, v in self.network.state_dict().items()})
        spent = looked = 0.0
        found = start
        for look in range(1, LOOKS + 1):
            while spent < seconds * look / LOOKS:
                began = time.process_time()
                self.step(min(spent / seconds, 1.0))
                spent += time.process_time() - began
            began = time.process_time()
            found = error_of(validation, corrections(self.one, self.network, validation))
            if found < best[0]:
                best = (found, self.steps, {k: v.clone() for k, v in self.network.state_dict().items()})
            looked += time.process_time() - began
        last = corrections(self.one, self.network, test)
        by_heart = error_of(learned, corrections(self.one, self.network, learned)) / error_of(learned) - 1.0
        self.network.load_state_dict(best[2])
        return Trained(
            sum(p.numel() for p in self.network.parameters()),
            self.steps,
            best[1],
            spent,
            looked,
            found / start - 1.0,
            by_heart,
            best[0] / start - 1.0,
            corrections(self.one, self.network, test),
            last,
        )
