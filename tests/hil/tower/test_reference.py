"""`docs/reference/tower-record.md` against the code that reads and writes tower records."""

from __future__ import annotations

import re

from hil.tower.calibration.commission import OPTIONAL, REQUIRED
from hil.tower.governance import gates
from tests.hil.reference_pages import FOLDER, page
from twin.historian.checks import NAMES
from twin.historian.columns import OF_CELL, OF_STATION
from twin.historian.events import INFLUENCE
from twin.historian.minutes import How
from twin.historian.regimes import Regime
from twin.historian.units import FURTHER_UNITS, UNITS
from twin.tower.twin_file import BOUNDS

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
    further = {name: row["Dimension"] for row in PAGE.rows["Further units"] for name in _names(row["Units"])}
    assert further == {name: unit.dimension for name, unit in FURTHER_UNITS.items()}


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


def test_columns_of_test_points_are_those_of_the_code() -> None:
    needed = {name: row["Needed"] for row in PAGE.rows["Test points"] for name in _names(row["Column"])}
    assert {name for name, word in needed.items() if word == "yes"} == set(REQUIRED)
    assert {name for name, word in needed.items() if word == "no"} == {"test", *OPTIONAL}


def test_bounds_of_labels_are_those_of_a_twin_file() -> None:
    told = {
        _names(row["Parameter"])[0]: (float(row["From"]), float(row["To"]))
        for row in PAGE.rows["Labels"]
        if "Parameter" in row
    }
    clean = {name: 0.0 if name == "bias" else 1.0 for name in BOUNDS}
    assert told == {name: (round(clean[name] - b, 6), round(clean[name] + b, 6)) for name, b in BOUNDS.items()}


def test_reason_codes_are_those_of_the_gates() -> None:
    told = [_names(row["Code"])[0] for row in PAGE.rows["Reason codes"] if "Code" in row]
    assert told == re.findall(r"^\| `([^`]+)` \|", gates.__doc__ or "", re.MULTILINE)
