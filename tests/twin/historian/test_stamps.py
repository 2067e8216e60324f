"""Time stamps that are not of the record: tags from the future, loggers that began anew, longer archives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.twin.historian.made_station import clean_store
from twin.historian.stamps import without_strays
from twin.historian.tags import Series

DAY_S = 86400.0
MAST = ("TDB", "RHA", "RHB", "TWB", "PB", "WS", "WD")


@pytest.fixture(scope="module")
def clean() -> list[Series]:
    return clean_store(np.random.default_rng(6), 6.0)


def shifted(clean: list[Series], names: tuple[str, ...], days: float) -> list[Series]:
    return [replace(one, time_s=one.time_s + days * DAY_S) if one.tag.name in names else one for one in clean]


def test_a_clean_store_is_as_it_was(clean: list[Series]) -> None:
    kept, remarks = without_strays(clean, {})
    assert remarks == [] and all(len(a.time_s) == len(b.time_s) for a, b in zip(kept, clean, strict=True))


@pytest.mark.parametrize("days", [5.0, 400.0, 7300.0, -400.0])
@pytest.mark.parametrize("names", [("JI1",), ("T1OUT",), ("WS",), MAST])
def test_tags_of_another_time_are_left_out_and_the_record_keeps_its_length(
    clean: list[Series], names: tuple[str, ...], days: float
) -> None:
    kept, remarks = without_strays(shifted(clean, names, days), {})
    left = [one for one in kept if len(one.time_s)]
    assert {one.tag.name for one in left} == {one.tag.name for one in clean} - set(names)
    assert max(one.time_s.max() for one in left) - min(one.time_s.min() for one in left) < 6.1 * DAY_S
    assert len(remarks) == len(names) and all("check the logger's clock" in text for text in remarks)


def test_a_weather_archive_that_is_longer_than_the_plants_is_cut(clean: list[Series]) -> None:
    low = clean[0].time_s[0] + 4.0 * DAY_S
    late = [one if one.tag.name in MAST else one.between(low, np.inf) for one in clean]
    kept, remarks = without_strays(late, {})
    assert all(len(one.time_s) for one in kept) and min(one.time_s.min() for one in kept) > low - 3600.0
    assert len(remarks) == 1 and "TDB and 6 further tags" in remarks[0]


def test_two_campaigns_far_apart_are_one_record(clean: list[Series]) -> None:
    middle = clean[0].time_s[0] + 3.0 * DAY_S
    both = [replace(one, time_s=np.where(one.time_s > middle, one.time_s + 90 * DAY_S, one.time_s)) for one in clean]
    kept, remarks = without_strays(both, {})
    assert remarks == [] and all(len(a.time_s) == len(b.time_s) for a, b in zip(kept, clean, strict=True))


def test_a_cell_that_goes_on_alone_with_all_it_needs_is_kept(clean: list[Series]) -> None:
    end = clean[0].time_s[0] + 2.0 * DAY_S
    needed = ("T1IN", "T1OUT", "F1", "SI1", "TDB", "RHA")
    series = [one if one.tag.name in needed else one.between(-np.inf, end) for one in clean]
    kept, remarks = without_strays(series, {})
    assert remarks == [] and max(one.time_s.max() for one in kept) > end + 3.0 * DAY_S
