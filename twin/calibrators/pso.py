"""Particle swarm over the tunables, window by window.

`PAPER` is Table 2 of Energies 2026, 19, 2452 to the letter. `TUNED` adds the two remedies that its authors name
(perturbation scaled with the previous error, restart near the best), estimates the initial state instead of
carrying a wrong one over, and searches each parameter in its own range. Points that the paper leaves open are settled
in docs/decisions/0003-swarm-window-logic.md. A whole swarm is one call of the kernel.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.calibrators.base import Calibration, Window, from_json, to_json
from twin.calibrators.identifiability import WindowInformation, window_information
from twin.calibrators.posterior import Descent, ParameterBelief, fit_window, window_data
from twin.calibrators.results import WindowFit, fitted_calibration
from twin.gauss_newton import FitData, FitProblem, Scaling, fit_initial_state
from twin.kernel import Kernel, mask_measurements
from twin.network import Array, Network, TunableSet, TwinFileError


@dataclass(frozen=True)
class SwarmSettings:
    """Hyper-parameters of a swarm. Lengths are in normalised units, or shares of a range where `own_range`.

    Attributes
    ----------
    particles, iterations, inertia, damping, cognitive, social
        As in Table 2.
    velocity
        Limit per component.
    perturbation
        Half width of the uniform perturbation of every position when a window changes.
    own_range
        Positions are shares of each parameter's own range, in its logarithm where that spans a decade; else the file's
        normalised units in its common bounds.
    scaled
        The perturbation shrinks with the error of the previous window's parameters on this window, and the swarm
        restarts that near the best position.
    run_up
        Recovery and stall windows are simulated from the start of the window before.
    realign
        Recovery and stall windows estimate the initial state instead.
    per_component
        Random factors per component rather than per particle.
    polish
        Parameters that are not identifiable in the window are held, and the best position is the start of a few
        Gauss-Newton steps.
    """

    particles: int = 5
    iterations: int = 5
    inertia: float = 1.0
    damping: float = 0.99
    cognitive: float = 0.5
    social: float = 0.7
    velocity: float = 1.6
    perturbation: float = 1.0
    own_range: bool = False
    scaled: bool = False
    run_up: bool = True
    realign: bool = False
    per_component: bool = False
    polish: bool = False


PAPER = SwarmSettings()
TUNED = SwarmSettings(
    particles=32,
    iterations=20,
    inertia=0.73,
    damping=1.0,
    cognitive=1.49,
    social=1.49,
    velocity=0.2,
    perturbation=0.1,
    own_range=True,
    scaled=True,
    realign=True,
    per_component=True,
    polish=True,
)
PRESETS: Mapping[str, SwarmSettings] = {"paper": PAPER, "tuned": TUNED}
POLISH = 15
"""Largest number of linearisations in the polish."""
LEAST_PERTURBATION = 0.02
"""Share of the full perturbation that remains when the live twin's error is noise alone."""


class ParticleSwarm:
    """Swarm calibrator; satisfies `Calibrator`.

    Parameters
    ----------
    network
        The commissioned twin; its values are the first global best.
    tunables
        Name of a set of the twin, or ids. Where `settings` do not use each parameter's own range it must be a set with
        scales and bounds.
    settings
        A preset's name or `SwarmSettings`.
    seed
        Seed of the generator.
    """

    name = "pso"

    def __init__(
        self,
        network: Network,
        tunables: str | tuple[str, ...] = "paper4",
        settings: str | SwarmSettings = "tuned",
        seed: int = 0,
    ) -> None:
        if isinstance(settings, str):
            if settings not in PRESETS:
                raise TwinFileError(f"no swarm preset {settings!r}; there are: {', '.join(PRESETS)}")
            settings = PRESETS[settings]
        self.network, self.settings = network, settings
        self.ids = network.tunables(tunables)
        self.kernel = Kernel(network, self.ids)
        self._scaling = Scaling.of(network, self.ids)
        self._parameters = ParameterBelief(network, self._scaling)
        self._space = _OwnRange(network, self.ids) if settings.own_range else _Normalised(network, tunables)
        self._rng = np.random.default_rng(seed)
        self.last: tuple[Array, Array, Array] = (np.zeros(0), np.zeros((0, 0)), np.zeros(0))
        self._last_number = -2
        self._best = self._space.positions(network.values[network.index(self.ids)])
        self._positions: Array | None = None
        self._velocities = np.zeros((0, 0))

    def calibrate(self, window: Window) -> Calibration:
        """Run the swarm on a window."""
        settings, space = self.settings, self._space
        cost, info = _Cost(self, window), self._information(window)
        self._start_window(window)
        assert self._positions is not None
        positions, velocities = self._positions, self._velocities
        if settings.polish:
            positions = np.where(info.unidentifiable, self._best, positions)
        everyone = cost(np.vstack([self._best, positions]))
        best, best_cost = self._best, float(everyone[0])
        own, own_cost = positions.copy(), everyone[1:]
        inertia = settings.inertia
        for step in range(settings.iterations):
            leader = int(np.argmin(own_cost))
            if own_cost[leader] < best_cost:
                best, best_cost = own[leader].copy(), float(own_cost[leader])
            if cost.realigned and step in (settings.iterations // 4, settings.iterations // 2):
                # The first estimate of the state used parameters that are now known to be wrong.
                cost.realign(cost.full(best[None])[0])
                everyone = cost(np.vstack([best, own]))
                best_cost, own_cost = float(everyone[0]), everyone[1:]
            shape = positions.shape if settings.per_component else (len(positions), 1)
            r1, r2 = self._rng.random(shape), self._rng.random(shape)
            velocities = (
                inertia * velocities
                + settings.cognitive * r1 * (own - positions)
                + settings.social * r2 * (best - positions)
            )
            velocities = np.clip(velocities, -settings.velocity, settings.velocity)
            if settings.polish:
                velocities = np.where(info.unidentifiable, 0.0, velocities)
            positions = np.clip(positions + velocities, space.lower, space.upper)
            inertia *= settings.damping
            costs = cost(positions)
            better = costs < own_cost
            own = np.where(better[:, None], positions, own)
            own_cost = np.where(better, costs, own_cost)
        leader = int(np.argmin(own_cost))
        if own_cost[leader] < best_cost:
            best, best_cost = own[leader].copy(), float(own_cost[leader])
        self.last = (window.time, window.inputs, cost.start(best))
        self._last_number = window.number
        self._best, self._positions, self._velocities = best, positions, velocities
        return self._conclude(window, cost, best, best_cost, info)

    def _conclude(
        self, window: Window, cost: _Cost, best: Array, best_cost: float, info: WindowInformation
    ) -> Calibration:
        """Return the calibration at the swarm's best position; a polished swarm descends from there first."""
        values, start = self._space.values(best), cost.start(best)
        if self.settings.polish:
            belief, state = self._parameters, start[: len(self.network.nodes)]
            descent = Descent(np.concatenate([self._scaling.to_z(values), state]), POLISH)
            weight, noise = belief.weight(window)
            given = (self.kernel, self._scaling, weight, window, belief.before(window))
            done = belief.take(fit_window(*given, info=info, noise=noise, descent=descent))
            if np.isfinite(done.fit.cost):
                self._best = self._space.positions(done.fit.values)
                self.last = (window.time, window.inputs, done.fit.state)
                evaluations = cost.evaluations + done.fit.evaluations * (1 + done.fit.v.size)
                result = WindowFit.of(done.fit, float(np.sqrt(done.chi)), evaluations)
                return fitted_calibration(self.network, window, self.ids, result, done.report(self._scaling))
        readings, end = self.kernel.trace(cost.full(best[None]), start, window.time, window.inputs)
        result = WindowFit(values, start, readings[0], end[0], best_cost, cost.evaluations + 1)
        return fitted_calibration(self.network, window, self.ids, result, info.report(self._scaling, values))

    def _information(self, window: Window) -> WindowInformation:
        """Return the window's information, at the live twin's parameters."""
        scaling, data = self._scaling, window_data(window, self.network.sigma)
        problem = FitProblem(self.kernel, scaling, window.parameters, data, window.state)
        here = np.concatenate([scaling.to_z(window.parameters[scaling.index]), window.state[: len(self.network.nodes)]])
        return window_information(problem.linearise(here).jtj, scaling.prior_sd())

    def _start_window(self, window: Window) -> None:
        """Set positions and velocities at the start of a window."""
        settings, space, q = self.settings, self._space, len(self.ids)
        if settings.scaled:
            excess = (window.error_K / self.network.rules.large_K) if window.error_K else 0.0
            share = float(np.clip(excess, LEAST_PERTURBATION, 1.0))
            near = self._rng.uniform(-1.0, 1.0, (settings.particles, q)) * settings.perturbation * share
            self._positions = np.clip(self._best + near, space.lower, space.upper)
            self._velocities = np.zeros((settings.particles, q))
        elif self._positions is None:
            self._positions = self._rng.uniform(space.initial[0], space.initial[1], (settings.particles, q))
            self._velocities = self._rng.uniform(-1.0, 1.0, (settings.particles, q)) * settings.velocity
        else:
            nudge = self._rng.uniform(-1.0, 1.0, (settings.particles, q)) * settings.perturbation
            self._positions = np.clip(self._positions + nudge, space.lower, space.upper)

    def positions(self, values: Array) -> Array:
        """Return positions (..., q) of physical values (..., q)."""
        return self._space.positions(values)

    def follows(self, window: Window) -> bool:
        """Return True if `last` (time, inputs, state at its first sample) is the window just before this one."""
        return self._last_number == window.number - 1

    def state(self) -> dict[str, Any]:
        """Return everything needed to continue, as plain data."""
        return {
            "rng": self._rng.bit_generator.state,
            "belief": [self._parameters.mean.tolist(), self._parameters.covariance.tolist()],
            "best": self._best.tolist(),
            "positions": None if self._positions is None else self._positions.tolist(),
            "velocities": self._velocities.tolist(),
            "last": [self._last_number, *(to_json(a) for a in self.last)],
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from a saved `state`; without a belief, as in older runs, it begins with the first one."""
        self._rng.bit_generator.state = state["rng"]
        if "belief" in state:
            mean, covariance = state["belief"]
            self._parameters.mean = np.array(mean, dtype=np.float64)
            self._parameters.covariance = np.array(covariance, dtype=np.float64)
        self._best = np.array(state["best"], dtype=np.float64)
        positions = state["positions"]
        self._positions = None if positions is None else np.array(positions, dtype=np.float64)
        self._velocities = np.array(state["velocities"], dtype=np.float64)
        self._last_number, *last = state["last"]
        time, inputs, start = (from_json(a) for a in last)
        self.last = (time, inputs, start)


class _Cost:
    """Cost of positions (P, q) -> (P,) on one window, in units of the calibrated threshold.

    Where the beginning of the window counts, the simulation starts with the window before it (the run-up), so
    that the state at the beginning follows from the parameters; or, if the swarm re-aligns, from an estimate.
    """

    def __init__(self, swarm: ParticleSwarm, window: Window) -> None:
        self.swarm, self.window = swarm, window
        self.threshold = swarm.network.rules.calibrated_K
        self.index = swarm.network.index(swarm.ids)
        self.evaluations = 0
        self.state = window.state
        self.time, self.inputs = window.time, window.inputs
        self.y, self.weight = mask_measurements(window.measured)
        self.before = 0
        mismatched = window.kind in ("recovery", "stall")
        self.realigned = swarm.settings.realign and mismatched
        if self.realigned:
            self.realign(window.parameters)
        elif swarm.settings.run_up and mismatched and swarm.follows(window):
            time, inputs, self.state = swarm.last
            self.before = len(time)
            self.time = np.concatenate([time, window.time])
            self.inputs = np.concatenate([inputs, window.inputs])
            nothing = np.zeros((self.before, self.y.shape[1]))
            self.y = np.vstack([nothing, self.y])
            self.weight = np.vstack([nothing, self.weight])

    def __call__(self, positions: Array) -> Array:
        full = self.full(positions)
        self.evaluations += len(positions)
        kind = "calibrated" if self.realigned else self.window.kind
        total = np.zeros(len(positions))
        if kind in ("recovery", "stall"):
            total += self._mean_square(full, self.before + self.window.first) / self.threshold**2
        if kind != "recovery":
            total += np.sqrt(self._mean_square(full, len(self.time))) / self.threshold
        return np.where(np.isfinite(total), total, 1e300)

    def realign(self, parameters: Array) -> None:
        """Estimate the state at the first sample from the beginning of the window, at `parameters` (p,)."""
        n = self.window.first
        y, weight = mask_measurements(self.window.measured[:n], self.swarm.network.sigma)
        data = FitData(self.window.time[:n], self.window.inputs[:n], y, weight)
        sd = max(self.window.initial_mismatch_K, self.threshold)
        self.state = fit_initial_state(self.swarm.kernel, parameters, self.window.state, data, sd)

    def full(self, positions: Array) -> Array:
        """Return full parameter vectors (P, p) of positions (P, q)."""
        full = np.tile(self.window.parameters, (len(positions), 1))
        full[:, self.index] = self.swarm._space.values(positions)
        return full

    def start(self, position: Array) -> Array:
        """Return the state (k,) at the first sample of the window, at one position (q,)."""
        if not self.before:
            return self.state
        n = self.before + 1
        return self.swarm.kernel.trace(self.full(position[None]), self.state, self.time[:n], self.inputs[:n])[1][0]

    def _mean_square(self, full: Array, n: int) -> Array:
        sse, _ = self.swarm.kernel.cost(full, self.state, self.time[:n], self.inputs[:n], self.y[:n], self.weight[:n])
        mean: Array = sse.sum(axis=1) / max(float(self.weight[:n].sum()), 1.0)
        return mean


class _Normalised:
    """Search space in the file's normalised units: physical = scale * position, held inside the parameter's bounds."""

    def __init__(self, network: Network, tunables: str | tuple[str, ...]) -> None:
        if not isinstance(tunables, str):
            raise TwinFileError("this swarm needs the scales and bounds of a set of the twin; name one")
        chosen: TunableSet = network.sets[tunables]
        if chosen.bounds is None:
            raise TwinFileError(f"set {tunables!r} of twin {network.name!r} has no bounds; give them to swarm it")
        q = len(chosen.members)
        self.scale = np.array(chosen.scale)
        self.physical = network.bounds(chosen.members)
        self.lower, self.upper = np.full(q, chosen.bounds[0]), np.full(q, chosen.bounds[1])
        self.initial = np.array(chosen.initial).T

    def values(self, positions: Array) -> Array:
        """Return physical values of positions."""
        return np.clip(self.scale * positions, *self.physical)

    def positions(self, values: Array) -> Array:
        """Return positions of physical values."""
        return np.clip(values / self.scale, self.lower, self.upper)


class _OwnRange:
    """Search space in shares of each parameter's own range, in its logarithm where the bounds span a decade."""

    def __init__(self, network: Network, ids: tuple[str, ...]) -> None:
        self.scaling = Scaling.of(network, ids)
        self.low = self.scaling.to_z(self.scaling.lower)
        self.width = self.scaling.to_z(self.scaling.upper) - self.low
        q = len(ids)
        self.lower, self.upper = np.zeros(q), np.ones(q)
        self.initial = np.array([self.lower, self.upper])

    def values(self, positions: Array) -> Array:
        """Return physical values of positions."""
        return self.scaling.to_values(self.low + self.width * positions)

    def positions(self, values: Array) -> Array:
        """Return positions of physical values."""
        return np.clip((self.scaling.to_z(values) - self.low) / self.width, 0.0, 1.0)
