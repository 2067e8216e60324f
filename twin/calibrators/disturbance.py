"""Localisation of a disturbance: the constant unknown power, in one volume, that best explains a window's residual.

The residual of the live twin's prediction is compared with every volume's linear response to a constant heat input.
The input begins with the window or with one of its quarters. Initial state and tunables are projected out with
their plausible drift since the last window. The volume with the largest gain is named if that one number explains
nearly all of the mismatch. A scalar cost hides the place (in scenario 2 of Energies 2026, 19, 2452 the tank changes and
the largest error shows at the heater); the pattern over all sensors does not.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from twin.calibrators.base import Calibration, Window
from twin.discovery import disturbance_statement
from twin.elements import Parameter
from twin.elements.heat_source import HeatSource
from twin.kernel import Kernel, mask_measurements
from twin.network import Array, Network, TwinFileError
from twin.quantiles import NORMAL90

LEAST_MISFIT = 4.0
"""Reduced chi-square of the live twin below which no place is sought."""
LEAST_GAIN = 0.25
"""Gain in reduced chi-square that a disturbance must bring to be named."""
LEAST_SHARE = 0.9
"""Share of the mismatch beyond noise that the power and the initial state must explain for a name."""
MARGIN = 2.0
"""Factor by which the runner-up must leave more unexplained."""
ONSETS = 4
"""Number of candidate onsets: the beginning of each quarter of the window."""
STATE_SD = 0.05
"""Standard deviation of the state with which the live twin entered the window, K."""
RESPONSE_ERROR = 0.1
"""Relative standard error assumed for a lumped volume's response to heat."""
_PROBE_W = 10.0
_STATE_STEP = 1e-2
"""Steps of the lane differences: of a power, W, and of the state, K."""


@dataclass(frozen=True)
class DisturbanceLocation:
    """Explanation of one window by unknown powers.

    Attributes
    ----------
    disturbed
        The node, or None where no single power explains the mismatch.
    power_W, interval90_W, since_s
        The best node's power and onset.
    explains
        Node -> share of the mismatch beyond noise that a power there explains, at most 1.
    """

    disturbed: str | None = None
    power_W: float | None = None
    interval90_W: tuple[float, float] | None = None
    since_s: float | None = None
    explains: Mapping[str, float] = field(default_factory=dict)

    def enter(self, calibration: Calibration) -> Calibration:
        """Return the calibration of the same window with these entries, and a flag if there is a place."""
        flags = calibration.flags
        if self.disturbed is not None and self.power_W is not None:
            flags += (disturbance_statement(self.disturbed, self.power_W, "W", self.interval90_W),)
        return replace(
            calibration,
            flags=flags,
            disturbed=self.disturbed,
            disturbed_W=self.power_W,
            disturbed_interval90_W=self.interval90_W,
            disturbed_since_s=self.since_s,
            explains=self.explains,
        )


class DisturbanceLocaliser:
    """Search for the place of an unknown power in a mismatched window."""

    def __init__(self, network: Network) -> None:
        self.network = network
        self._probed, self._powers = with_power_probes(network)
        self._kernel = Kernel(self._probed, self._powers)
        # Compiled now: a live twin that has just been surprised should not wait for a compiler.
        here = np.zeros(1), network.nominal_inputs[None, :].copy()
        self._kernel.trace(self._probed.values, network.initial_state(np.full(len(network.instruments), np.nan)), *here)

    def locate(self, window: Window) -> DisturbanceLocation:
        """Return the place, where the live twin's mismatch over the window is significant."""
        y, weight = mask_measurements(window.measured, self.network.sigma)
        count = float((weight > 0.0).sum())
        residual = (y - window.live) * weight
        total = float((residual**2).sum())
        if count == 0.0 or total < LEAST_MISFIT * count or not np.isfinite(total):
            return DisturbanceLocation()
        response, edges = self._responses(window)
        columns = (response * weight).reshape(response.shape[0], -1)
        free = columns.shape[0] - len(self._powers) * len(edges)
        nuisance, probes = columns[:free], columns[free:]
        normal = nuisance @ nuisance.T + np.eye(free) * STATE_SD**-2
        r = residual.ravel()
        cross = probes @ nuisance.T
        solved = np.linalg.solve(normal, np.column_stack([cross.T, nuisance @ r]))
        information = np.maximum((probes**2).sum(axis=1) - (cross * solved[:, :-1].T).sum(axis=1), 1e-12)
        pull = probes @ r - cross @ solved[:, -1]
        before = total - float((nuisance @ r) @ solved[:, -1])
        gain = (pull**2 / information).reshape(len(edges), -1)
        return self._judge(gain, pull / information, information, (total, before), count, edges)

    def _judge(
        self,
        gain: Array,
        power: Array,
        information: Array,
        misfit: tuple[float, float],
        count: float,
        edges: list[float],
    ) -> DisturbanceLocation:
        """Return the location from the gains (onsets, nodes) and, flattened alike, the powers (W) and their information
        (1/W^2).

        `misfit` holds the squares of the live twin, and those left after the initial state has explained its part.
        """
        total, before = misfit
        left = np.maximum(before - gain.max(axis=0) - count, 0.0)
        explains = dict(zip(self.network.nodes, (1.0 - left / (total - count)).tolist(), strict=True))
        best = int(np.argmax(gain))
        onset, node = np.unravel_index(best, gain.shape)
        others = np.delete(left, node)
        floor = 0.5 * LEAST_GAIN * count
        clear = not others.size or others.min() > MARGIN * max(left[node], floor)
        if gain.flat[best] < LEAST_GAIN * count or left[node] > (1.0 - LEAST_SHARE) * (total - count) or not clear:
            return DisturbanceLocation(explains=explains)
        # The unexplained remainder has a pattern, and may have biased the power as much as it resembles it.
        share = left[node] / gain.flat[best] + RESPONSE_ERROR**2
        watts = float(power[best])
        reach = float(NORMAL90 * np.sqrt(1.0 / information[best] + share * watts**2))
        name = self.network.nodes[int(node)]
        return DisturbanceLocation(name, watts, (watts - reach, watts + reach), edges[int(onset)], explains)

    def _responses(self, window: Window) -> tuple[Array, list[float]]:
        """Return responses (states + onsets x nodes, n, m) to 1 K and 1 W, and the onsets in s."""
        k = nodes = len(self._powers)
        edges = np.unique(np.searchsorted(window.time, np.linspace(window.time[0], window.time[-1], ONSETS + 1)[:-1]))
        rows = np.tile(np.concatenate([window.parameters, np.zeros(nodes)]), (1 + k + edges.size * nodes, 1))
        state = np.tile(window.state, (len(rows), 1))
        state[1 : 1 + k, :k] += np.diag(np.full(k, _STATE_STEP))
        power = self._probed.index(self._powers)
        traced = np.empty((len(rows), *window.measured.shape))
        bounds = [*edges.tolist(), window.time.size - 1]
        for step, (a, b) in enumerate(zip(bounds[:-1], bounds[1:], strict=True)):
            at = 1 + k + step * nodes
            rows[at : at + nodes, power] = np.diag(np.full(nodes, _PROBE_W))
            part, state = self._kernel.trace(rows, state, window.time[a : b + 1], window.inputs[a : b + 1])
            traced[:, a : b + 1] = part
        scale = np.concatenate([np.full(k, _STATE_STEP), np.full(edges.size * nodes, _PROBE_W)])
        return (traced[1:] - traced[0]) / scale[:, None, None], window.time[edges].tolist()


def with_power_probes(network: Network) -> tuple[Network, tuple[str, ...]]:
    """Return the network with a constant heat source of 0 W in every node, and the ids of their powers, node by
    node.
    """
    elements, parameters, ids = list(network.elements), dict(network.parameters), []
    taken = {e.name for e in elements}
    for node in network.nodes:
        element = HeatSource(f"unknown_power_in_{node}", node)
        if element.name in taken:
            raise TwinFileError(f"{element.name!r} is a name that localisation needs; rename the element")
        spec = element.parameters[0]
        name = f"{element.name}.{spec.name}"
        elements.append(element)
        parameters[name] = Parameter(
            name, element.name, spec.name, 0.0, spec.unit, spec.lower, spec.upper, "fixed", "probe of a mismatch"
        )
        ids.append(name)
    return replace(network, elements=tuple(elements), parameters=MappingProxyType(parameters), digest=""), tuple(ids)
