"""Aligned records that are none of a plant: shuffled, flat, in other units."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.record.raw import RecordError
from hil.tower.station.plausibility import refuse_implausible
from tests.twin.tower.made_cell import Made, made_cell


@pytest.fixture(scope="module")
def made() -> Made:
    return made_cell(1.0, test_days=())


def judged(made: Made, rows: np.ndarray | None = None, **changed: np.ndarray) -> dict[str, np.ndarray]:
    """The columns that were judged, as they are afterwards."""
    rows = np.arange(len(made.time_s)) if rows is None else rows
    columns = {name: values[rows] for name, values in {**made.columns, **changed}.items()}
    origin = {name: values[rows] for name, values in made.origin.items()}
    refuse_implausible(Path("cell1.parquet"), made.time_s, columns, origin)
    return columns


def test_a_record_of_a_plant_passes_as_it_is(made: Made) -> None:
    given = {name: values.copy() for name, values in made.columns.items()}
    steady = {"fan_speed_pct": np.full(len(made.time_s), 100.0), "pressure_kPa": np.full(len(made.time_s), np.nan)}
    for changed in ({}, steady):
        for name, values in judged(made, **changed).items():
            np.testing.assert_array_equal(values, {**given, **changed}[name])


def test_shuffled_rows_are_refused_by_their_time_or_by_their_jumps(made: Made) -> None:
    mixed = np.random.default_rng(0).permutation(len(made.time_s))
    with pytest.raises(RecordError, match=r"^SHUFFLED_RECORD: cell1\.parquet: .*t_in_C.* jump by more than 0\.5 K"):
        judged(made, mixed)
    times = made.time_s.copy()
    times[[10, 20]] = times[[20, 10]]
    with pytest.raises(RecordError, match=r"^SHUFFLED_RECORD: .* time does not rise from row 11"):
        refuse_implausible(Path("cell1.parquet"), times, made.columns, made.origin)


@pytest.mark.parametrize("name", ["t_in_C", "t_out_C", "dry_C", "wet_C"])
def test_a_temperature_that_stands_still_throughout_is_refused(made: Made, name: str) -> None:
    flat = np.full(len(made.time_s), 21.5)
    with pytest.raises(RecordError, match=rf"^FLAT_RECORD: .* {name} stands at 21\.50 throughout"):
        judged(made, **{name: flat})


@pytest.mark.parametrize(
    ("name", "factor", "offset", "says"),
    [
        ("t_in_C", 1.8, 32.0, "degF or K"),
        ("t_out_C", 1.0, 273.15, "degF or K"),
        ("wet_C", 1.8, 32.0, "degF or K"),
        ("pressure_kPa", 10.0, 0.0, "hPa, bar or psi"),
        ("fan_speed_pct", 0.01, 0.0, "share of one"),
    ],
)
def test_a_column_in_another_unit_is_refused_with_the_unit_to_give(
    made: Made, name: str, factor: float, offset: float, says: str
) -> None:
    with pytest.raises(RecordError, match=rf"^OTHER_UNITS: cell1\.parquet: .*{name}.*{says}"):
        judged(made, **{name: factor * made.columns[name] + offset})
