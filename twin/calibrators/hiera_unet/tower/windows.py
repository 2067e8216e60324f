"""Windows of many cells, cut on the training device: channels, the twin linearised about the window's prior, and the
truth.

All tables lie in one row of minutes. A window of a cycle is the day up to the end of its target. Channels that depend
on the prior are computed here: the residual of the twin at the prior mean, and for each deviation

    score = residual slope,    rate = slope^2,      in units of the outlet's tolerance and the deviation's bound.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from twin.calibrators.hiera_unet.model.config import HieraError
from twin.calibrators.hiera_unet.tower.cell_table import MAINTAINED, CellTable
from twin.calibrators.hiera_unet.tower.table import MOST, SUBJECT

CONTEXT, TARGET = SUBJECT.context, SUBJECT.target
TOLERANCE = SUBJECT.outputs[0].tolerance
OUTLET = SUBJECT.index("r_outlet")
SCORES = slice(SUBJECT.index("score_fill"), SUBJECT.index("score_bias") + 1)
RATES = slice(SUBJECT.index("rate_fill"), SUBJECT.index("rate_bias") + 1)
MEANS = slice(-13, -9)
"""Places of the prior's means among the static numbers."""
BLOCK_MIN = 10
LAST_MIN = (30, 120, 720)
"""Minutes before the target over which mean residuals are features of the trees."""
MINUTELY = ("x", "m", "regime", "clock", "outlet", "reading", "water", "slopes", "commissioned", "true_water", "point")
CYCLED = ("mean", "sd", "fit", "fit_sd", "true", "condition", "age_h", "seen", "kind", "jumped")


@dataclass(frozen=True)
class CellBatch:
    """B windows.

    Attributes:
        x, m, regime, clock, meta, memory: inputs of the network.
        water: (B, 120) outlet by the twin at the belief, degC; slopes: (B, 120, 3).
        reading: (B, 120) samples of the target, degC; true_water: (B, 120); both NaN where there is none.
        mean, sd, true: (B, 4) belief and truth. information: (B, 4) share of the prior variance that the belief has
        resolved. judged: (B,) False where something begins inside the target.
        base_theta, base_water: (B, 4), (B, 120) answer that a network corrects: the belief, or boosted trees on it.
        based: whether it is that of the trees. features: (B, F) and minutely: (B, 120, 5) that the trees read.
    """

    x: Tensor
    m: Tensor
    regime: Tensor
    clock: Tensor
    meta: Tensor
    memory: Tensor
    water: Tensor
    slopes: Tensor
    reading: Tensor
    true_water: Tensor
    mean: Tensor
    sd: Tensor
    true: Tensor
    information: Tensor
    judged: Tensor
    base_theta: Tensor
    base_water: Tensor
    based: bool
    features: Tensor
    minutely: Tensor

    def begun(self, theta: Tensor, water: Tensor) -> CellBatch:
        """Return the windows with corrections of the prior, deviations (B, 4) and outlet (B, 12) K, as the answer to
        correct.
        """
        base = self.mean + theta
        meta = self.meta.clone()
        meta[:, MEANS] = base
        moved = self.water + water.repeat_interleave(BLOCK_MIN, 1)
        return replace(self, meta=meta, base_theta=base, base_water=moved, based=True)


@dataclass(frozen=True)
class Jump:
    """Jump of one deviation that is added to windows: `deviation` (B,), -1 for none, `size` (B,), first `minute` (B,)
    of the context.
    """

    deviation: Tensor
    size: Tensor
    minute: Tensor


class Fleet:
    """Tables of many cells on a device.

    Attributes:
        base: corrections of the belief by cycle, (K, 4) and (K, 12), where they were worked out before.

    Raises:
        HieraError: there is no table, or none has a window.
    """

    def __init__(self, tables: Sequence[CellTable], device: torch.device | str = "cpu") -> None:
        if not tables:
            raise HieraError("there is no table of a cell; simulate stations first with `hil train tower`")
        self.device = torch.device(device)
        self.names = [one.name for one in tables]
        self.minutes = sizes = np.array([len(one.regime) for one in tables])
        offsets = np.r_[0, np.cumsum(sizes)[:-1]]
        self.arrays = {name: self._joined([getattr(t, name) for t in tables]) for name in MINUTELY}
        chunks = np.array([len(t.reference) for t in tables])
        first = np.r_[0, np.cumsum(chunks)[:-1]]
        self.reference = self._joined([t.reference for t in tables])
        self.chunk = self._joined([t.chunk + o for t, o in zip(tables, first, strict=True)]).long()
        self.start = self._joined([t.start + o for t, o in zip(tables, offsets, strict=True)])
        self.cell = self._joined([np.full(len(t.start), i) for i, t in enumerate(tables)])
        self.cycles = {name: self._joined([getattr(t, name) for t in tables]) for name in CYCLED}
        self.valid = np.concatenate([t.valid for t in tables])
        self.share = np.concatenate([t.start / len(t.regime) for t in tables])
        self.statics = self._stacked([t.statics for t in tables])
        self.memory = self._stacked([t.memory for t in tables])
        self.design = self._stacked([t.design for t in tables])
        self.rows = np.flatnonzero(self.valid)
        if not len(self.rows):
            raise HieraError(
                "no cycle of the tables is a window: records need 22 days and running cells; simulate more"
            )
        follows = np.r_[self.valid[1:], False] & np.r_[np.diff(self.cell.cpu().numpy()) == 0, False]
        quiet = self.cycles["kind"].cpu().numpy() != MAINTAINED
        self.follows = torch.from_numpy(follows & quiet).to(self.device)
        prior = torch.tensor([one.prior_sd for one in SUBJECT.deviations], device=self.device)
        self.bounds = torch.tensor([one.bound for one in SUBJECT.deviations], device=self.device)
        self.prior = prior
        self.base: tuple[Tensor, Tensor] | None = None
        told = torch.tensor(SUBJECT.told, device=self.device)
        self.told = told

    def _joined(self, parts: Sequence[np.ndarray]) -> Tensor:
        return torch.from_numpy(np.concatenate(parts)).to(self.device)

    def _stacked(self, parts: Sequence[np.ndarray]) -> Tensor:
        return torch.from_numpy(np.stack(parts)).to(self.device)

    def __len__(self) -> int:
        return len(self.rows)

    def batch(
        self, rows: Tensor, jump: Jump | None = None, shift: Tensor | None = None, offset: Tensor | None = None
    ) -> CellBatch:
        """Return the windows of cycles `rows` (B,).

        Parameters:
            jump: added to readings, truth and labels. shift: (B, 4) added to the belief, as if it were wrong. offset:
            (B,) K added to readings and to the bias of belief, fit and truth, as if the thermometer were another.
        """
        rows = rows.to(self.device)
        start, cell = self.start[rows], self.cell[rows]
        index = start[:, None] + torch.arange(TARGET - CONTEXT, TARGET, device=self.device)
        a = {name: self.arrays[name][index] for name in MINUTELY if name not in ("commissioned",)}
        c = {name: self.cycles[name][rows] for name in CYCLED}
        if offset is not None:
            for name in ("mean", "fit", "true"):
                c[name] = torch.cat([c[name][:, :3], c[name][:, 3:] + offset[:, None]], 1)
        mean = c["mean"] if shift is None else c["mean"] + shift
        x, m = a["x"].float(), a["m"].clone()
        reading, true_water, true, sample = a["reading"], a["true_water"], c["true"], a["outlet"]
        if offset is not None:
            level = offset[:, None].expand_as(reading)
            reading, sample = reading + level, sample + level
            self._move_channels(x, level, a["point"].float(), cell)
        if jump is not None:
            moved, water_moved, true = self._jumped(jump, a["slopes"], true)
            reading, true_water, sample = reading + moved, true_water + water_moved, sample + moved
            self._move_channels(x, moved, a["point"].float(), cell)
        change = mean[:, None, :3] - self.reference[self.chunk[index]]
        water = a["water"] + (a["slopes"] * change).sum(-1)
        residual = (reading - water - mean[:, None, 3]) / TOLERANCE
        there = torch.isfinite(residual)
        residual = torch.nan_to_num(residual).clamp(-MOST, MOST)
        slope = torch.cat(
            [
                a["slopes"] * self.bounds[:3] / TOLERANCE,
                torch.full_like(reading, float(self.bounds[3]) / TOLERANCE)[..., None],
            ],
            -1,
        )
        x[..., OUTLET] = residual
        x[..., SCORES] = (0.5 * residual[..., None] * slope).clamp(-MOST, MOST)
        x[..., RATES] = (0.25 * slope**2).clamp(0.0, MOST)
        m[..., OUTLET] = there
        m[..., SCORES] = there[..., None]
        m[..., RATES] = torch.isfinite(a["water"])[..., None]
        hidden = self._hidden(torch.isfinite(a["outlet"]))
        m &= ~(hidden[..., None] & self.told)
        sampled = torch.where(torch.isfinite(a["outlet"]), reading, torch.full_like(reading, float("nan")))
        resolved = (1.0 - (c["sd"] / self.prior) ** 2).clamp(0.0, 1.0)
        meta = self._meta(c, mean, cell, a["point"].float(), resolved)
        before = (sample - water - mean[:, None, 3])[:, : CONTEXT - TARGET]
        recent = torch.nan_to_num(torch.stack([torch.nanmean(before[:, -k:], 1) for k in LAST_MIN], 1))
        lead = torch.arange(TARGET, device=self.device).float()[None, :, None].expand(len(rows), -1, 1) / TARGET
        found = CellBatch(
            x,
            m,
            a["regime"],
            a["clock"].float(),
            meta,
            self.memory[cell],
            water[:, -TARGET:],
            a["slopes"][:, -TARGET:],
            sampled[:, -TARGET:],
            true_water[:, -TARGET:],
            mean,
            c["sd"],
            true,
            resolved,
            ~c["jumped"],
            mean,
            water[:, -TARGET:],
            False,
            torch.cat([meta, recent], 1),
            torch.cat([a["point"][:, -TARGET:].float(), lead], -1),
        )
        return found if self.base is None else found.begun(self.base[0][rows], self.base[1][rows])

    @staticmethod
    def _hidden(sampled: Tensor) -> Tensor:
        """Return the target and the minutes after the last sample before it (B, 1440)."""
        step = torch.arange(sampled.shape[1], device=sampled.device)
        before = sampled & (step < CONTEXT - TARGET)
        last = torch.where(before, step, -1).max(dim=1).values
        return step[None] > last[:, None]

    def _jumped(self, jump: Jump, slopes: Tensor, true: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return what a jump adds to readings and to the water (B, 1440), and the labels with it."""
        step = torch.arange(CONTEXT, device=self.device)
        size = torch.where(jump.deviation >= 0, jump.size, torch.zeros_like(jump.size))
        since = (step[None] >= jump.minute[:, None]) * size[:, None]
        which = jump.deviation.clamp(min=0)
        slope = torch.cat([slopes, torch.ones_like(slopes[..., :1])], -1)
        own = slope.gather(-1, which[:, None, None].expand(-1, CONTEXT, 1))[..., 0]
        moved = own * since
        water = torch.where((which == 3)[:, None], torch.zeros_like(moved), moved)
        labels = true + torch.nn.functional.one_hot(which, 4) * size[:, None]
        return moved, water, labels

    def _move_channels(self, x: Tensor, moved: Tensor, point: Tensor, cell: Tensor) -> None:
        """Add a change of the outlet reading, K (B, 1440), to the channels that are made of it."""
        fall, approach = self.design[cell, 0][:, None], self.design[cell, 1][:, None]
        drive = torch.nan_to_num(10.0 * (point[..., 1] + 1.0), nan=10.0).clamp(min=1.0)
        flow = torch.nan_to_num(0.5 * point[..., 3] + 1.0, nan=1.0)
        for name, change in (
            ("t_out", moved / 10.0),
            ("approach", moved / approach),
            ("range", -moved / fall),
            ("effectiveness", -4.0 * moved / drive),
            ("heat", -flow * moved / fall),
            ("r_commissioned", moved / TOLERANCE),
        ):
            x[..., SUBJECT.index(name)] += change

    def _meta(self, c: dict[str, Tensor], mean: Tensor, cell: Tensor, point: Tensor, resolved: Tensor) -> Tensor:
        known = torch.isfinite(point)
        count = known.sum(1).clamp(min=1)
        level = torch.nan_to_num(point).sum(1) / count
        spread = ((torch.nan_to_num(point - level[:, None]) ** 2).sum(1) / count).sqrt()
        belief = torch.stack([torch.log1p(c["age_h"]) / 3.0, c["seen"] / 144.0], -1)
        condition = torch.log10(c["condition"].clamp(1.0, 1e6))[:, None] / 3.0
        return torch.cat(
            [self.statics[cell], level, spread, belief, c["fit"], c["fit_sd"], mean, c["sd"], resolved, condition], -1
        )
