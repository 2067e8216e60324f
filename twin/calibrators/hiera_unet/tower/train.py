"""Training of a tower network: losses scaled to start at one, with equal gradients, and state for resuming.

The parameter loss divides each error by the usual one of the given answer, is linear in large errors, and weights
each label by the share of its prior variance that the data have resolved. The output is the given answer plus the
correction, scored as in `score`: by its absolute error against the truth. Windows in which a deviation jumps inside
the target have no output loss.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from twin.calibrators.hiera_unet.model.config import Config, HieraError
from twin.calibrators.hiera_unet.model.network import HieraUNet, Prediction, decayed
from twin.calibrators.hiera_unet.model.trees import Trees
from twin.calibrators.hiera_unet.tower.plan import TowerPlan
from twin.calibrators.hiera_unet.tower.table import SUBJECT
from twin.calibrators.hiera_unet.tower.windows import CONTEXT, TARGET, TOLERANCE, CellBatch, Fleet, Jump
from twin.calibrators.hiera_unet.training import losses

JUMPS = (0.1, 0.0, 0.08, 0.5)
"""Largest added jump of fill, air, uniformity and bias; none of the air, since the fan power would not follow it."""
BURST = (2, 120)
REFERENCE_BATCHES = 16
STATICS_OF = 4096
"""Windows whose static numbers give middle and spread."""
DESIGN = 6
"""First static numbers: those of the design."""
NEAR = 0.3
"""Usual errors below which an error of a deviation counts by its square."""
MOST_EVEN = 10.0
IDENTITY = ("configuration", "plan", "channel table", "data", "number of windows")
"""Parts of `TowerTrainer.identity`."""


@dataclass(frozen=True)
class OwnWindows:
    """Windows of the station itself, which have readings only: `rows` that may be drawn, and their share of a batch."""

    fleet: Fleet
    rows: Tensor | None = None
    share: float = 0.5


class TowerTrainer:
    """Weights, optimiser, average of weights and random numbers of one training.

    Args:
        fleet: windows to learn from. own: windows of the station itself. start: weights to begin at. trees: that give
            the answer to correct; `fleet.base` has that of trees which did not learn from the window's plant.
    """

    def __init__(
        self,
        config: Config,
        fleet: Fleet,
        plan: TowerPlan,
        digest: str = "",
        own: OwnWindows | None = None,
        start: Mapping[str, Tensor] | None = None,
        trees: Trees | None = None,
    ) -> None:
        if trees is not None:
            config = replace(config, trees=tuple(trees.value.shape))
        self.config, self.fleet, self.plan, self.digest = config, fleet, plan, digest
        self.own = None if own is None else own.fleet
        self.own_rows, self.share = (None, 0.5) if own is None else (own.rows, own.share)
        self.device = fleet.device
        torch.manual_seed(plan.seed)
        self.network = HieraUNet(config).to(self.device)
        if trees is not None and self.network.trees is not None:
            self.network.trees.load_state_dict(trees.state_dict())
        if start is not None:
            self.network.load_state_dict(dict(start))
        elif config.corrects:
            self._standardise()
        self.average = HieraUNet(config).to(self.device)
        self.average.load_state_dict(self.network.state_dict())
        heavy, light = decayed(self.network)
        groups = [{"params": heavy, "weight_decay": plan.decay}, {"params": light, "weight_decay": 0.0}]
        self.optimiser = torch.optim.AdamW(groups, lr=plan.rate, fused=True)
        self.generator = torch.Generator(device=self.device).manual_seed(plan.seed)
        self.rows = torch.from_numpy(fleet.rows).to(self.device)
        self.chances = self._chances(fleet)
        self.done, self.even = 0, 1.0
        self.usual = torch.ones(len(SUBJECT.deviations), device=self.device)
        self.reference = self._reference()

    def _standardise(self) -> None:
        """Set the middle and spread of the static numbers to those of the windows."""
        rows = self.fleet.rows[:: max(len(self.fleet.rows) // STATICS_OF, 1)]
        meta = torch.cat([self.fleet.batch(torch.from_numpy(part)).meta for part in _parts(rows)])
        middle, spread = self.network.middle, self.network.spread
        assert middle is not None and spread is not None
        middle.copy_(meta.mean(0))
        spread.copy_(meta.std(0).clamp(min=1e-3))

    def _chances(self, fleet: Fleet) -> Tensor:
        """Return the chance of each window, so that kinds have the plan's shares, or cells equal ones.

        Absent kinds leave theirs.
        """
        if not self.plan.mix:
            cells = fleet.cell[self.rows].long()
            return (1.0 / torch.bincount(cells).clamp(min=1).float())[cells]
        kinds = fleet.cycles["kind"].long()[self.rows]
        count = torch.bincount(kinds, minlength=len(self.plan.mix)).float()
        mix = torch.tensor(self.plan.mix, device=self.device) / count.clamp(min=1.0)
        return mix[kinds]

    def _draw(self, count: int) -> Tensor:
        chosen = torch.multinomial(self.chances, count, replacement=True, generator=self.generator)
        return self.rows[chosen]

    def _reference(self) -> tuple[float, float]:
        """Return parameter and output loss of the belief itself, which divide the losses; set its usual error."""
        state = self.generator.get_state()
        sums = [0.0, 0.0]
        batches = [self.fleet.batch(self._draw(self.plan.batch)) for _ in range(REFERENCE_BATCHES)]
        wrong = torch.cat([one.base_theta - one.true for one in batches])
        known = torch.isfinite(wrong)
        # The mean absolute error: squares would take the rare jump as usual.
        self.usual = (torch.nan_to_num(wrong).abs().sum(0) / known.sum(0).clamp(min=1)).clamp(min=1e-3)
        for batch in batches:
            sums[0] += float(self._parameter(batch.base_theta, batch))
            error, _ = self._errors(batch, batch.base_theta, torch.zeros_like(batch.water))
            sums[1] += float(losses.mean_of(torch.nan_to_num(error).abs(), torch.isfinite(error)))
        self.generator.set_state(state)
        return max(sums[0] / REFERENCE_BATCHES, 1e-4), max(sums[1] / REFERENCE_BATCHES, 1e-3)

    def _uniform(self, *shape: int) -> Tensor:
        return torch.rand(*shape, generator=self.generator, device=self.device)

    def _jump(self, count: int) -> Jump:
        chance, which = self._uniform(count), (self._uniform(count) * 4).long().clamp(max=3)
        size = (2.0 * self._uniform(count) - 1.0) * torch.tensor(JUMPS, device=self.device)[which]
        minute = (self._uniform(count) * (CONTEXT - TARGET)).long()
        return Jump(torch.where(chance < self.plan.jumped, which, -1), size, minute)

    def hidden(self, batch: CellBatch) -> Tensor:
        """Return the mask less what an archive may lose: channels, and all measurements for a while."""
        b, n, c = batch.m.shape
        lost = (self._uniform(b, 1) < self.plan.dropped) & (self._uniform(b, c) < 0.5 * self._uniform(b, 1))
        length = BURST[0] + self._uniform(b, 1) * (BURST[1] - BURST[0])
        start = self._uniform(b, 1) * n
        step = torch.arange(n, device=self.device)
        silent = (self._uniform(b, 1) < self.plan.burst) & (step >= start) & (step < start + length)
        return batch.m & ~lost[:, None] & ~(silent[..., None] & self.fleet.told)

    def unnamed(self, batch: CellBatch) -> tuple[Tensor, Tensor, Tensor]:
        """Return static numbers, memory and clock, each without the numbers that identify a plant in some windows.

        A network must not memorise its plants.
        """
        b = len(batch.x)
        hidden = [self._uniform(b, 1) < self.plan.unnamed for _ in range(3)]
        meta = batch.meta
        if self.network.middle is not None:
            design = torch.where(hidden[0], self.network.middle[:DESIGN], meta[:, :DESIGN])
            meta = torch.cat([design, meta[:, DESIGN:]], 1)
        memory = torch.where(hidden[1][..., None], torch.zeros_like(batch.memory), batch.memory)
        return meta, memory, torch.where(hidden[2][..., None], torch.zeros_like(batch.clock), batch.clock)

    def rate(self) -> float:
        """Return the learning rate of the next step: a linear warm-up, then a cosine to 1 %."""
        warm = max(int(self.plan.warmup * self.plan.steps), 1)
        if self.done < warm:
            return self.plan.rate * (self.done + 1) / warm
        along = (self.done - warm) / max(self.plan.steps - warm, 1)
        return self.plan.rate * (0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * min(along, 1.0))))

    def step(self) -> dict[str, float] | None:
        """Take one step; return its losses, every tenth one, else None (reading them waits for the device)."""
        for group in self.optimiser.param_groups:
            group["lr"] = self.rate()
        batch, pairs, own = self.sampled()
        causal = self.done % 2 == 1
        meta, memory, clock = self.unnamed(batch)
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.plan.half):
            p = self.network(batch.x, self.hidden(batch), batch.regime, clock, meta, causal=causal, memory=memory)
        parameters, outputs, rest = self.losses_of(p, batch, pairs, own)
        if self.done % self.plan.even_every == 0 and self.done >= self.plan.even_every:
            self._make_even(parameters, outputs)
        total = outputs + self.even * parameters + rest
        self.optimiser.zero_grad(set_to_none=True)
        total.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), self.plan.clip, foreach=True)
        self.optimiser.step()
        self.done += 1
        keep = min(self.plan.ema, (1.0 + self.done) / (10.0 + self.done))
        with torch.no_grad():
            torch._foreach_lerp_(list(self.average.parameters()), list(self.network.parameters()), 1.0 - keep)
        if self.done % 10:
            return None
        found = {"loss": float(total.detach()), "parameters": float(parameters.detach())}
        found |= {"outputs": float(outputs.detach()), "even": self.even}
        if not math.isfinite(found["loss"]):
            raise HieraError(
                f"the loss is no number after {self.done} steps; train with a lower rate or in single precision"
            )
        return found

    def sampled(self) -> tuple[CellBatch, Tensor, bool]:
        """Return windows, pairs of rows that follow each other, and True for windows of the station itself."""
        count = self.plan.batch
        if self.own is not None and self.own_rows is not None and self._alternate():
            chosen = torch.randint(len(self.own_rows), (count,), generator=self.generator, device=self.device)
            return self.own.batch(self.own_rows[chosen]), torch.zeros(0, 2, dtype=torch.long), True
        two = int(count * self.plan.pairs)
        rows = self._draw(count - two)
        after = torch.where(self.fleet.follows[rows[:two]], rows[:two] + 1, rows[:two])
        pairs = torch.stack([torch.arange(two), torch.arange(two) + count - two], 1).to(self.device)
        jump = self._jump(count)
        jump.deviation[:two], jump.deviation[count - two :] = -1, -1
        rows = torch.cat([rows, after])
        wrong = self._uniform(count, 1) < self.plan.shifted
        noise = torch.randn(count, 4, generator=self.generator, device=self.device)
        shift = torch.where(wrong, noise * self.fleet.cycles["sd"][rows], torch.zeros_like(noise))
        offset = torch.randn(count, generator=self.generator, device=self.device) * self.plan.offset
        if two:
            # The windows of a pair have one thermometer.
            offset[count - two :] = offset[:two]
        return self.fleet.batch(rows, jump, shift, offset), pairs, False

    def _alternate(self) -> bool:
        """Return True in every so many steps that the station's own windows have their share."""
        return math.floor((self.done + 1) * self.share) > math.floor(self.done * self.share)

    def _parameter(self, theta: Tensor, batch: CellBatch) -> Tensor:
        """Return the mean of errors in the belief's usual ones (Huber's loss), weighted by information."""
        error = (theta - batch.true) / self.usual
        weight = batch.information.clamp(min=0.05) * torch.isfinite(error)
        size = functional.smooth_l1_loss(torch.nan_to_num(error), torch.zeros_like(error), reduction="none", beta=NEAR)
        return (weight * size).sum() / weight.sum().clamp(min=1e-6)

    def _errors(self, batch: CellBatch, theta: Tensor, delta: Tensor) -> tuple[Tensor, Tensor]:
        """Return errors of the water, and of the reading, in tolerances (B, 120); NaN is not judged."""
        through = self.plan.through * theta + (1.0 - self.plan.through) * theta.detach()
        if self.config.corrects:
            water = batch.base_water + delta
        else:
            water = batch.water + (batch.slopes * (through - batch.mean)[:, None, :3]).sum(-1) + delta
        unjudged = ~batch.judged[:, None]
        nan = torch.full_like(water, float("nan"))
        reading = torch.where(unjudged, nan, water + through[:, None, 3] - batch.reading) / TOLERANCE
        error = torch.where(unjudged, nan, water - batch.true_water) / TOLERANCE
        return error, reading

    def losses_of(self, p: Prediction, batch: CellBatch, pairs: Tensor, own: bool) -> tuple[Tensor, Tensor, Tensor]:
        """Return the losses of parameters and of outputs, and the rest, of what `sampled` returned."""
        delta = p.delta[..., 0].float()
        error, reading = self._errors(batch, p.theta, delta)
        shown = reading if own else error
        outputs = losses.mean_of(torch.nan_to_num(shown).abs(), torch.isfinite(shown)) / self.reference[1]
        parameters = self._parameter(p.theta, batch) / self.reference[0]
        if own:
            # A station has no truth: its parameters stay where the belief and the family put them.
            parameters = parameters * 0.0
        rest = self.plan.price * ((delta / TOLERANCE) ** 2).mean()
        if len(pairs):
            rest = rest + self.plan.smooth * losses.smooth_loss(p.theta, self.fleet.bounds, pairs)
        if self.done >= self.plan.sure * self.plan.steps:
            judged = (reading if own else error)[..., None]
            likely = losses.laplace_loss(
                judged * TOLERANCE, p.log_scale.float(), torch.tensor([TOLERANCE], device=self.device)
            )
            if not own:
                wrong = p.theta - batch.true
                likely = likely + losses.gaussian_loss(wrong, p.log_variance, self.fleet.bounds, torch.isfinite(wrong))
            rest = rest + self.plan.uncertainty * likely
        return parameters, outputs, rest

    def _make_even(self, parameters: Tensor, outputs: Tensor) -> None:
        """Take the weight of the parameter loss so that its gradient in the encoder is as large as the outputs'."""
        shared = self.network.encoder.merges[-1].proj.weight
        sizes = [
            float(torch.autograd.grad(loss, shared, retain_graph=True, allow_unused=True)[0].norm())
            for loss in (parameters, outputs)
            if loss.requires_grad
        ]
        if len(sizes) == 2 and min(sizes) > 0.0:
            wanted = min(max(sizes[1] / sizes[0], 1.0 / MOST_EVEN), MOST_EVEN)
            self.even = math.exp(0.8 * math.log(self.even) + 0.2 * math.log(wanted))

    def state(self) -> dict[str, Any]:
        """Return everything needed to go on: tensors and plain data."""
        return {
            "identity": self.identity(),
            "done": self.done,
            "even": self.even,
            "network": self.network.state_dict(),
            "average": self.average.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "generator": self.generator.get_state(),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state` gave.

        Raises:
            HieraError: it belongs to another configuration, plan or other windows.
        """
        if state["identity"] != self.identity():
            raise HieraError(
                f"the training that was begun here has another configuration, plan or data: "
                f"{_differences(str(state['identity']), self.identity())}; use another folder, or remove its "
                "training.pt to begin anew",
                code="OTHER_PLAN",
            )
        self.done, self.even = int(state["done"]), float(state["even"])
        self.network.load_state_dict(state["network"])
        self.average.load_state_dict(state["average"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.generator.set_state(state["generator"].cpu())

    def identity(self) -> str:
        """Return what must be the same for a training to go on."""
        return json.dumps(
            (self.config.document(), self.plan.document(), SUBJECT.digest(), self.digest, len(self.fleet)),
            sort_keys=True,
        )


def _parts(rows: NDArray[np.int64], size: int = 64) -> list[NDArray[np.int64]]:
    return [rows[at : at + size] for at in range(0, len(rows), size)]


def _differences(begun: str, now: str) -> str:
    """Return in words what differs between the identities of two trainings."""
    found = []
    for name, a, b in zip(IDENTITY, json.loads(begun), json.loads(now), strict=True):
        if isinstance(a, dict) and isinstance(b, dict):
            found += [f"{k} was {a.get(k)}, is {b.get(k)}" for k in sorted(a.keys() | b.keys()) if a.get(k) != b.get(k)]
        elif a != b:
            found.append(f"{name} was {str(a)[:12]}, is {str(b)[:12]}")
    return ", ".join(found)
