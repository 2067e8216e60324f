"""A station of a few days, simulated once."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.virtual.tower.export import write_station
from drivers.virtual.tower.sites import CHICAGO_SITE
from drivers.virtual.tower.station import Simulated, SimulationPlan, simulate

DAYS_4 = 4 / 30.4375


@pytest.fixture(scope="session")
def made() -> Simulated:
    """Return four days of station A with one recorded cell and defects."""
    return simulate(CHICAGO_SITE, 1, SimulationPlan(months=DAYS_4, cells=1, seed=11, defects=True))


@pytest.fixture(scope="session")
def clean() -> Simulated:
    """Return the same station without defects."""
    return simulate(CHICAGO_SITE, 1, SimulationPlan(months=DAYS_4, cells=1, seed=11))


@pytest.fixture(scope="session")
def folder(clean: Simulated, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the files of the station without defects, and without its truth."""
    path = tmp_path_factory.mktemp("towers") / "stationA"
    write_station(clean, path, score=False)
    return path
