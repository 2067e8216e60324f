"""Squares and scores of a law's blocks, against the sums that they stand for."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twin.discovery.effects.shapes import Shape, courses_of
from twin.discovery.evidence.marginal import free_log_bayes, likeliest, log_bayes_of_sizes, most_log_bayes
from twin.discovery.evidence.scan import LEADING_TURNS, _likeliest_turns, _roughly, logsumexp
from twin.discovery.scoring.course_squares import CourseSquares
from twin.discovery.scoring.score_tests import ScoreTest
from twin.discovery.scoring.sweep import _late_sums, _steps_of, squares_of
from twin.elements.candidates import Candidate

SITES, B = 4, 7


@pytest.fixture
def score_test() -> Any:
    rng = np.random.default_rng(3)
    columns = rng.normal(size=(40, SITES * B))
    score = rng.normal(size=SITES * B)
    slopes = rng.normal(size=(40, 2))
    normal = slopes.T @ slopes + np.eye(2)
    taken = np.linalg.solve(normal, slopes.T @ columns)
    gram = columns.T @ columns - columns.T @ slopes @ taken
    made = SimpleNamespace(sites=SITES, b=B, m=1, gram=gram, score=score, memo={}, slopes=slopes)
    made._columns, made._taken = columns, taken
    made.scored = lambda p: ScoreTest.scored(made, p)  # type: ignore[arg-type]
    made.small_gram = lambda p: ScoreTest.small_gram(made, p)  # type: ignore[arg-type]
    return made


@pytest.mark.parametrize("at", [[2], [0, 3], [0, 1, 3], []])
def test_the_blocks_of_a_law_have_the_gram_matrix_and_score_of_their_columns(score_test: Any, at: list[int]) -> None:
    p = np.zeros((SITES, B))
    p[at] = np.random.default_rng(4).normal(size=(len(at), B))
    apart = np.concatenate([np.diag(row) for row in p])  # a column for each block: (sites * b, b)
    gram, score = ScoreTest.small(score_test, p)
    np.testing.assert_allclose(gram, apart.T @ score_test.gram @ apart, atol=1e-9)
    np.testing.assert_allclose(score, apart.T @ score_test.score, atol=1e-9)


def test_a_step_has_the_square_of_all_its_blocks_together(score_test: Any) -> None:
    gram = score_test.gram[:B, :B]
    steps = np.tril(np.ones((B, B)))  # the step of a column begins with its block
    np.testing.assert_allclose(_late_sums(gram), np.diag(steps.T @ gram @ steps), rtol=1e-12)


def test_steps_of_many_laws_have_the_squares_of_each_alone(score_test: Any) -> None:
    vectors = np.zeros((4, SITES, B))
    vectors[0, 1], vectors[1, 1], vectors[2, 3] = 1.0, np.arange(B), 2.0
    vectors[3, 1], vectors[3, 2] = -1.0, np.linspace(0.0, 1.0, B)
    alone = [_late_sums(ScoreTest.small_gram(score_test, p)) for p in vectors]
    np.testing.assert_allclose(_steps_of(score_test, vectors), alone, atol=1e-9)


def test_signatures_have_the_products_that_the_gram_matrix_says(score_test: Any) -> None:
    vector, courses = np.zeros((SITES, B)), np.random.default_rng(6).normal(size=(B, 3))
    vector[1], vector[3] = 2.0, np.arange(B)
    flat = (vector[:, :, None] * courses).reshape(SITES * B, 3)
    seen = ScoreTest.seen_at(score_test, vector, courses)
    np.testing.assert_allclose(seen, score_test._columns @ flat, atol=1e-9)
    np.testing.assert_allclose(ScoreTest.onto(score_test, seen), score_test.gram @ flat, atol=1e-9)


@pytest.mark.parametrize("bounds", [(-np.inf, np.inf), (0.0, 900.0), (-5.0, 0.0)])
@pytest.mark.parametrize("most", [1.0, 30.0])
def test_effects_that_count_beside_the_rest_are_told_by_a_bound(bounds: tuple[float, float], most: float) -> None:
    candidate = Candidate("heat_source", "tank", "constant", "new", {}, "W", 20.0, *bounds, "")
    rng = np.random.default_rng(7)
    bottom = rng.uniform(1e-4, 2.0, 4000)
    top = most * np.sqrt(bottom) * rng.normal(size=4000)
    every = log_bayes_of_sizes(candidate, top, bottom)[0]
    kept = likeliest(candidate, top, bottom)
    assert (most_log_bayes(candidate, top, bottom) >= free_log_bayes(candidate, top, bottom)).all()
    assert int(np.argmax(every)) in kept and (most < 10.0 or len(kept) < 2000)
    assert logsumexp(every[kept]) == pytest.approx(logsumexp(every), abs=1e-12)


@pytest.mark.parametrize("b", [B, SITES * B])
def test_courses_that_begin_later_have_the_squares_of_all_their_blocks(score_test: Any, b: int) -> None:
    gram = score_test.gram[:b, :b]
    courses = np.random.default_rng(5).normal(size=(b, 90))
    for column in range(80):
        courses[: column % (b + 1), column] = 0.0  # one of them is zero all along
    for _ in range(2):
        np.testing.assert_allclose(
            squares_of(score_test, gram, courses), np.diag(courses.T @ gram @ courses), atol=1e-9
        )
    assert squares_of(score_test, gram, courses[:, :0]).shape == (0,)


@pytest.mark.parametrize("bounds", [(-np.inf, np.inf), (0.0, 900.0)])
@pytest.mark.parametrize("most", [0.1, 30.0])
def test_turns_that_count_are_told_by_a_bound(bounds: tuple[float, float], most: float) -> None:
    candidate = Candidate("heat_source", "tank", "constant", "new", {}, "W", 20.0, *bounds, "")
    rng = np.random.default_rng(8)
    left, bottoms = np.linspace(1.0, 0.2, 5), rng.uniform(0.5, 2.0, 3000)
    tops = most * np.sqrt(left[:, None] * bottoms) * rng.normal(size=(5, 3000))
    found, prior, kept = _likeliest_turns(candidate, tops, bottoms, left)
    every = _roughly(candidate, tops, left[:, None] * bottoms) + prior[:, None]
    np.testing.assert_array_equal(found, every[:, kept])
    assert logsumexp(found) == pytest.approx(logsumexp(every), abs=1e-12) and (most < 10.0 or len(kept) < 1000)
    assert set(np.argsort(every.max(axis=0))[-LEADING_TURNS:]) <= set(kept.tolist())


@pytest.mark.parametrize("blocks", [41, 160])
@pytest.mark.parametrize("count", [4, 6, 7, 12])
def test_courses_of_one_family_have_the_squares_of_all_their_blocks(blocks: int, count: int) -> None:
    edges_s = np.linspace(0, 9600, blocks + 1).round() * 15.0  # blocks of equal length within a bin
    span = float(edges_s[-1])
    shapes = [Shape("pulse", float(t), decay) for decay in (60.0, 3600.0) for t in edges_s[1:-2:2]]
    shapes += [Shape("put in", float(t), 3600.0) for t in edges_s[1:-2:5]] + [Shape("pulse", 1234.5, 60.0)]
    shapes += [Shape("saturating", float(t), 7200.0) for t in edges_s[:-2:9]]
    shapes += [
        Shape("periodic", period * k / count, period, duty)
        for period in (0.5 * span, 0.21 * span, 0.05 * span)
        for duty in (0.25, 0.5, 0.75)
        for k in range(count)
    ]
    courses = courses_of(shapes, edges_s).T
    pulled = np.random.default_rng(9).normal(size=(2 * blocks, blocks)).cumsum(axis=1)
    squares = CourseSquares.of(courses, shapes, edges_s)
    # Families leave a pulse amid a block and the saturating courses, and turns of seven phases.
    alone = sum(part.columns.size for part in squares.parts if hasattr(part, "begun"))
    assert alone == 1 + len(edges_s[:-2:9]) + (9 * count if count == 7 else 0)
    np.testing.assert_allclose(squares(pulled.T @ pulled), ((pulled @ courses) ** 2).sum(axis=0), rtol=1e-11)
