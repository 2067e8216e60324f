"""Contestants of the trial: rivals, the small Hiera-UNet, the same without one of its parts, and one remedy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

from hil.bench.rivals.networks import BODIES, PATCH_MIN, Rival
from twin.calibrators.hiera_unet.model.config import Config
from twin.calibrators.hiera_unet.model.network import HieraUNet
from twin.calibrators.hiera_unet.tower.table import CHANNELS, SUBJECT
from twin.calibrators.hiera_unet.tower.windows import CellBatch

HIERA = "Hiera-UNet, small"
REMEDY = "Hiera-UNet, no correction of a window's mean"


class Corrector(nn.Module):
    """Hiera-UNet as a correction of the outlet alone, in its symmetric branch: it reads the whole day, as rivals do."""

    def __init__(self, config: Config) -> None:
        super().__init__()
        self.network = HieraUNet(config)

    def forward(self, x: Tensor, m: Tensor, regime: Tensor, clock: Tensor, meta: Tensor, memory: Tensor) -> Tensor:
        """Return corrections of the outlet in the target (B, 120), K."""
        found: Tensor = self.network(x, m, regime, clock, meta, memory=memory).delta[..., 0].float()
        return found


@dataclass(frozen=True)
class Contestant:
    """Network of the trial.

    Attributes
    ----------
    name
        In tables.
    kind
        ``rival``, ``network``, ``ablation`` or ``remedy``.
    build
        Returns its untrained network.
    hidden
        Names of channels that it never sees.
    memory
        Whether it sees the tokens of the healthy record.
    centred
        Whether its correction has no mean over a target, and is trained on the error without its mean.
    """

    name: str
    kind: str
    build: Callable[[], nn.Module]
    hidden: tuple[str, ...] = ()
    memory: bool = True
    centred: bool = False

    def correction(self, network: nn.Module, batch: CellBatch, m: Tensor) -> Tensor:
        """Return the correction of the outlet (B, 120), K, with the mask `m` (B, 1440, C)."""
        if self.hidden:
            m = m & ~torch.tensor([one.name in self.hidden for one in CHANNELS])
        memory = batch.memory if self.memory else torch.zeros_like(batch.memory)
        delta: Tensor = network(batch.x, m, batch.regime, batch.clock, batch.meta, memory)
        return delta - delta.mean(1, keepdim=True) if self.centred else delta


def _small(**changes: object) -> Callable[[], nn.Module]:
    return lambda: Corrector(replace(SUBJECT.config("small"), **changes))  # type: ignore[arg-type]


def _rival(name: str) -> Contestant:
    return Contestant(name, "rival", lambda: Rival(SUBJECT.config("small"), BODIES[name]))


RESIDUALS = tuple(one.name for one in CHANNELS if one.name.startswith("r_"))
EVIDENCE = tuple(one.name for one in CHANNELS if one.group == "evidence")
CONTESTANTS: tuple[Contestant, ...] = (
    *map(_rival, BODIES),
    Contestant(HIERA, "network", _small()),
    Contestant(REMEDY, "remedy", _small(), centred=True),
    Contestant(f"{HIERA}, no residual channels", "ablation", _small(), hidden=RESIDUALS),
    Contestant(f"{HIERA}, no evidence over time", "ablation", _small(), hidden=EVIDENCE),
    Contestant(f"{HIERA}, no memory", "ablation", _small(), memory=False),
    Contestant(f"{HIERA}, no hierarchy", "ablation", _small(merges=(PATCH_MIN, 1, 1))),
)
