"""Training of one network, step by step, from plain arrays; it can be interrupted and resumed at any step.

In the first phase, on healthy windows with fixed parameters, the correction learns the model error of a healthy rig.
Then the parameters are learned, relative to the healthy rig. Causal and symmetric batches alternate.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from twin.calibrators.hiera_unet.data.windows import Windows
from twin.calibrators.hiera_unet.model.config import Config, HieraError
from twin.calibrators.hiera_unet.model.heads import evidence_of
from twin.calibrators.hiera_unet.model.network import HieraUNet, Prediction, decayed
from twin.calibrators.hiera_unet.training import losses
from twin.calibrators.hiera_unet.training.balance import Balance
from twin.calibrators.hiera_unet.training.batches import Batch, Simulate
from twin.calibrators.hiera_unet.training.hiding import hide
from twin.calibrators.hiera_unet.training.plan import TrainingPlan
from twin.calibrators.hiera_unet.training.sampling import Sampler


@dataclass(frozen=True)
class Physics:
    """Physics of the twin for training.

    Attributes:
        simulate: deviations and windows -> outputs, differentiable. told: (C,) bool, channels that reveal the answer.
        balance, rated: energy balance and rated power, W; without a balance its loss is off.
    """

    simulate: Simulate
    told: np.ndarray
    balance: Balance | None = None
    rated: float = 1.0


class Trainer:
    """Weights, optimiser, average of weights, and random generators of one training.

    Args:
        digest: of the data's manifest; a training resumes only with the data that it was begun with.

    Raises:
        HieraError: the windows do not fit the configuration.
    """

    def __init__(
        self,
        config: Config,
        windows: Windows,
        physics: Physics,
        plan: TrainingPlan,
        device: torch.device | str = "cpu",
        digest: str = "",
    ) -> None:
        check(config, windows)
        self.config, self.windows, self.physics, self.plan, self.digest = config, windows, physics, plan, digest
        self.device = torch.device(device)
        torch.manual_seed(plan.seed)
        self.network = HieraUNet(config).to(self.device)
        self.average = HieraUNet(config).to(self.device)
        self.average.load_state_dict(self.network.state_dict())
        heavy, light = decayed(self.network)
        groups = [{"params": heavy, "weight_decay": plan.decay}, {"params": light, "weight_decay": 0.0}]
        self.optimiser = torch.optim.AdamW(groups, lr=plan.rate, fused=True)
        self.sampler = Sampler(windows, config, plan)
        self.generator = torch.Generator().manual_seed(plan.seed)
        self.told = torch.from_numpy(physics.told).to(self.device)
        self.bounds = torch.tensor(config.bounds, device=self.device)
        self.tolerances = torch.tensor(config.tolerances, device=self.device)
        self.done = 0

    @property
    def structural(self) -> bool:
        """Return True if the next step belongs to the first phase, with fixed parameters."""
        return self.sampler.healthy.size > 0 and self.done < self.plan.structure * self.plan.steps

    def rate(self) -> float:
        """Return the learning rate of the next step: a linear warm-up, then a cosine to 1 %."""
        warm = max(self.plan.warmup * self.plan.steps, 1.0)
        if self.done < warm:
            return self.plan.rate * (self.done + 1) / warm
        share = (self.done - warm) / max(self.plan.steps - warm, 1.0)
        return self.plan.rate * (0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * min(share, 1.0))))

    def step(self) -> dict[str, float]:
        """Take one step; return every part of the loss as a number."""
        structural, causal = self.structural, self.done % 2 == 1
        rows, pairs = self.sampler.draw(structural)
        batch = Batch.of(self.windows.take(rows), self.device)
        for group in self.optimiser.param_groups:
            group["lr"] = self.rate()
        mask = hide(batch.m, self.told, self.config.target, self.plan.hiding, self.generator)
        with torch.autocast(self.device.type, dtype=torch.bfloat16, enabled=self.plan.half):
            prediction = self.network(batch.x, mask, batch.regime, batch.clock, batch.meta, causal=causal)
        parts = self.loss(prediction, batch, pairs, structural)
        self.optimiser.zero_grad(set_to_none=True)
        parts["loss"].backward()
        norm = torch.nn.utils.clip_grad_norm_(self.network.parameters(), self.plan.clip)
        if bool(torch.isfinite(norm)):
            self.optimiser.step()
        self._follow()
        self.done += 1
        return {name: float(value.detach()) for name, value in parts.items()} | {"gradient": float(norm)}

    def loss(self, p: Prediction, batch: Batch, pairs: Tensor, structural: bool) -> dict[str, Tensor]:
        """Return every part of the loss, and their weighted sum as ``loss``."""
        w, bounds, tolerances = self.plan.weights, self.bounds, self.tolerances
        given = evidence_of(self.config, batch.meta)
        # A kelvin of output moves a deviation a hundred times as hard as its own label does. Unscaled, that alone would
        # fill the clipped gradient, and corrections would not be learned.
        theta = w.through * p.theta + (1.0 - w.through) * p.theta.detach()
        moved = batch.base if structural else self.physics.simulate(theta, batch.rows)
        twin = moved if given is None else self.physics.simulate(given.fit, batch.rows)
        error = twin + p.delta - batch.goal
        price, slow = losses.correction_price(p.delta, tolerances)
        parts = {"data": losses.data_loss(error, tolerances), "delta": price}
        total = parts["data"] + w.delta * price
        if self.physics.balance is not None:
            storage, exchange = (
                torch.from_numpy(a).to(self.device, torch.float32) for a in self.physics.balance(batch.rows)
            )
            parts["balance"] = losses.balance_loss(
                p.delta, storage, exchange, self.physics.rated, ~batch.changed, self.config.step_s
            )
            total = total + w.balance * parts["balance"]
        likely = self.done >= self.plan.sure * self.plan.steps
        if likely:
            parts["laplace"] = losses.laplace_loss(error, p.log_scale, tolerances)
            total = total + w.uncertainty * parts["laplace"]
        if not structural:
            parts["parameter"] = losses.parameter_loss(p.theta, batch.theta, batch.known, bounds)
            parts["smooth"] = losses.smooth_loss(p.theta, bounds, pairs)
            parts["slow"] = slow
            if given is not None:
                parts["twin"] = losses.data_loss(moved - batch.goal, tolerances)
                total = total + parts["twin"]
            total = total + w.parameter * parts["parameter"] + w.smooth * parts["smooth"] + w.slow * slow
            if likely:
                wrong = p.theta - batch.theta
                parts["gaussian"] = losses.gaussian_loss(wrong, p.log_variance, bounds, batch.known)
                total = total + w.uncertainty * parts["gaussian"]
        return {"loss": total, **parts}

    def _follow(self) -> None:
        keep = min(self.plan.ema, (1.0 + self.done) / (10.0 + self.done))
        with torch.no_grad():
            own, live = list(self.average.parameters()), list(self.network.parameters())
            torch._foreach_lerp_(own, live, 1.0 - keep)

    def state(self) -> dict[str, Any]:
        """Return all data for resuming: tensors and plain data."""
        return {
            "identity": self.identity(),
            "done": self.done,
            "network": self.network.state_dict(),
            "average": self.average.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "generator": self.generator.get_state(),
            "sampler": self.sampler.state(),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Resume from the result of `state`.

        Raises:
            HieraError: it belongs to another configuration, plan or other windows.
        """
        if state["identity"] != self.identity():
            raise HieraError(
                "the training that was begun here has another configuration, plan or data; use another folder, or "
                "remove its training.pt to begin anew"
            )
        self.done = int(state["done"])
        self.network.load_state_dict(state["network"])
        self.average.load_state_dict(state["average"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.generator.set_state(state["generator"].cpu())
        self.sampler.restore(state["sampler"])

    def identity(self) -> str:
        """Return an identity that must match for a training to resume."""
        plain = (self.config.document(), self.plan.document(), self.digest, len(self.windows))
        return json.dumps(plain, sort_keys=True)


def check(config: Config, windows: Windows) -> None:
    """Check the shapes of windows.

    Raises:
        HieraError: windows of other shapes than the configuration's.
    """
    found = (windows.x.shape[1:], windows.meta.shape[1], windows.theta.shape[1], windows.target.shape[1:])
    wanted = ((config.context, config.channels), config.meta, config.parameters, (config.target, config.outputs))
    if found != wanted or not len(windows):
        raise HieraError(
            f"{len(windows)} windows with (steps, channels), static numbers, parameters, (steps, outputs) of {found} "
            f"do not fit configuration {config.name!r}, which has {wanted}; generate them for this twin and table"
        )
