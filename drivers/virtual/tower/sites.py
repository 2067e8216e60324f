"""Sites of the virtual station, and the clean plant that a seed draws for one of them.

A datasheet states the design. The station as built deviates from it: each cell has its own fill, fan and distribution.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.virtual.tower.physics import CELL, STATE, compiled, dry_air_density, wet_bulb
from drivers.virtual.tower.physics import cell as physics
from drivers.virtual.tower.weather import CHICAGO, MIAMI, Climate

Array = NDArray[np.float64]


class EnteringAir(NamedTuple):
    """Air that enters a cell: dry bulb degC, humidity ratio kg/kg, pressure kPa, wind m/s."""

    dry: float
    ratio: float
    pressure: float
    wind: float


@dataclass(frozen=True)
class StationDesign:
    """Design of a station by its datasheet: flows kg/s, temperatures degC, kPa, kW, m, m3, and names."""

    station: str
    city: str
    timezone: str
    weather_words: tuple[str, ...]
    climate: Climate
    cells: int
    water: float
    air: float
    hot: float
    cold: float
    wet: float
    pressure: float
    rated_power: float
    power: float
    plan: float
    fill_height: float
    basin: float
    header: float
    first_cells: int
    cells_per_pump: float
    variable_pumps: bool
    setpoint: float
    batch: bool
    style: str

    @property
    def cell_load(self) -> float:
        """Design heat of a cell, kW."""
        return self.water * 4.182 * (self.hot - self.cold)


CHICAGO_SITE = StationDesign(
    "A",
    "Chicago",
    "America/Chicago",
    ("chicago",),
    CHICAGO,
    4,
    250.0,
    200.0,
    36.0,
    29.0,
    25.0,
    98.9,
    55.0,
    45.0,
    9.8,
    1.5,
    420.0,
    160.0,
    2,
    1.6,
    False,
    23.0,
    False,
    "loops",
)
MIAMI_SITE = StationDesign(
    "B",
    "Miami",
    "America/New_York",
    ("miami",),
    MIAMI,
    2,
    132.0,
    122.0,
    38.2,
    31.4,
    26.7,
    101.3,
    30.0,
    23.5,
    7.4,
    1.2,
    150.0,
    60.0,
    1,
    1.0,
    True,
    28.6,
    True,
    "words",
)
SITES = (CHICAGO_SITE, MIAMI_SITE)


@dataclass(frozen=True)
class BuiltStation:
    """The clean station as built: rows of cells, shares of sectors, numbers of the station, thermometers' lags s."""

    site: StationDesign
    cells: Array
    shares: Array
    numbers: Array
    rtd_s: Array

    def clean_state(self) -> Array:
        """Return the state of a cell without degradation."""
        return np.array([1.0, 1.0, 0.0, 0.0, 0.0])

    def air_multiplier(self, cell: int, state: Array) -> float:
        """Return the air flow at full speed and design air over that of the clean cell."""
        row = self.cells[cell]
        flow = [
            physics.air_flow(row, s, 1.0, 1.0, row[physics.DENSITY0], row[physics.DENSITY0], 0.0)
            for s in (state, self.clean_state())
        ]
        return float(flow[0] / flow[1])

    def uniformity(self, cell: int, state: Array) -> float:
        """Return the wetted share at design flow over that of the clean cell."""
        water, _, clean, plugged = self.shares[cell]
        starving = self.cells[cell][physics.STARVING]
        share = [
            sum(
                physics.wetted_share(clean[j], plugged[j], u, water[j] * len(water), starving)
                for j in range(len(water))
            )
            for u in (state[physics.S_UNIFORMITY], 1.0)
        ]
        return float(share[0] / share[1])

    def steady(
        self,
        cell: int,
        state: Array,
        m_w: float,
        speed: float,
        t_in: float,
        air: EnteringAir,
    ) -> physics.Leaving:
        """Return what leaves a cell at rest, as `cell_step` does."""
        dry, ratio, p, wind = air
        sectors = self.shares.shape[2]
        memory = np.concatenate(
            [np.full(sectors, t_in - 4.0), np.full(sectors, ratio + 0.015), [dry + 3.0, ratio + 0.01]]
        )
        leaving: physics.Leaving = compiled.steady_cell(
            self.cells[cell], state, self.shares[cell], m_w, speed, t_in, dry, ratio, p, wind, memory
        )
        return leaving


def build(site: StationDesign, rng: np.random.Generator) -> BuiltStation:
    """Return a station as built for a site, drawn by `rng`: five to eight sectors, each cell a little off its
    design."""
    sectors = int(rng.integers(5, 9))
    cells = np.stack([_cell(site, rng) for _ in range(site.cells)])
    shares = np.stack([_shares(sectors, rng) for _ in range(site.cells)])
    numbers = np.array(
        [
            site.cell_load,
            site.setpoint,
            site.header,
            site.basin,
            site.cells_per_pump,
            float(site.variable_pumps),
            0.7,
            float(site.first_cells),
            0.3,
            rng.uniform(20.0, 45.0),
            rng.uniform(25.0, 60.0),
            site.climate.mean + 2.0,
        ]
    )
    built = BuiltStation(site, cells, shares, numbers, rng.uniform(20.0, 60.0, site.cells))
    for c in range(site.cells):
        _size_fill(built, c, site.cold + rng.normal(0.0, 0.25))
    return built


def _cell(site: StationDesign, rng: np.random.Generator) -> Array:
    exhaust = dry_air_density(site.hot - 3.0, 0.0345, site.pressure)
    slope, bend = rng.uniform(0.0, 0.3), rng.uniform(0.35, 0.7)
    values = {
        "m_w0": site.water,
        "m_a0": site.air * rng.normal(1.0, 0.02),
        "fill": 1.0,
        "fill_water": rng.uniform(0.42, 0.62),
        "fill_air": rng.uniform(0.50, 0.66),
        "fill_hot": rng.uniform(0.20, 0.40),
        "spray": rng.uniform(0.08, 0.14),
        "rain": rng.uniform(0.12, 0.22),
        "starving": rng.uniform(1.1, 1.7),
        "dry_air": rng.uniform(1.05, 1.25),
        "fan_shut": 1.0 + slope + bend,
        "fan_slope": slope,
        "fan_bend": bend,
        "load_drag": rng.uniform(0.10, 0.22),
        "wind_drag": rng.uniform(0.0007, 0.0016),
        "draft": rng.uniform(0.4, 0.6),
        "power": site.power * rng.normal(0.97, 0.015),
        "drive_loss": rng.uniform(0.015, 0.03),
        "density0": exhaust,
        "t_hot0": site.hot,
        "recirculation": rng.uniform(0.004, 0.012),
        "recirculation_wind": rng.uniform(0.0006, 0.0018),
        "windmill": rng.uniform(1.0, 2.0),
    }
    return np.array([values[name] for name in CELL])


def _shares(sectors: int, rng: np.random.Generator) -> Array:
    """Return water, air, clean wetted share and susceptibility to plugging of the sectors."""
    water, air = rng.normal(1.0, 0.18, sectors), rng.normal(1.0, 0.12, sectors)
    clean = np.clip(rng.normal(0.945, 0.02, sectors), 0.88, 0.985)
    plugged = rng.uniform(0.4, 1.6, sectors)
    plugged *= clean.sum() / (clean * plugged).sum()
    return np.stack([water / water.sum(), air / air.sum(), clean, plugged])


def _size_fill(built: BuiltStation, cell: int, cold: float) -> None:
    """Give a cell the fill that cools its design water to `cold` at the design's entering air, by bisection."""
    site = built.site
    dry, ratio = design_air(site)
    low, high = 0.2, 6.0
    for _ in range(30):
        middle = 0.5 * (low + high)
        built.cells[cell, physics.FILL] = middle
        air = EnteringAir(dry, ratio, site.pressure, 0.0)
        out = built.steady(cell, built.clean_state(), site.water, 1.0, site.hot, air)[0]
        low, high = (middle, high) if out > cold else (low, middle)


def design_air(site: StationDesign) -> tuple[float, float]:
    """Return dry bulb and humidity ratio of the design's entering air: its wet bulb at a depression of 5 K."""
    dry = site.wet + 5.0
    low, high = 0.0, 0.04
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if wet_bulb(dry, middle, site.pressure) < site.wet else (low, middle)
    return dry, 0.5 * (low + high)


assert len(STATE) == 5
