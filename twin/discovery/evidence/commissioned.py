"""Usual error of a twin without a healthy record: that of its commissioning, for comparison with held-out errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from twin.discovery.diagnosis import SensorError
from twin.discovery.evidence.finding import Finding
from twin.network import Array, Network

AS_GOOD = 1.1
"""Ratio of a re-tuned twin's held-out error to that when commissioned, up to which it counts as equally good."""
NEVER = 1.5
"""The same for a twin that was never commissioned, relative to its thermometers' noise."""
OTHER_LOAD = 6.25
"""Ratio of the squares beyond noise that a re-tuned twin may leave in health to those when commissioned. A lumped twin
leaves more where the rig moves more (24 healthy records of the virtual rig under other loads: up to 4.2)."""

ORDER = 10.0
"""Ratio of a held-out error to noise, and to the error in health, from which no load makes it that of a healthy rig. A
judgement: four times what `OTHER_LOAD` allows a healthy rig under another load, 2.5."""


def as_commissioned(network: Network, errors: Mapping[str, SensorError]) -> bool:
    """Return True if the re-tuned twin's held-out error is no larger than that of its commissioning in the twin file.

    For a twin that was never commissioned the limit is the thermometers' noise.
    """
    known = network.revision.error_after_K
    times = AS_GOOD if known else NEVER
    return bool(errors) and all(e.before <= times * max(known.get(name, 0.0), e.noise) for name, e in errors.items())


def as_under_another_load(network: Network, errors: Mapping[str, SensorError]) -> bool:
    """Return True if the re-tuned twin's held-out error is usual for a rig that moves more than when commissioned."""
    known = network.revision.error_after_K
    beyond = sum(max((e.before / e.noise) ** 2 - 1.0, 0.0) for e in errors.values())
    then = sum(max((known.get(name, 0.0) / e.noise) ** 2 - 1.0, 0.0) for name, e in errors.items())
    return then > 0.0 and beyond <= OTHER_LOAD * then


def explains_too_little(network: Network, errors: Mapping[str, SensorError], measured: Array) -> bool:
    """Return True if a re-tuned twin is off by an order more than in health, or by no less than a constant is.

    Args:
        errors: over the held-out segment. measured: (n, m) degC, the readings of the whole record. A constant is the
            mean of a sensor; it counts where most sensors are predicted no better than by theirs.
    """
    known = (network.revision.error_after_K, network.revision.error_fitted_K)
    usual = {name: max(e.noise, e.usual, *(errors.get(name, 0.0) for errors in known)) for name, e in errors.items()}
    if any(e.before > ORDER * usual[name] for name, e in errors.items()):
        return True
    constant = 0
    for name, e in errors.items():
        read = measured[:, network.sensor_names.index(name)]
        moved = float(np.nanstd(read)) if np.isfinite(read).any() else np.inf
        constant += e.before >= max(moved, ORDER * e.noise)
    return constant > len(errors) / 2


def nothing(finding: Finding) -> Finding:
    """Return the finding without its effects."""
    return replace(finding, entries=(), fit=None, ranked=(), folds=(), ladder=finding.ladder[:1])


def retuned_alone(off: Mapping[str, SensorError]) -> dict[str, SensorError]:
    """Return the held-out errors of the re-tuned twin without effects."""
    return {name: replace(e, after=e.before, means=(*e.means[:2], e.means[1])) for name, e in off.items()}
