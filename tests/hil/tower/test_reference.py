"""`docs/reference/tower-record.md` against the code that reads and writes tower records."""

from __future__ import annotations

import re

from tests.hil.reference_pages import FOLDER, page
from twin.historian.checks import NAMES
from twin.historian.columns import OF_CELL, OF_STATION
from twin.historian.events import INFLUENCE
from twin.historian.minutes import How
from twin.historian.regimes import Regime
from twin.historian.units import UNITS

PAGE = page("tower-record")


def _names(cell: str) -> list[str]:
    return re.findall(r"`([^`]+)`", cell)


def test_roles_and_their_columns_are_those_of_the_code() -> None:
    told = {
        _names(row["Role"])[0]: (
            row["Of"],
            *_names(row["Column"]),
            row["Dimension"],
            float(row["From"]),
            float(row["To"]),
            row["Minutes"],
        )
        for row in PAGE.rows["Roles"]
    }
    real = {
        role: (where, column.name, column.dimension, column.low, column.high, column.filling)
        for where, table in (("cell", OF_CELL), ("station", OF_STATION))
        for role, column in table.items()
    }
    assert told == real


def test_units_are_those_of_the_code() -> None:
    told = {name: row["Dimension"] for row in PAGE.rows["Units"] for name in _names(row["Units"])}
    assert told == {name: unit.dimension for name, unit in UNITS.items()}


def test_the_influence_of_events_is_that_of_the_code() -> None:
    told = {_names(row["Class"])[0]: (float(row["Hours"]), row["Parameters"]) for row in PAGE.rows["Influence"]}
    assert told == {kind: (one.hours, ", ".join(one.parameters) or "none") for kind, one in INFLUENCE.items()}


def test_codes_are_those_of_the_code() -> None:
    text = (FOLDER / "tower-record.md").read_text()
    for regime in Regime:
        assert f"{regime.value} {regime.name.lower().replace('_', ' ').replace('start up', 'start-up')}" in text
    for origin in (How.MISSING, How.MEASURED, How.INTERPOLATED, How.HELD):
        assert f"{origin.value} {origin.name.lower()}" in text
    assert all(f"{bit} " in text for bit in NAMES)
