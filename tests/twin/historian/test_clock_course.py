"""Clocks that drift or were set in the middle of a record, by the lags of a tag to the others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tests.twin.historian.made_station import clean_store
from twin.historian.defects.clocks import moved_clocks
from twin.historian.tags import Array, Series

DAYS = 12.0


@pytest.fixture(scope="module")
def clean() -> list[Series]:
    return clean_store(np.random.default_rng(31), DAYS)


def with_clock(clean: list[Series], name: str, later_s: Callable[[Array], Array]) -> list[Series]:
    start = clean[0].time_s[0]
    return [
        replace(one, time_s=one.time_s + later_s((one.time_s - start) / 86400.0 / DAYS))
        if one.tag.name == name
        else one
        for one in clean
    ]


@pytest.mark.parametrize("seed", [31, 32, 33])
def test_clocks_that_keep_time_are_not_named(seed: int) -> None:
    assert moved_clocks(clean_store(np.random.default_rng(seed), DAYS)) == []


@pytest.mark.parametrize("name", ["T1OUT", "T2IN", "TRET"])
@pytest.mark.parametrize(
    ("later_s", "change_s"),
    [
        (lambda part: 3600.0 * part, 1800.0),
        (lambda part: -3600.0 * part, -1800.0),
        (lambda part: np.where(part > 0.5, 3600.0, 0.0), 3600.0),
    ],
)
def test_a_clock_that_drifts_or_was_set_is_named(
    clean: list[Series], name: str, later_s: Callable[[Array], Array], change_s: float
) -> None:
    (found,) = moved_clocks(with_clock(clean, name, later_s))
    assert found.tags == (name,) and found.later_s == pytest.approx(change_s, abs=600.0)
    assert "against the other tags" in found.says
