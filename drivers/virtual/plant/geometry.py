"""Geometry of the virtual rig: volumes, masses, conductances and lags, and the water cells made of them.

The loop is one ring of water cells. Every cell touches one solid (pipe wall, heater shell, heat sink, fin block,
tank wall); every solid loses heat to the room. Sections follow the water:

    tank -> pipe_to_heater -> heater -> pipe_to_modules -> pm1 .. pm6 -> pipe_to_radiator -> radiator -> pipe_to_tank

Units: L, kg, J/K, W/K, s. Scalar constants of the physics stand in `kernel`. The rig is fictitious, scaled
after Energies 2026, 19, 2452, section 2.2 (37.85 L tank, 3.785 L/min, six cold plates in series, three-fan radiator).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class RingSection(NamedTuple):
    """Section of the ring: `cells` equal water cells and the solid along them (totals of the section)."""

    name: str
    cells: int
    water_L: float
    solid_J_per_K: float
    film_W_per_K: float
    """Water to solid at nominal flow."""
    film_exponent: float
    """Film conductance follows (flow / nominal flow) ** film_exponent ..."""
    film_floor_W_per_K: float
    """... but never falls below free convection."""
    outer_W_per_K: float
    """Solid to room (the radiator's fans come on top)."""


SECTIONS = (
    RingSection("pipe_to_heater", 16, 0.40, 560.0, 28.0, 0.0, 28.0, 0.40),
    RingSection("heater", 4, 0.50, 640.0, 150.0, 0.5, 20.0, 0.55),
    RingSection("pipe_to_modules", 11, 0.28, 390.0, 20.0, 0.0, 20.0, 0.30),
    RingSection("modules", 6, 0.30, 4900.0, 270.0, 0.65, 18.0, 1.50),
    RingSection("pipe_to_radiator", 14, 0.34, 475.0, 24.0, 0.0, 24.0, 0.36),
    RingSection("radiator", 8, 0.42, 1300.0, 230.0, 0.70, 16.0, 0.0),
    RingSection("pipe_to_tank", 20, 0.50, 700.0, 35.0, 0.0, 35.0, 0.50),
    RingSection("tank", 2, 37.85, 8200.0, 160.0, 0.2, 90.0, 2.10),
)
"""Hose films are governed by half the hose wall, hence independent of flow."""

PIPES = ("pipe_to_heater", "pipe_to_modules", "pipe_to_radiator", "pipe_to_tank")
MODULES = ("pm1", "pm2", "pm3", "pm4", "pm5", "pm6")
PLACES = ("heater", "modules", "radiator", "tank", *MODULES, *PIPES)
"""Places of effects."""

TANK_UPPER_SHARE = 0.2
"""The return hose enters an upper zone; the pump draws from the lower one, where the thermocouple hangs."""
MODULE_MASS = (1.0, 1.06, 0.95, 1.02, 0.97, 1.0)
MODULE_FILM = (1.0, 0.94, 1.07, 1.03, 0.91, 1.05)
MODULE_LOSS = (1.15, 0.92, 1.0, 0.95, 1.04, 0.94)
"""Relative scatter among the six plates (mass, film, loss)."""

CHANNELS = (
    "T_heater_C",
    "T_pm1_C",
    "T_pm2_C",
    "T_pm3_C",
    "T_pm4_C",
    "T_pm5_C",
    "T_pm6_C",
    "T_radiator_C",
    "T_tank_C",
)
JUNCTION_LAG_S = (3.0, 5.0, 5.5, 5.0, 4.6, 5.2, 5.0, 3.2, 6.0)
"""First-order lag of each thermocouple with its sheath and paste."""

MAX_HEATER_W = 1000.0


def section_cells(name: str) -> slice:
    """Return the cells of a section, or of a place of `PLACES`; raise KeyError for another name."""
    if name in MODULES:
        start = section_cells("modules").start + MODULES.index(name)
        return slice(start, start + 1)
    first = 0
    for section in SECTIONS:
        if section.name == name:
            return slice(first, first + section.cells)
        first += section.cells
    raise KeyError(name)


CELLS = sum(section.cells for section in SECTIONS)


class Cells(NamedTuple):
    """Per-cell constants of the ring, each of shape (CELLS,) but `section` and the last two, (len(SECTIONS),)."""

    water_kg: Array
    solid_J_per_K: Array
    film: Array
    film_floor: Array
    outer: Array
    section: NDArray[np.int64]
    film_exponent: Array
    first_cell: NDArray[np.int64]


def build_cells() -> Cells:
    """Cut the sections into cells. Water mass is taken at 30 degC; expansion goes to the tank's head space."""
    columns: list[list[float]] = [[], [], [], [], []]
    index: list[int] = []
    for number, section in enumerate(SECTIONS):
        shares = np.full(section.cells, 1.0 / section.cells)
        if section.name == "tank":
            shares = np.array([TANK_UPPER_SHARE, 1.0 - TANK_UPPER_SHARE])
        scatter = np.ones((5, section.cells))
        if section.name == "modules":
            scatter[1], scatter[2], scatter[4] = MODULE_MASS, MODULE_FILM, MODULE_LOSS
            scatter[3] = scatter[2]
        totals = (
            section.water_L * 0.99565,
            section.solid_J_per_K,
            section.film_W_per_K,
            section.film_floor_W_per_K,
            section.outer_W_per_K,
        )
        for column, total, relative in zip(columns, totals, scatter, strict=True):
            column.extend((total * shares * relative).tolist())
        index.extend([number] * section.cells)
    first = np.cumsum([0] + [section.cells for section in SECTIONS[:-1]])
    water, solid, film, film_floor, outer = (np.array(column) for column in columns)
    return Cells(
        water_kg=water,
        solid_J_per_K=solid,
        film=film,
        film_floor=film_floor,
        outer=outer,
        section=np.array(index, dtype=np.int64),
        film_exponent=np.array([section.film_exponent for section in SECTIONS]),
        first_cell=first.astype(np.int64),
    )
