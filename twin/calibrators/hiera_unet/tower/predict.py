"""Predictions of a network on windows, and the blindness gate: dependence of each head on the channels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from twin.calibrators.hiera_unet.model.network import HieraUNet, Prediction
from twin.calibrators.hiera_unet.model.trees import Trees
from twin.calibrators.hiera_unet.tower.windows import BLOCK_MIN, TARGET, CellBatch, Fleet
from twin.tower.air import Array

LEAST_WORSE = 0.05
"""Least relative increase of the errors of parameters, or outputs, with another window's channels."""
RESAMPLES = 1000
BLOCK_CYCLES = 84
"""Cycles of a bootstrap block: a week."""
BLIND = "BLIND"
NETWORKS = "the outlet is the network's"


@dataclass(frozen=True)
class Predicted:
    """Predictions of K windows, with what they are judged by.

    Attributes
    ----------
    rows
        (K,) cycles.
    theta, log_variance
        (K, 4), the latter in units of the bounds.
    delta, log_scale
        (K, 120), K and logarithm of tolerances; the former is added to the twin at `theta`.
    attention
        (K, 4, 12) of each query.
    """

    rows: NDArray[np.int64]
    theta: Array
    log_variance: Array
    delta: Array
    log_scale: Array
    attention: Array


def begun(network: HieraUNet, batch: CellBatch) -> CellBatch:
    """Return windows with the answer that a network corrects: that of its trees, else the belief."""
    if network.trees is None or batch.based:
        return batch
    return batch.begun(*corrections_of(network.trees, batch))


@torch.no_grad()
def corrections_of(trees: Trees, batch: CellBatch) -> tuple[Tensor, Tensor]:
    """Return the corrections of the prior by trees: deviations (B, 4), and outlet (B, 12) K by blocks of ten minutes.

    The first model is that of the outlet.
    """
    points = batch.minutely[:, BLOCK_MIN // 2 :: BLOCK_MIN]
    rows = torch.cat([batch.features[:, None].expand(-1, points.shape[1], -1), points], -1)
    water = trees(rows.flatten(0, 1), 0).unflatten(0, (len(batch.features), -1))
    theta = torch.stack([trees(batch.features, 1 + j) for j in range(batch.mean.shape[1])], 1)
    return theta, water


def settle(fleet: Fleet, trees: Trees, rows: NDArray[np.int64] | None = None, size: int = 256) -> None:
    """Compute the answer of trees to windows of a fleet, so that its batches have it.

    Parameters
    ----------
    rows
        Cycles (K,); all windows by default. Others keep theirs, at first no correction.
    """
    if rows is None or fleet.base is None:
        cycles, device = len(fleet.valid), fleet.device
        blank = torch.zeros(cycles, fleet.bounds.numel() + TARGET // BLOCK_MIN, device=device)
    else:
        blank = torch.cat(fleet.base, 1)
    theta, water = blank.split((fleet.bounds.numel(), TARGET // BLOCK_MIN), 1)
    fleet.base = None
    chosen = fleet.rows if rows is None else rows
    for at in range(0, len(chosen), size):
        part = torch.from_numpy(chosen[at : at + size]).to(fleet.device)
        theta[part], water[part] = corrections_of(trees, fleet.batch(part))
    fleet.base = theta, water


def outlet_of(network: HieraUNet, p: Prediction, batch: CellBatch) -> Tensor:
    """Return the predicted outlet (B, 120), degC.

    It is the correction of the given answer, or of the twin at the deviations for a network of an earlier kind. If the
    gate refused the outlet, it is the given answer.
    """
    if network.start_outlet:
        return batch.base_water
    delta = p.delta[..., 0].float()
    if network.config.corrects:
        return batch.base_water + delta
    return batch.water + (batch.slopes * (p.theta - batch.mean)[:, None, :3]).sum(-1) + delta


def answer(network: HieraUNet, batch: CellBatch, causal: bool, half: bool) -> Prediction:
    """Return the prediction of a network for a batch."""
    with torch.inference_mode(), torch.autocast(batch.x.device.type, torch.bfloat16, enabled=half):
        return network(batch.x, batch.m, batch.regime, batch.clock, batch.meta, causal=causal, memory=batch.memory)


def predict(
    network: HieraUNet,
    fleet: Fleet,
    rows: NDArray[np.int64],
    size: int = 64,
    causal: bool = True,
    half: bool = False,
    lost: float = 0.0,
) -> Predicted:
    """Return the predictions of cycles `rows` (K,).

    Parameters
    ----------
    lost
        Share of the channels that each window loses, drawn by a fixed seed.
    """
    generator = torch.Generator(device=fleet.device).manual_seed(0)
    parts: list[tuple[Array, ...]] = []
    for at in range(0, len(rows), size):
        chosen = torch.from_numpy(rows[at : at + size]).to(fleet.device)
        batch = begun(network, fleet.batch(chosen))
        if lost:
            gone = torch.rand(len(chosen), batch.m.shape[-1], generator=generator, device=fleet.device) < lost
            batch.m[:] = batch.m & ~gone[:, None]
        p = answer(network, batch, causal, half)
        delta = p.delta[..., 0]
        if network.config.corrects or network.start_outlet:
            at_theta = batch.water + (batch.slopes * (p.theta - batch.mean)[:, None, :3]).sum(-1)
            delta = outlet_of(network, p, batch) - at_theta
        found = (p.theta, p.log_variance, delta, p.log_scale[..., 0], p.attention)
        parts.append(tuple(v.float().cpu().numpy() for v in found))
    theta, log_variance, delta, log_scale, attention = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Predicted(rows, theta, log_variance, delta, log_scale, attention)


@dataclass(frozen=True)
class Blindness:
    """Relative increase of the errors with another window's channels.

    That of parameters and of outputs, each with its 95 % interval by a block bootstrap.
    """

    parameters: tuple[float, float, float]
    outputs: tuple[float, float, float]
    windows: int

    @property
    def code(self) -> str:
        """Return `BLIND` if the parameters hardly depend on the channels, so that the checkpoint is refused;
        else "".
        """
        return _code(self.parameters)

    @property
    def outputs_code(self) -> str:
        """Return `BLIND` if the outputs hardly depend on the channels, so that the start's outlet is used; else ""."""
        return _code(self.outputs)

    def document(self) -> dict[str, Any]:
        """Return plain data for a card."""
        return {
            "parameters_worse": list(self.parameters),
            "outputs_worse": list(self.outputs),
            "windows": self.windows,
            "least": LEAST_WORSE,
            "code": self.code or "none",
            "heads": {"parameters": self.code or "none", "outputs": self.outputs_code or "none"},
        }


def _code(worse: tuple[float, float, float]) -> str:
    return "" if worse[0] >= LEAST_WORSE and worse[1] > 0.0 else BLIND


def outlet_refused(card: Mapping[str, Any]) -> bool:
    """Return True if the gate refused the outputs of a member; False for a card with one code for both heads."""
    return bool(card.get("gate", {}).get("heads", {}).get("outputs") == BLIND)


def start_sentence(trees: bool, whose: Sequence[str] = ()) -> str:
    """Return a sentence of card and report about an outlet that the gate refused.

    Parameters
    ----------
    trees
        Whether the network starts from boosted trees.
    whose
        Members of an ensemble that it holds for, if it holds for some.
    """
    start = "boosted trees on Gauss-Newton" if trees else "Gauss-Newton"
    if whose:
        names, theirs = ", ".join(whose), "their" if len(whose) > 1 else "its"
        return f"the outlet of {names} is that of the start ({start}); only {theirs} parameters are the network's"
    return f"the outlet is that of the start ({start}); only the parameters are the network's"


def judgement(gate: Blindness, trees: bool) -> dict[str, Any]:
    """Return the entries of a card that the figures of the gate decide.

    Parameters
    ----------
    trees
        Whether the network starts at boosted trees.
    """
    outlet = start_sentence(trees) if gate.outputs_code else NETWORKS
    return {"gate": gate.document(), "refused": gate.code, "outlet": outlet}


def judged(card: Mapping[str, Any]) -> dict[str, Any]:
    """Return the card of a member with the codes of its heads by the figures that it has.

    Raises
    ------
    KeyError, TypeError, ValueError
        The card has no figures of the gate.
    """
    told = card["gate"]
    parameters, outputs = ((*map(float, told[f"{head}_worse"]),) for head in ("parameters", "outputs"))
    if len(parameters) != 3 or len(outputs) != 3:
        raise ValueError("a figure of the gate is a share with both ends of its interval")
    gate = Blindness(parameters, outputs, int(told["windows"]))
    return {**card, **judgement(gate, bool(card.get("config", {}).get("trees")))}


NOT_TESTED = Blindness((float("nan"),) * 3, (float("nan"),) * 3, 0)
"""Figures of a member that the gate has not seen: refused."""


def blindness(
    network: HieraUNet, fleet: Fleet, count: int = 768, size: int = 64, half: bool = False, seed: int = 0
) -> Blindness:
    """Return how much worse the answers are with the channels, regimes and times of another window.

    Belief, static numbers and memory stay the window's own, so that only what the channels add is lost.
    """
    rng = np.random.default_rng(seed)
    rows = np.sort(rng.choice(fleet.rows, min(count, len(fleet.rows)), replace=False))
    other = rng.permutation(rows)
    errors: list[Array] = []
    for at in range(0, len(rows), size):
        batch = begun(network, fleet.batch(torch.from_numpy(rows[at : at + size])))
        strange = fleet.batch(torch.from_numpy(other[at : at + size]))
        mixed = CellBatch(
            **{**batch.__dict__, "x": strange.x, "m": strange.m, "regime": strange.regime, "clock": strange.clock}
        )
        columns = []
        for one in (batch, mixed):
            p = answer(network, one, False, half)
            columns += [_parameter_error(p.theta, batch, fleet.bounds), _output_error(network, p, batch)]
        errors.append(torch.stack(columns, 1).float().cpu().numpy())
    table = np.concatenate(errors)
    cells = fleet.cell.cpu().numpy()[rows]
    block = cells.astype(np.int64) * 100000 + rows // BLOCK_CYCLES
    return Blindness(
        _worse(table[:, 0], table[:, 2], block, rng), _worse(table[:, 1], table[:, 3], block, rng), len(rows)
    )


def _parameter_error(theta: Tensor, batch: CellBatch, bounds: Tensor) -> Tensor:
    weight = batch.information.clamp(min=0.05)
    return ((theta - batch.true).abs() / bounds * weight).sum(1) / weight.sum(1)


def _output_error(network: HieraUNet, p: Prediction, batch: CellBatch) -> Tensor:
    return torch.nanmean((outlet_of(network, p, batch) - batch.true_water).abs(), 1)


def _worse(own: Array, other: Array, block: NDArray[np.int64], rng: np.random.Generator) -> tuple[float, float, float]:
    return interval(other, own, block, rng)


def interval(
    ours: Array, rival: Array, block: NDArray[np.int64], rng: np.random.Generator
) -> tuple[float, float, float]:
    """Return mean(ours)/mean(rival) - 1 with its 95 % interval by a bootstrap of blocks of windows."""
    there = np.isfinite(ours) & np.isfinite(rival)
    ours, rival = ours[there], rival[there]
    _, number = np.unique(block[there], return_inverse=True)
    if not len(ours):
        return float("nan"), float("nan"), float("nan")
    sums = np.stack([np.bincount(number, ours), np.bincount(number, rival)])
    drawn = rng.integers(0, sums.shape[1], (RESAMPLES, sums.shape[1]))
    ratios = sums[0][drawn].sum(1) / np.maximum(sums[1][drawn].sum(1), 1e-12) - 1.0
    low, high = np.quantile(ratios, (0.025, 0.975))
    return float(ours.mean() / max(rival.mean(), 1e-12) - 1.0), float(low), float(high)
