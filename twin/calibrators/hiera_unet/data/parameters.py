"""Parameters as deviations from a commissioned twin: theta = 0 is the twin as commissioned, |theta| <= `REACH`.

    factor   value = nominal * exp(theta)                                  a conductance, a share, a gain loss     value
    = nominal + scale * theta             theta >= 0         a loss that may be nearly zero when
             value = nominal * exp(scale * theta / nominal)  otherwise      commissioned; never negative, smooth at 0
    sum      value = nominal + scale * theta                               a power that is zero in a healthy rig

Law and scale follow from the specification alone, so that theta has the same meaning on every rig of a structure.
Scales are shares of the rated power.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.gauss_newton import Scaling
from twin.kernel import Kernel
from twin.network import Array, Network

REACH = 1.1
"""Largest absolute deviation: a factor of three for a factor."""
FACTOR, LOSS, SUM = 0, 1, 2
LAWS = ("factor", "loss", "sum")
RATED_W = 700.0
"""Rated power, W, of a twin without a power among its inputs."""
POWER_SHARE = 0.5
"""Unit of a power, as a share of the rated one."""
LOSS_K = 50.0
"""Temperature difference, K, by which the rated power is divided for the unit of a loss, W/K."""
PRIOR_SD = (0.4, 0.25, 0.25)
"""Prior standard deviation of theta by law."""


@dataclass(frozen=True)
class Deviations:
    """Deviations of P parameters of a twin.

    Attributes:
        ids: of the parameters. index (P,): their places in a full vector (p,). law (P,): FACTOR, LOSS or SUM. scale
        (P,): in the parameter's unit, 1 for a factor. lower, upper (P,): physical bounds.
    """

    ids: tuple[str, ...]
    index: np.ndarray
    law: np.ndarray
    scale: Array
    lower: Array
    upper: Array

    @classmethod
    def of(cls, network: Network, tunables: str | tuple[str, ...] = "nine") -> Deviations:
        """Return the deviations of a named set or of ids.

        Raises:
            TwinFileError: no such set or parameter.
        """
        ids = network.tunables(tunables)
        low, high = network.bounds(ids)
        rated = rated_power(network)
        kinds = {e.name: e.kind for e in network.elements}
        law, scale = np.zeros(len(ids), dtype=np.int8), np.ones(len(ids))
        for k, name in enumerate(ids):
            p = network.parameters[name]
            if p.unit == "W" or low[k] < 0.0:
                law[k] = SUM
                scale[k] = POWER_SHARE * rated if p.unit == "W" else 0.25 * (high[k] - low[k])
            elif p.unit == "W/K" and kinds[p.element] == "ambient_loss":
                law[k], scale[k] = LOSS, rated / LOSS_K
        return cls(ids, network.index(ids), law, scale, low, high)

    def __len__(self) -> int:
        return len(self.ids)

    def values(self, theta: Array, nominal: Array) -> Array:
        """Return physical values (..., P), within their bounds, of deviations (..., P) from full vectors `nominal`
        (..., p).
        """
        base = np.asarray(nominal, dtype=np.float64)[..., self.index]
        t = np.asarray(theta, dtype=np.float64)
        floor = np.maximum(base, 1e-6 * self.scale)
        factor = base * np.exp(np.where(self.law == FACTOR, t, 0.0))
        below = floor * np.exp(np.where((self.law == LOSS) & (t < 0.0), self.scale * t / floor, 0.0))
        above = base + self.scale * t
        values = np.where(self.law == FACTOR, factor, np.where((self.law == LOSS) & (t < 0.0), below, above))
        clipped: Array = np.clip(values, self.lower, self.upper)
        return clipped

    def theta(self, values: Array, nominal: Array) -> Array:
        """Return the deviations (..., P) of physical values (..., P); the inverse of `values`."""
        base = np.asarray(nominal, dtype=np.float64)[..., self.index]
        v = np.asarray(values, dtype=np.float64)
        floor = np.maximum(base, 1e-6 * self.scale)
        log = np.log(np.maximum(v, 1e-300) / floor)
        below = floor / self.scale * log
        found: Array = np.where(
            self.law == FACTOR, log, np.where((self.law == LOSS) & (v < base), below, (v - base) / self.scale)
        )
        return found

    def full(self, theta: Array, nominal: Array) -> Array:
        """Return full vectors (..., p) with the deviations entered."""
        values = self.values(theta, nominal)
        shape = np.broadcast_shapes(values.shape[:-1], np.shape(nominal)[:-1])
        full = np.array(np.broadcast_to(nominal, (*shape, np.shape(nominal)[-1])), dtype=np.float64)
        full[..., self.index] = values
        return full

    @property
    def prior_sd(self) -> Array:
        """Return the prior standard deviation (P,) of theta."""
        return np.array(PRIOR_SD)[self.law]

    def scaling(self, nominal: Array) -> ThetaScaling:
        """Return the scaling for `twin.gauss_newton` whose variables are theta."""
        low, high = (self.values(np.full(len(self), s * REACH), nominal) for s in (-1.0, 1.0))
        zero, one = np.zeros(len(self)), np.ones(len(self))
        return ThetaScaling(self.ids, self.index, self.law == FACTOR, zero, one, low, high, self, nominal)


@dataclass(frozen=True)
class ThetaScaling(Scaling):
    """Scaling by which the optimiser's variables are deviations from `nominal` (p,)."""

    of_theta: Deviations
    nominal: Array

    def to_z(self, values: Array) -> Array:
        return self.of_theta.theta(values, self.nominal)

    def to_values(self, z: Array) -> Array:
        clipped: Array = np.clip(self.of_theta.values(z, self.nominal), self.lower, self.upper)
        return clipped

    def slope(self, values: Array) -> Array:
        step = 1e-6
        z = self.to_z(values)
        return (self.of_theta.values(z + step, self.nominal) - self.of_theta.values(z - step, self.nominal)) / (
            2.0 * step
        )

    def prior_sd(self) -> Array:
        return self.of_theta.prior_sd


def rated_power(network: Network) -> float:
    """Return the sum of the nominal powers among the inputs, W; RATED_W if there is none."""
    return sum(s.nominal for c, s in network.inputs.items() if c.endswith("_W") and s.nominal > 0.0) or RATED_W


def kernel_of(network: Network, ids: tuple[str, ...]) -> Kernel:
    """Return one kernel for all rigs of the network's structure, independent of their commissioned parameters."""
    commissioned = network.tunables("commission") if "commission" in network.sets else ()
    return Kernel(network, (*ids, *commissioned))
