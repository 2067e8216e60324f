"""Probe of a network: windows with their truth, and answers with a part of the inputs taken from another plant."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin import Array
from twin.calibrators.hiera_unet.tower.predict import interval

BATCH = 16
"""Windows of one forward pass."""
CHANNELS = ("x", "m", "regime", "clock")
EVERYTHING, ALL_CHANNELS, EVIDENCE, STATICS, MEMORY = (
    "everything",
    "all channels",
    "evidence token",
    "metadata",
    "memory",
)


@dataclass(frozen=True)
class Probe:
    """N windows of one subject, their truth, and the answer that the network starts from.

    Attributes
    ----------
    subject, deviations
        Name of the subject, and those of its P deviations.
    inputs
        Tensors by argument of the network: x (N, 1440, C), m, regime, clock, meta (N, M), memory or None.
    groups
        Channels of each group.
    evidence
        Place of the evidence token among the static numbers.
    bounds
        (P,) of the deviations.
    start, true, weight
        (N, P) deviations that the network starts from, their truth, and the weight of each label in the loss.
    start_error, twin_error, moved
        (N, 120, Y) K: outputs at the start less the truth, the twin at the true deviations less the truth, and outputs
        at the start less those of the commissioned twin; NaN where unknown.
    noise_K
        Noise of a reading.
    plant, block
        (N,) number of the plant, and of the block that a bootstrap draws.
    """

    subject: str
    deviations: tuple[str, ...]
    inputs: Mapping[str, Any]
    groups: Mapping[str, slice]
    evidence: slice
    bounds: Array
    start: Array
    true: Array
    weight: Array
    start_error: Array
    twin_error: Array
    moved: Array
    noise_K: float
    plant: NDArray[np.int64]
    block: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.plant)

    def parts(self) -> tuple[str, ...]:
        """Return the parts of the inputs that can be replaced."""
        last = () if self.inputs["memory"] is None else (MEMORY,)
        return (EVERYTHING, ALL_CHANNELS, *self.groups, EVIDENCE, STATICS, *last)

    def replaced(self, part: str, other: NDArray[np.int64]) -> Probe:
        """Return the windows with one part of their inputs from the windows `other` (N,)."""
        strange: dict[str, Any] = {name: None if v is None else v[other] for name, v in self.inputs.items()}
        own: dict[str, Any] = dict(self.inputs)
        if part == EVERYTHING:
            own = strange
        elif part == ALL_CHANNELS:
            own |= {name: strange[name] for name in CHANNELS}
        elif part == MEMORY:
            own["memory"] = strange["memory"]
        elif part in (EVIDENCE, STATICS):
            kept, taken = (own, strange) if part == EVIDENCE else (strange, own)
            meta = kept["meta"].clone()
            meta[:, self.evidence] = taken["meta"][:, self.evidence]
            own["meta"] = meta
        else:
            for name in ("x", "m"):
                mixed = own[name].clone()
                mixed[..., self.groups[part]] = strange[name][..., self.groups[part]]
                own[name] = mixed
        return replace(self, inputs=own)

    def other(self, rng: np.random.Generator) -> NDArray[np.int64]:
        """Return for each window the number of a random window of another plant.

        Raises
        ------
        ValueError
            All windows are of one plant.
        """
        if len(np.unique(self.plant)) < 2:
            raise ValueError(f"the windows of the {self.subject} are of one plant; simulate more")
        return np.array([rng.choice(np.flatnonzero(self.plant != one)) for one in self.plant])


@dataclass(frozen=True)
class Answer:
    """Answer of a network to the windows of a probe: deviations (N, P) and corrections (N, 120, Y), K."""

    theta: Array
    delta: Array


def ask(network: Any, probe: Probe) -> Answer:
    """Return the answer of a network by its symmetric branch, as the gate against blindness asks it."""
    thetas, deltas = [], []
    for at in range(0, len(probe), BATCH):
        given = {n: None if v is None else v[at : at + BATCH] for n, v in probe.inputs.items()}
        p = network(**given)
        thetas.append(p.theta.detach().double().numpy())
        deltas.append(p.delta.detach().double().numpy())
    return Answer(np.concatenate(thetas), np.concatenate(deltas))


def parameter_errors(probe: Probe, theta: Array) -> Array:
    """Return the mean absolute error (N,) of deviations (N, P), in bounds and weighted as labels; NaN without any."""
    there = np.isfinite(probe.true)
    weight = np.where(there, probe.weight, 0.0)
    error = np.abs(np.where(there, theta - np.nan_to_num(probe.true), 0.0)) / probe.bounds
    total = weight.sum(axis=1)
    return np.where(total > 0.0, (error * weight).sum(axis=1) / np.where(total > 0.0, total, 1.0), np.nan)


def output_errors(probe: Probe, delta: Array | float) -> Array:
    """Return the mean absolute error (N,), K, of the outputs at the start with corrections; NaN where unknown."""
    return mean_known(np.abs(probe.start_error + delta))


def mean_known(values: Array) -> Array:
    """Return the mean (N,) over all but the first axis of the known values; NaN without any."""
    flat = values.reshape(len(values), -1)
    count = np.isfinite(flat).sum(axis=1)
    return np.where(count > 0, np.nansum(flat, axis=1) / np.maximum(count, 1), np.nan)


def worse(ours: Array, rival: Array, probe: Probe) -> tuple[float, float, float]:
    """Return mean(ours) / mean(rival) - 1 of errors (N,) with its 95 % interval by a bootstrap of blocks."""
    return interval(ours, rival, probe.block, np.random.default_rng(0))
