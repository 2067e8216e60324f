"""The minimiser of the joint fits against scipy's, and where onsets bend the residual."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares, lsq_linear

from tests.discovery.conftest import Bench
from twin.discovery.effects.shapes import Shape
from twin.discovery.evidence.part import Part
from twin.discovery.healthy.basis import Columns, basis
from twin.discovery.records.grid import on_grid
from twin.discovery.refit.fitting import fit
from twin.discovery.refit.model import Model
from twin.discovery.refit.stepping import (
    LEAST,
    LeastSquaresProblem,
    SearchPoint,
    TrialStep,
    _best,
    bounded_step,
    minimise,
)
from twin.discovery.scoring.search import Entry


def smooth(wanted: np.ndarray, reach: float = np.inf, unit: float = 1.0) -> LeastSquaresProblem:
    """Decays a exp(-b t) + c t against what they are at `wanted`; a in a `unit` of its own."""
    t = np.linspace(0.0, 4.0, 30)

    def course(v: np.ndarray) -> np.ndarray:
        return unit * v[0] * np.exp(-v[1] * t) + v[2] * t

    def residuals(rows: np.ndarray) -> np.ndarray:
        return 10.0 * np.stack([course(wanted) + 0.01 * np.sin(9.0 * t) - course(v) for v in rows])

    def jacobian(v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        decay = np.exp(-v[1] * t)
        return 10.0 * np.column_stack([unit * decay, -unit * v[0] * t * decay, t]), np.empty((30, 0))

    scale = np.array([1.0 / unit, 1.0, 1.0])
    low, high = np.array([-5.0, 0.05, -1.0]) * scale, np.array([5.0, 3.0, 1.0]) * scale
    precision = 0.01 * np.diag(scale**-2)
    return LeastSquaresProblem(residuals, jacobian, precision, low, high, reach * scale, np.arange(0), 1.0, scale)


@settings(max_examples=40, deadline=None)
@example(a=2.4609375, b=0.1, c=0.0, reach=0.3)
@example(a=1.0, b=0.25, c=0.375, reach=0.3)
@example(a=1.1015625, b=0.25, c=0.0, reach=np.inf)
@given(a=st.floats(0.5, 4.5), b=st.floats(0.1, 2.8), c=st.floats(-0.9, 0.9), reach=st.sampled_from([0.3, np.inf]))
def test_smooth_squares_become_as_small_as_scipy_makes_them(a: float, b: float, c: float, reach: float) -> None:
    problem = smooth(np.array([a, b, c]), reach)
    found, *_ = minimise(problem, np.array([1.0, 1.0, 0.0]), 40)

    def both(v: np.ndarray) -> np.ndarray:
        return np.concatenate([problem.residuals(v[None])[0], 0.1 * v])

    best = least_squares(both, [1.0, 1.0, 0.0], bounds=(problem.low, problem.high))
    # It ends where a step gains less than LEAST, of which several may be left; what matters to a diagnosis is 20.
    assert found.total < 2.0 * best.cost + 25.0 * LEAST
    assert found.total == pytest.approx(float((both(found.v) ** 2).sum()))
    assert (problem.low <= found.v).all() and (found.v <= problem.high).all()


@pytest.mark.parametrize("unit", [1e-6, 1e-4, 1e4])
def test_in_what_unit_a_quantity_is_does_not_matter(unit: float) -> None:
    """A thermal mass is a hundred thousand of its unit, a parameter half of one."""
    wanted, begin = np.array([3.0, 0.7, 0.4]), np.array([1.0, 1.0, 0.0])
    other = np.array([1.0 / unit, 1.0, 1.0])
    plain, *_ = minimise(smooth(wanted), begin, 40)
    found, *_ = minimise(smooth(wanted * other, unit=unit), begin * other, 40)
    assert found.total == pytest.approx(plain.total, rel=1e-3)
    assert found.v / other == pytest.approx(plain.v, rel=1e-3)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), size=st.integers(1, 12))
def test_a_bounded_step_is_the_best_within_its_bounds(seed: int, size: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(3 * size, size)), rng.normal(size=3 * size)
    low, high = -rng.uniform(0.01, 0.5, size), rng.uniform(0.01, 0.5, size)
    step = bounded_step(a.T @ a, a.T @ b, low, high)
    assert (low <= step).all() and (step <= high).all()
    best = lsq_linear(a, b, (low, high)).x

    def left(s: np.ndarray) -> float:
        return float(((b - a @ s) ** 2).sum())

    assert left(step) <= left(best) + 1e-4 * float(b @ b)


def test_a_step_without_bounds_in_its_way_is_newtons() -> None:
    hessian, wide = np.array([[4.0, 1.0], [1.0, 3.0]]), np.full(2, 1e9)
    assert bounded_step(hessian, np.array([1.0, -2.0]), -wide, wide) == pytest.approx(
        np.linalg.solve(hessian, [1.0, -2.0])
    )
    held = bounded_step(hessian, np.array([1.0, -2.0]), np.array([0.0, -9.0]), np.array([0.0, 9.0]))
    assert held == pytest.approx([0.0, -2.0 / 3.0])


@pytest.mark.parametrize("off_h", [-0.6, -0.2, 0.25, 0.7])
def test_an_onset_is_found_from_either_side_and_across_the_edges_of_blocks(
    bench: Bench, healthy: Columns, off_h: float
) -> None:
    hot = bench.with_values(modules_power__power=60.0)
    record = bench.record(changed=hot, onset_h=7.13)
    grid = on_grid(bench.network, record.time_s, record.inputs, record.measured)
    part = Part.of(basis(bench.network, healthy, grid), grid)
    label = ("heat_source", "modules", "constant")
    law = next(w for w in part.laws if (w.candidate.kind, w.candidate.where, w.candidate.driver) == label)
    begun = Entry(law, Shape("step", (7.13 + off_h) * 3600.0), part.score_test.vector(law), 40.0, 0.0, 0.0)
    part.reset()
    found = fit(part.score_test, Model.of(part.basis.probe, (begun,)), part.state)
    (effect,) = found.entries
    assert effect.shape.onset_s == pytest.approx(7.13 * 3600.0, abs=90.0)
    assert effect.size == pytest.approx(60.0, rel=0.05)
    assert found.chi < 1.5 * part.score_test.expected


def test_a_step_that_is_no_number_leads_nowhere() -> None:
    """The simulation refuses such values; the others of a round are still tried."""
    problem = smooth(np.array([2.0, 1.0, 0.5]))
    seen: list[np.ndarray] = []

    def residuals(rows: np.ndarray) -> np.ndarray:
        assert np.isfinite(rows).all()
        seen.append(rows)
        return problem.residuals(rows)

    place = SearchPoint(np.array([1.0, 1.0, 0.0]), np.zeros(30), 1e9)
    tried = [TrialStep(np.full(3, np.nan), 1.0, 1.0, 0.0), TrialStep(np.array([1.0, 0.0, 0.5]), 1.0, 1.0, 0.0)]
    step, found = _best(replace(problem, residuals=residuals), place, tried)
    assert step is tried[1] and found.v == pytest.approx([2.0, 1.0, 0.5]) and len(seen) == 1
