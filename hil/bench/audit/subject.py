"""Audit of one subject: what was measured of its members, its losses and its trainings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from hil.bench.audit.probe import Probe
from hil.bench.audit.shares import Correction, Replacement, correction, replacements
from hil.bench.audit.terms import LossTerm


@dataclass(frozen=True)
class MemberAudit:
    """Replaced inputs and corrections of one member, as it is shipped."""

    name: str
    replaced: Mapping[str, Replacement]
    correction: Correction

    @classmethod
    def of(cls, name: str, network: Any, probe: Probe, seed: int) -> MemberAudit:
        """Measure a member."""
        found = {one.part: one for one in replacements(network, probe, seed)}
        return cls(name, found, correction(network, probe))


@dataclass(frozen=True)
class TrainingProgress:
    """Training of a member by its card.

    Attributes
    ----------
    steps, batch, windows
        Steps, windows of each, and windows to learn from.
    parameters, outputs
        Errors at the end on windows outside of the training, over those of the start, less one.
    late
        Change of `outputs` over the last third of the training.
    losses
        Loss of the outputs on training windows at the first and the last evaluation; None where the card has none.
    factors
        Factor on the correction of the outputs with the least error on held-out windows, at each evaluation, by step.
    """

    name: str
    steps: int
    batch: int
    windows: int
    parameters: float
    outputs: float
    late: float
    losses: tuple[float, float] | None = None
    factors: Mapping[int, float] | None = None

    @property
    def epochs(self) -> float:
        """Return how often the training saw each window, on average."""
        return self.steps * self.batch / self.windows


@dataclass(frozen=True)
class OutputGain:
    """Raw correction of the outlet by one member, with its factor at one, on one kind of windows.

    Attributes
    ----------
    of, start
        Windows that it is measured on, and answer that the correction is added to.
    size_K, start_K
        Mean absolute correction, and mean absolute error of the start.
    within_K, between
        Mean absolute distance of the correction from its mean over the window, and share of the variance of these means
        that lies between plants.
    change
        Relative change of the error by the raw correction with its 95 % interval.
    factor
        Factor of the correction with the least absolute error, 0 to 1.
    """

    member: str
    of: str
    start: str
    size_K: float
    start_K: float
    within_K: float
    between: float
    change: tuple[float, float, float]
    factor: float


@dataclass(frozen=True)
class SubjectAudit:
    """Everything that was measured of a subject.

    Attributes
    ----------
    losses
        Terms of the loss by state of the first member.
    terms
        Names of the terms of outputs, of parameters, and of outputs that act through the twin.
    sensitivities, channels
        Number of channels that hold a sensitivity of the twin, and of all.
    leakage
        Largest dependence of the deviations on the order of the last steps; None where it was not measured.
    gains
        Raw corrections of the outlet, for a subject whose members have a factor on them.
    factors
        Stored factor of the outlet's correction by member.
    """

    probe: Probe
    members: tuple[MemberAudit, ...]
    losses: Mapping[str, list[LossTerm]]
    terms: tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]
    trainings: tuple[TrainingProgress, ...]
    sensitivities: int
    channels: int
    leakage: float | None = None
    gains: tuple[OutputGain, ...] = ()
    factors: Mapping[str, float] | None = None
