"""The error of a twin where no fit saw it, beside the one that its commissioning left: all that tells without a healthy
record how much of a residual is usual."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from twin.discovery.diagnosis import SensorError
from twin.discovery.evidence.finding import Finding
from twin.network import Array, Network

AS_GOOD = 1.1
"""Times the error when commissioned that a re-tuned twin may have and still count as good as then."""
NEVER = 1.5
"""The same of a twin that was never commissioned, in times its thermometers' noise."""
OTHER_LOAD = 6.25
"""Squares beyond its thermometers' noise that a re-tuned twin may leave in health, in those when commissioned: a lumped
twin leaves more where the rig moves more (24 healthy records of the virtual rig under other loads: up to 4.2)."""


def as_commissioned(network: Network, errors: Mapping[str, SensorError]) -> bool:
    """Whether the re-tuned twin is as good, where no fit saw it, as the twin file says of its commissioning.

    Of a twin that was never commissioned the thermometers' noise is asked for.
    """
    known = network.revision.error_after_K
    times = AS_GOOD if known else NEVER
    return bool(errors) and all(e.before <= times * max(known.get(name, 0.0), e.noise) for name, e in errors.items())


def as_under_another_load(network: Network, errors: Mapping[str, SensorError]) -> bool:
    """Whether the re-tuned twin leaves no more, where no fit saw it, than one as good as the twin file says may leave
    of a rig that moves more."""
    known = network.revision.error_after_K
    beyond = sum(max((e.before / e.noise) ** 2 - 1.0, 0.0) for e in errors.values())
    then = sum(max((known.get(name, 0.0) / e.noise) ** 2 - 1.0, 0.0) for name, e in errors.items())
    return then > 0.0 and beyond <= OTHER_LOAD * then


def as_healthy_elsewhere(errors: Mapping[str, SensorError], off: Array, split: int) -> bool:
    """Return whether a twin is off, in every part of a record, by no more than in health under another load.

    Args:
        errors: of each sensor, with what is usual in health. off: (n, m) K, measured minus the twin as it was, of the
            same sensors. split: row from which `errors` are; every part is as long as what follows it.
    """
    length = len(off) - split
    squares = np.where(np.isfinite(off), off, 0.0) ** 2
    sums = np.vstack([np.zeros(off.shape[1]), squares.cumsum(axis=0)])
    parts = (sums[length:] - sums[:-length]) / length
    noise, usual = np.array([(e.noise, max(e.usual, e.noise)) for e in errors.values()]).T
    beyond = np.maximum(parts / noise**2 - 1.0, 0.0).sum(axis=1).max()
    then = float(((usual / noise) ** 2 - 1.0).sum())
    return then > 0.0 and float(beyond) <= OTHER_LOAD * then


def nothing(finding: Finding) -> Finding:
    """The finding without what was found."""
    return replace(finding, entries=(), fit=None, ranked=(), folds=(), ladder=finding.ladder[:1])


def retuned_alone(off: Mapping[str, SensorError]) -> dict[str, SensorError]:
    """Errors on what no fit saw, with nothing added to the re-tuned twin."""
    return {name: replace(e, after=e.before, means=(*e.means[:2], e.means[1])) for name, e in off.items()}
