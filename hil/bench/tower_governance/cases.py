"""Stations of a trial: what is added to their degradation, and when they are calibrated.

All begin as fresh plants after a cleaning. In a station with a ramp, the fill of cell 1 is lost and the nozzles of cell
2 plug and are cleaned. A plain station has the wear of its seed alone. No archive has seeded defects.
"""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from pathlib import Path

from drivers.virtual.tower import SITES, Ramp, SimulationPlan, StationDesign

CELLS = 2
"""Recorded cells of a station: all of station B, and the first compartment of station A."""
FRESH_MONTHS = 6.0
"""Length from which a simulated plant begins fresh from a cleaning."""
HEALTHY_DAYS = 21
"""Days that the twins learn as healthy."""
RAMP_CELL, RAMP_FIRST, RAMP_END, RAMP_LOSS = 1, 22, 52, 0.12
"""Loss of fill of the paper: 12 % in 30 days."""
CLEANED_CELL, PLUG_FIRST, PLUG_END, PLUG_LOSS = 2, 22, 36, 0.13
CLEAN_FIRST, CLEAN_END, CLEAN_GAIN = 37, 38, 0.09
"""Cleaning of the paper: from 0.86 to 0.95, from a clean cell that has plugged before."""
RAMP_NIGHT = 27
"""First midnight at which a station with a ramp is calibrated."""
RAMPS = (
    Ramp(RAMP_CELL, "fill", RAMP_FIRST, RAMP_END, -RAMP_LOSS),
    Ramp(CLEANED_CELL, "uniformity", PLUG_FIRST, PLUG_END, -PLUG_LOSS),
    Ramp(CLEANED_CELL, "uniformity", CLEAN_FIRST, CLEAN_END, CLEAN_GAIN, "nozzle_cleaning"),
)
RAMP, CLEANING, PLAIN = "ramp", "cleaning", "plain"


@dataclass(frozen=True, slots=True)
class StationCase:
    """A station of a trial: name, site's number, seed, month of its beginning, days, midnights of its calibrations, and
    whether it has ramps."""

    name: str
    site: int
    seed: int
    month: int
    days: int
    nights: tuple[int, ...]
    ramps: bool

    @property
    def design(self) -> StationDesign:
        """Design of the station's site."""
        return SITES[self.site]

    def plan(self, weather: Path | None) -> SimulationPlan:
        """Return the plan of its simulation."""
        return SimulationPlan(
            FRESH_MONTHS,
            CELLS,
            self.seed,
            datetime.datetime(2022, self.month, 1, tzinfo=datetime.UTC),
            weather=weather,
            segments=((0, self.days),),
            ramps=RAMPS if self.ramps else (),
        )

    @property
    def cells(self) -> range:
        """Recorded cells."""
        return range(1, CELLS + 1)

    def kind(self, cell: int) -> str:
        """Return `RAMP`, `CLEANING` or `PLAIN` of a cell."""
        return PLAIN if not self.ramps else RAMP if cell == RAMP_CELL else CLEANING


@dataclass(frozen=True, slots=True)
class TrialSize:
    """Size of a trial.

    Attributes
    ----------
    ramps, ramp_every
        Stations with ramps, and days between their calibrations.
    plain, days, every
        Plain stations, their days, and days between their calibrations.
    """

    ramps: int = 4
    ramp_every: int = 5
    plain: int = 2
    days: int = 120
    every: int = 20

    def cases(self, seed: int) -> list[StationCase]:
        """Return the stations: sites by turns, beginning in another season each."""
        first = 1000 + 100 * seed
        midnights = tuple(range(RAMP_NIGHT, RAMP_END + 1, self.ramp_every))
        with_ramps = [
            StationCase(f"R{k + 1}", k % 2, first + k, 1 + 3 * k % 12, RAMP_END + 1, midnights, True)
            for k in range(self.ramps)
        ]
        nights = (*range(HEALTHY_DAYS + self.every, self.days, self.every), self.days)
        plain = [
            StationCase(f"P{k + 1}", k % 2, first + 50 + k, 1 + 6 * k % 12, self.days, nights, False)
            for k in range(self.plain)
        ]
        return with_ramps + plain


FULL = TrialSize()
QUICK = TrialSize(ramps=1, ramp_every=25, plain=1, days=41, every=20)
