"""Shares of an answer: movement with replaced inputs, and corrections beside the start that they are added to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.bench.audit.probe import Probe, ask, mean_known, output_errors, parameter_errors, worse
from twin import Array


@dataclass(frozen=True)
class Replacement:
    """Effect of one part of the inputs from another plant on one member.

    Attributes
    ----------
    part
        Replaced part of the inputs.
    theta
        Mean absolute movement of the deviations, in bounds.
    delta_K
        Mean absolute movement of the corrections, K.
    parameters_worse, outputs_worse
        Relative increase of the errors with its 95 % interval.
    """

    part: str
    theta: float
    delta_K: float
    parameters_worse: tuple[float, float, float]
    outputs_worse: tuple[float, float, float]


@dataclass(frozen=True)
class Correction:
    """Corrections of one member beside the start.

    Attributes
    ----------
    theta_start, theta
        Mean absolute deviation of the start and mean absolute correction of it, in bounds.
    start_K, delta_K
        Mean absolute movement of the outputs by the start, and by the correction, K.
    parameters, outputs
        Relative change of the errors by the correction with its 95 % interval.
    """

    theta_start: float
    theta: float
    start_K: float
    delta_K: float
    parameters: tuple[float, float, float]
    outputs: tuple[float, float, float]


def replacements(network: Any, probe: Probe, seed: int) -> list[Replacement]:
    """Return the effect of each part of the inputs when it is that of another plant."""
    other = probe.other(np.random.default_rng(seed))
    own = ask(network, probe)
    errors = parameter_errors(probe, own.theta), output_errors(probe, own.delta)
    found = []
    for part in probe.parts():
        strange = ask(network, probe.replaced(part, other))
        found.append(
            Replacement(
                part,
                float(np.mean(np.abs(strange.theta - own.theta) / probe.bounds)),
                float(np.mean(np.abs(strange.delta - own.delta))),
                worse(parameter_errors(probe, strange.theta), errors[0], probe),
                worse(output_errors(probe, strange.delta), errors[1], probe),
            )
        )
    return found


def correction(network: Any, probe: Probe) -> Correction:
    """Return the corrections of a network beside the start, and the change of the errors by them."""
    own = ask(network, probe)
    return Correction(
        float(np.mean(np.abs(probe.start) / probe.bounds)),
        float(np.mean(np.abs(own.theta - probe.start) / probe.bounds)),
        float(np.nanmean(np.abs(probe.moved))),
        float(np.mean(np.abs(own.delta))),
        worse(parameter_errors(probe, own.theta), parameter_errors(probe, probe.start), probe),
        worse(output_errors(probe, own.delta), output_errors(probe, 0.0), probe),
    )


def intraclass(values: Array, plant: NDArray[Any]) -> float:
    """Return the intraclass correlation of values (N,) of plants (N,): the share of their variance between plants.

    ICC(1) of Shrout and Fleiss (Psychological Bulletin 86 (1979) 420), for groups of unequal size; 0 at least.
    """
    known = np.isfinite(values)
    values, number = values[known], np.unique(plant[known], return_inverse=True)[1]
    count = np.bincount(number)
    groups, total = len(count), len(values)
    if groups < 2 or total <= groups:
        return float("nan")
    means = np.bincount(number, values) / count
    between = float((count * (means - values.mean()) ** 2).sum() / (groups - 1))
    within = float(((values - means[number]) ** 2).sum() / (total - groups))
    size = (total - (count**2).sum() / total) / (groups - 1)
    return max((between - within) / max(between + (size - 1.0) * within, 1e-30), 0.0)


def between_plants(probe: Probe) -> float:
    """Return the share between plants of the variance of the start's mean errors, the mean over outputs."""
    errors = [mean_known(probe.start_error[..., k]) for k in range(probe.start_error.shape[-1])]
    return float(np.mean([intraclass(one, probe.plant) for one in errors]))


def worst_share(errors: Array, share: float = 0.05) -> float:
    """Return the share of the sum of errors (N,) that the largest `share` of them hold."""
    known = np.sort(errors[np.isfinite(errors)])[::-1]
    return float(known[: max(round(share * len(known)), 1)].sum() / max(known.sum(), 1e-30))
