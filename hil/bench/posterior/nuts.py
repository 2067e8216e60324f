"""Posterior of a window's parameters by the No-U-Turn sampler; the only module that imports numpyro.

All parameters and the initial state are sampled, also those that a calibrator holds. Readings and their derivatives are
those of the twin's kernel, a fortieth of the time of the same by jax. An integration by jax checks the kernel: four
classical Runge-Kutta steps a sample.

Source: Hoffman and Gelman, J. Mach. Learn. Res. 15 (2014) 1593.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
from numpyro import distributions
from numpyro.infer import MCMC, NUTS

from hil.bench.peers.formulas import right_side_of, sensor_rows
from twin import Array, Network
from twin.calibrators import Window
from twin.calibrators.posterior import window_data
from twin.gauss_newton import FitProblem, Scaling
from twin.kernel import Kernel

STEPS = 4
"""Runge-Kutta steps a sample: the fastest volume has a time constant of some seconds, and a sample is 5 s long."""
ACCEPTED, ATTEMPTS = 0.9, 3
"""Share of proposals that the first chain accepts, and chains that are begun for a window before it is given up."""
CONVERGED = 1.05
"""Largest split R-hat of chains that have converged (Vehtari et al., Bayesian Analysis 16 (2021) 667, use 1.01 for
several chains; one of some hundred draws scatters more)."""
OUTSIDE = 0.02
"""Standard deviation in z with which the density falls beyond a parameter's bounds; steep walls make chains diverge."""


@dataclass(frozen=True)
class WindowModel:
    """Statistical model of a window that a calibrator states.

    Attributes
    ----------
    window
        Its samples.
    mean, covariance
        (q + k,) and (q + k, q + k) of the Gaussian prior, in z and K.
    white
        (m,) K, standard deviation of errors that are independent from sample to sample.
    lasting
        (m,) K, standard deviation of errors that are constant over a segment and independent from one to the next.
    segment
        (n,) number of each sample's segment.
    """

    window: Window
    mean: Array
    covariance: Array
    white: Array
    lasting: Array
    segment: np.ndarray


@dataclass(frozen=True)
class Draws:
    """Draws from a posterior.

    Attributes
    ----------
    z
        (d, q) parameters.
    divergent
        Draws at which the sampler diverged.
    r_hat
        Largest split R-hat of all variables.
    attempts
        Chains that were begun; of several, the last one counts.
    kernel_K
        Largest difference of a reading between kernel and jax at the start of the chain, K.
    """

    z: Array
    divergent: int
    r_hat: float
    attempts: int
    kernel_K: float

    @property
    def converged(self) -> bool:
        return self.r_hat <= CONVERGED


class PosteriorSampler:
    """Sampler for windows of one network and one length; compiled with the first window.

    Parameters
    ----------
    network, ids
        The twin, and its q parameters to sample.
    warmup, draws
        Steps of the chain that adapt the sampler, and those that are kept.
    """

    def __init__(self, network: Network, ids: tuple[str, ...], warmup: int, draws: int) -> None:
        jax.config.update("jax_enable_x64", True)
        self._scaling, self._kernel = Scaling.of(network, ids), Kernel(network, ids)
        self._problem: FitProblem | None = None
        self._by_jax = jax.jit(partial(readings_by_jax, network, self._scaling))
        shape = jax.ShapeDtypeStruct
        size, sensors = len(ids) + len(network.nodes), len(network.sensors)

        @jax.custom_jvp
        def readings(v: Any, samples: Any) -> Any:
            n = samples.shape[0]
            return jax.pure_callback(self._traced, shape((n, sensors, 1 + size), np.float64), v)[:, :, 0]

        @readings.defjvp
        def _(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Any, Any]:
            n = primals[1].shape[0]
            found = jax.pure_callback(self._traced, shape((n, sensors, 1 + size), np.float64), primals[0])
            return found[:, :, 0], found[:, :, 1:] @ tangents[0]

        self._density, self._steps = partial(_model, readings, self._scaling), (warmup, draws)
        self._chains: dict[int, MCMC] = {}

    def _chain(self, attempt: int) -> MCMC:
        """Return the chain of an attempt: each adapts twice as long as the one before, and takes smaller steps."""
        if attempt not in self._chains:
            warmup, draws = self._steps
            accepted = 1.0 - (1.0 - ACCEPTED) / 3.0**attempt
            kernel = NUTS(
                self._density, target_accept_prob=accepted, dense_mass=True, forward_mode_differentiation=True
            )
            self._chains[attempt] = MCMC(
                kernel, num_warmup=warmup * 2**attempt, num_samples=draws, progress_bar=False, jit_model_args=True
            )
        return self._chains[attempt]

    def _traced(self, v: Any) -> Array:
        """Return readings and their derivatives (n, m, 1 + q + k) of the window at v (q + k,), by the kernel."""
        assert self._problem is not None
        inside = np.clip(np.asarray(v), self._problem.low, self._problem.high)
        return self._problem.readings_and_derivatives(inside)

    def draw(self, model: WindowModel, start: Array, seed: int) -> Draws:
        """Return draws from the posterior of a window; a chain that does not converge is begun anew.

        Parameters
        ----------
        model
            The window and its statistical model.
        start
            (q + k,) start of the chain in z and degC, near the mode.
        seed
            Seed of the chain.
        """
        w = model.window
        self._problem = FitProblem(self._kernel, self._scaling, w.parameters, window_data(w, model.white), w.state)
        here = self._traced(start)
        precision = np.linalg.inv(model.covariance) + _information(here[:, :, 1:], model)
        # Variables of unit variance near the mode make the steps of the sampler equal in all directions.
        root = np.linalg.inv(np.linalg.cholesky(precision)).T
        data = {
            "start": start,
            "root": root,
            "mean": model.mean,
            "precision": np.linalg.inv(model.covariance),
            "measured": np.nan_to_num(w.measured),
            "read": np.isfinite(w.measured).astype(np.float64),
            "white": model.white,
            "lasting": model.lasting,
            "member": (model.segment[:, None] == np.arange(model.segment[-1] + 1)).astype(np.float64),
        }
        first = {"x": jnp.zeros(start.size)}
        r_hat, divergent, drawn, attempt = np.inf, 0, np.zeros((0, start.size)), 0
        while r_hat > CONVERGED and attempt < ATTEMPTS:
            chain = self._chain(attempt)
            attempt += 1
            chain.run(jax.random.PRNGKey(seed + attempt), data, init_params=first, extra_fields=("diverging",))
            drawn = np.asarray(chain.get_samples()["x"])
            divergent = int(np.asarray(chain.get_extra_fields()["diverging"]).sum())
            r_hat = max(float(numpyro.diagnostics.split_gelman_rubin(column[None])) for column in drawn.T)
        v = start + drawn @ root.T
        q = len(self._scaling.ids)
        by_jax = np.asarray(self._by_jax(start, w.parameters, w.inputs, np.diff(w.time)))
        return Draws(v[:, :q], divergent, r_hat, attempt, float(np.abs(by_jax - here[:, :, 0]).max()))


def _model(readings: Any, scaling: Scaling, data: dict[str, Any]) -> None:
    """State the density of a window in numpyro's terms."""
    size = data["start"].shape[0]
    x = numpyro.sample(
        "x", distributions.ImproperUniform(distributions.constraints.real_vector, (), event_shape=(size,))
    )
    v = data["start"] + data["root"] @ x
    away = v - data["mean"]
    residual = (data["measured"] - readings(v, data["measured"])) * data["read"]
    white, lasting, member = data["white"] ** 2, data["lasting"] ** 2, data["member"]
    count = member.T @ data["read"]
    squares = (residual**2).sum(axis=0) / white
    # The constant error of a segment is integrated out: the inverse of white I + lasting 11' (Sherman and Morrison).
    shared = ((member.T @ residual) ** 2 * lasting / (white * (white + count * lasting))).sum(axis=0)
    q = len(scaling.ids)
    low, high = scaling.to_z(scaling.lower), scaling.to_z(scaling.upper)
    outside = jnp.maximum(low - v[:q], 0.0) + jnp.maximum(v[:q] - high, 0.0)
    wall = ((outside / OUTSIDE) ** 2).sum()
    numpyro.factor("density", -0.5 * ((squares - shared).sum() + away @ data["precision"] @ away + wall))


def readings_by_jax(network: Network, scaling: Scaling, v: Any, base: Any, inputs: Any, steps: Any) -> Any:
    """Return readings (n, m) degC at v (q + k,), with full parameters `base` (p,) and inputs held over `steps` (n - 1,)
    s.
    """
    rhs = right_side_of(network, jnp.exp, jnp.log, jnp.maximum)
    q = len(scaling.ids)
    z = jnp.clip(v[:q], scaling.to_z(scaling.lower), scaling.to_z(scaling.upper))
    values = jnp.where(scaling.log, jnp.exp(jnp.where(scaling.log, z, 0.0)), scaling.offset + scaling.width * z)
    full = jnp.asarray(base).at[scaling.index].set(values)
    parameters = [full[i] for i in range(full.shape[0])]

    def slope(x: Any, u: Any) -> Any:
        return jnp.stack(rhs(x, u, parameters))

    def sample(x: Any, row: Any) -> Any:
        u, length = row
        h = length / STEPS
        for _ in range(STEPS):
            k1 = slope(x, u)
            k2 = slope(x + 0.5 * h * k1, u)
            k3 = slope(x + 0.5 * h * k2, u)
            k4 = slope(x + h * k3, u)
            x = x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
        return x, x

    first = v[q:]
    _, later = jax.lax.scan(sample, first, (jnp.asarray(inputs)[:-1], jnp.asarray(steps)))
    states = jnp.concatenate([first[None], later])
    return states[:, jnp.array(sensor_rows(network))]


def _information(jacobian: Array, model: WindowModel) -> Array:
    """Return the information (q + k, q + k) of readings with derivatives (n, m, q + k)."""
    total = np.zeros((jacobian.shape[2],) * 2)
    for j, (white, lasting) in enumerate(zip(model.white**2, model.lasting**2, strict=True)):
        rows = jacobian[:, j] * np.isfinite(model.window.measured[:, j])[:, None]
        total += rows.T @ rows / white
        for number in range(int(model.segment[-1]) + 1):
            own = model.segment == number
            pull, count = rows[own].sum(axis=0), int(np.isfinite(model.window.measured[own, j]).sum())
            total -= np.outer(pull, pull) * lasting / (white * (white + count * lasting))
    return total
