"""Squares and scores of a law's blocks, against the sums that they stand for."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twin.discovery.evidence.marginal import _onto
from twin.discovery.scoring.contest import Contest
from twin.discovery.scoring.sweep import _late_sums, squares_of

SITES, B = 4, 7


@pytest.fixture
def contest() -> Any:
    rng = np.random.default_rng(3)
    columns = rng.normal(size=(40, SITES * B))
    score = rng.normal(size=SITES * B)
    made = SimpleNamespace(sites=SITES, b=B, gram=columns.T @ columns, score=score, memo={})
    made.scored = lambda p: Contest.scored(made, p)  # type: ignore[arg-type]
    return made


@pytest.mark.parametrize("at", [[2], [0, 3], [0, 1, 3], []])
def test_the_blocks_of_a_law_have_the_gram_matrix_and_score_of_their_columns(contest: Any, at: list[int]) -> None:
    p = np.zeros((SITES, B))
    p[at] = np.random.default_rng(4).normal(size=(len(at), B))
    apart = np.concatenate([np.diag(row) for row in p])  # a column for each block: (sites * b, b)
    gram, score = Contest.small(contest, p)
    np.testing.assert_allclose(gram, apart.T @ contest.gram @ apart, atol=1e-9)
    np.testing.assert_allclose(score, apart.T @ contest.score, atol=1e-9)


def test_a_step_has_the_square_of_all_its_blocks_together(contest: Any) -> None:
    gram = contest.gram[:B, :B]
    steps = np.tril(np.ones((B, B)))  # the step of a column begins with its block
    np.testing.assert_allclose(_late_sums(gram), np.diag(steps.T @ gram @ steps), rtol=1e-12)


def test_columns_that_are_zero_at_most_sites_show_as_the_gram_matrix_says(contest: Any) -> None:
    every = np.zeros((3, SITES, B))
    every[0, 1] = every[1, 1] = 2.0
    every[1, 3], every[2, 0] = -1.0, np.arange(B)
    flat = every.reshape(3, -1)
    np.testing.assert_allclose(_onto(contest, flat), contest.gram @ flat.T, atol=1e-9)


@pytest.mark.parametrize("b", [B, SITES * B])
def test_courses_that_begin_later_have_the_squares_of_all_their_blocks(contest: Any, b: int) -> None:
    gram = contest.gram[:b, :b]
    courses = np.random.default_rng(5).normal(size=(b, 90))
    for column in range(80):
        courses[: column % (b + 1), column] = 0.0  # one of them is zero all along
    for _ in range(2):
        np.testing.assert_allclose(squares_of(contest, gram, courses), np.diag(courses.T @ gram @ courses), atol=1e-9)
    assert squares_of(contest, gram, courses[:, :0]).shape == (0,)
