"""Other optimisers on a `Problem`. All of them simulate with our kernel, in whole populations if they can.

Each function returns the best positions (q,). Swarms get 200 x 50 simulations and the usual constriction
coefficients, the others their own defaults; everyone starts from the live twin where the method takes a start.
"""

from __future__ import annotations

import contextlib
import io
import os
import tempfile
import warnings
from collections.abc import Iterator

import numpy as np

from hil.bench.kernel import Problem
from hil.bench.peers import Absent
from twin import Array

PARTICLES, ITERATIONS = 200, 50


def pyswarms_global(problem: Problem, seed: int) -> Array:
    """Minimise with `pyswarms.single.GlobalBestPSO`; its import writes a report.log into the working directory."""
    with _temporary_directory():
        try:
            import pyswarms
        except ImportError:
            raise Absent("pyswarms: not installed (pip install -e '.[bench]')") from None
        np.random.seed(seed)  # noqa: NPY002 - the library draws from the global generator
        q = len(problem.ids)
        swarm = pyswarms.single.GlobalBestPSO(
            PARTICLES, q, {"c1": 1.49, "c2": 1.49, "w": 0.73}, bounds=(np.zeros(q), np.ones(q))
        )
        _, best = swarm.optimize(problem.rmse, ITERATIONS, verbose=False)
    return np.asarray(best)


def pymoo_pso(problem: Problem, seed: int) -> Array:
    """Minimise with `pymoo`'s PSO, whole populations at a time."""
    try:
        from pymoo.algorithms.soo.nonconvex.pso import PSO
        from pymoo.core.problem import Problem as Base
        from pymoo.optimize import minimize
    except ImportError:
        raise Absent("pymoo: not installed (pip install -e '.[bench]')") from None

    class PymooFit(Base):
        def __init__(self) -> None:
            super().__init__(n_var=len(problem.ids), n_obj=1, xl=0.0, xu=1.0)

        def _evaluate(self, x: Array, out: dict[str, Array], *args: object, **kwargs: object) -> None:
            out["F"] = problem.rmse(x)[:, None]

    done = minimize(PymooFit(), PSO(pop_size=PARTICLES), ("n_gen", ITERATIONS), seed=seed, verbose=False)
    return np.asarray(done.X)


def cma_es(problem: Problem, seed: int) -> Array:
    """Minimise with `cma`, ask and tell, from the live twin with a spread of 0.2."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            import cma
        except ImportError:
            raise Absent("cma: not installed (pip install -e '.[bench]')") from None
        options = {"bounds": [0.0, 1.0], "seed": seed + 1, "verbose": -9, "tolfun": 1e-8, "maxfevals": 20_000}
        strategy = cma.CMAEvolutionStrategy(np.clip(problem.start, 0.01, 0.99), 0.2, options)
        while not strategy.stop():
            asked = np.asarray(strategy.ask())
            strategy.tell(list(asked), problem.rmse(asked).tolist())
        return np.asarray(strategy.result.xbest)


def differential_evolution(problem: Problem, seed: int) -> Array:
    """Minimise with `scipy.optimize.differential_evolution`, vectorised, without its polish."""
    from scipy.optimize import differential_evolution as evolve

    q = len(problem.ids)
    size = max(PARTICLES // q, 5)
    done = evolve(
        lambda x: problem.rmse(np.atleast_2d(x.T)),
        [(0.0, 1.0)] * q,
        popsize=size,
        maxiter=ITERATIONS,
        tol=1e-8,
        rng=seed,
        polish=False,
        vectorized=True,
        updating="deferred",
        x0=problem.start,
    )
    return np.asarray(done.x)


def least_squares(problem: Problem, seed: int) -> Array:
    """Minimise with `scipy.optimize.least_squares`, TRF, its own finite differences, from the live twin."""
    from scipy.optimize import least_squares as fit

    start = np.clip(problem.start, 1e-6, 1.0 - 1e-6)
    done = fit(lambda x: problem.residuals(x)[0], start, bounds=(0.0, 1.0), x_scale=0.1, ftol=1e-8, diff_step=1e-5)
    return np.asarray(done.x)


def least_squares_lanes(problem: Problem, seed: int) -> Array:
    """Minimise in the same way with a Jacobian of central differences out of one call of the kernel."""
    return refine(problem, problem.start)


def refine(problem: Problem, start: Array, *, state: bool = False) -> Array:
    """Refine positions (q,) by TRF, with the initial state free if `state`: positions (q,), state offsets behind."""
    from scipy.optimize import least_squares as fit

    q, k = len(problem.ids), len(problem.window.state) if state else 0
    step = np.concatenate([np.full(q, 1e-5), np.full(k, 1e-3)])
    low, high = np.concatenate([np.zeros(q), np.full(k, -5.0)]), np.concatenate([np.ones(q), np.full(k, 5.0)])

    def at(rows: Array) -> Array:
        states = problem.window.state + rows[:, q:] if state else None
        return problem.residuals(rows[:, :q], states)

    def jacobian(x: Array) -> Array:
        up, down = np.minimum(x + step, high), np.maximum(x - step, low)
        rows = np.tile(x, (2 * (q + k), 1))
        each = np.arange(q + k)
        rows[each, each], rows[q + k + each, each] = up, down
        out = at(rows)
        return ((out[: q + k] - out[q + k :]) / (up - down)[:, None]).T

    inside = np.clip(np.concatenate([start, np.zeros(k)]), low + 1e-6, high - 1e-6)
    done = fit(lambda x: at(x[None])[0], inside, jac=jacobian, bounds=(low, high), x_scale=0.1, ftol=1e-10)
    return np.asarray(done.x)


@contextlib.contextmanager
def _temporary_directory() -> Iterator[None]:
    """Change to a temporary working directory, and suppress output."""
    before = os.getcwd()
    with (
        tempfile.TemporaryDirectory(prefix="hil-bench-") as folder,
        contextlib.redirect_stderr(io.StringIO()),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore")
        os.chdir(folder)
        try:
            yield
        finally:
            os.chdir(before)
