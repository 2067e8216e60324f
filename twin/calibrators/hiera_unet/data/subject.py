"""Subject: a kind of plant that a network is trained for, with its channels, deviations and outputs."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from typing import Any

from twin.calibrators.hiera_unet.model.config import Config, named


@dataclass(frozen=True)
class Channel:
    """Channel of a record: name, group, unit of its normalised value.

    `told`: it reveals the answer, so it is hidden in the target. `windowed`: it depends on the window's own prior and
    is computed when a window is read.
    """

    name: str
    group: str
    unit: str
    told: bool = False
    windowed: bool = False


@dataclass(frozen=True)
class Deviation:
    """Parameter deviation: name, unit, bound, standard deviation of its prior."""

    name: str
    unit: str
    bound: float
    prior_sd: float


@dataclass(frozen=True)
class Output:
    """Corrected output: name, unit and engineering tolerance."""

    name: str
    unit: str
    tolerance: float


@dataclass(frozen=True)
class Subject:
    """Kind of plant.

    Attributes:
        step_s: of the record. context, target: steps of input, and steps to predict at their end. regimes: operating
            regimes. statics: static numbers of a window before the evidence. memory: numbers of a memory token.
        slope_signs, residual, corrects: see `Config`; the residual by its channel's name.
    """

    name: str
    step_s: float
    channels: tuple[Channel, ...]
    regimes: int
    outputs: tuple[Output, ...]
    deviations: tuple[Deviation, ...]
    statics: int
    memory: int = 0
    slope_signs: tuple[int, ...] = ()
    residual: str = ""
    corrects: bool = False
    context: int = 1440
    target: int = 120

    @property
    def groups(self) -> tuple[int, ...]:
        """Return the number of channels of each group, in the order of the table."""
        order = list(dict.fromkeys(one.group for one in self.channels))
        return tuple(sum(one.group == group for one in self.channels) for group in order)

    @property
    def told(self) -> tuple[bool, ...]:
        """Return the channels that reveal the answer."""
        return tuple(one.told for one in self.channels)

    def index(self, name: str) -> int:
        """Return the position of a channel."""
        return next(i for i, one in enumerate(self.channels) if one.name == name)

    def config(self, size: str) -> Config:
        """Return the configuration ``small`` or ``full`` for this subject, with evidence.

        Raises:
            HieraError: there is no such size.
        """
        sizes: dict[str, Any] = {
            "groups": self.groups,
            "bounds": tuple(one.bound for one in self.deviations),
            "tolerances": tuple(one.tolerance for one in self.outputs),
            "regimes": self.regimes,
            "evidence": True,
            "meta": self.statics + 5 * len(self.deviations) + 1,
            "memory": self.memory,
            "slope_signs": self.slope_signs,
            "residual": self.index(self.residual) if self.residual else 0,
            "corrects": self.corrects,
            "step_s": self.step_s,
            "context": self.context,
            "target": self.target,
        }
        return named(size, **sizes)

    def digest(self) -> str:
        """Return a digest of the channel table: weights of another table do not fit."""
        rows = [(one.name, one.group, one.unit, one.told) for one in self.channels]
        text = json.dumps([self.name, self.step_s, rows, self.statics, self.memory])
        return hashlib.sha256(text.encode()).hexdigest()
