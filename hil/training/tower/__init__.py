"""Training of the network calibrator for cooling-tower cells, on simulated stations alone.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.training.tower.ensemble import assemble
    from hil.training.tower.evaluate import BOOSTED, ENSEMBLE, GAUSS_NEWTON
    from hil.training.tower.evaluate import evaluate as score_members
    from hil.training.tower.generate import DataPlan
    from hil.training.tower.selftest import random_table
    from hil.training.tower.session import TowerProgress, simulate_stations, train_member
    from hil.training.tower.stations import StationPlan, station_cells, table_of
    from hil.training.tower.unpack import judged_cards

__all__ = [
    "BOOSTED",
    "ENSEMBLE",
    "GAUSS_NEWTON",
    "DataPlan",
    "StationPlan",
    "TowerProgress",
    "assemble",
    "judged_cards",
    "random_table",
    "score_members",
    "simulate_stations",
    "station_cells",
    "table_of",
    "train_member",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "ensemble": ("assemble",),
        "evaluate": ("BOOSTED", "ENSEMBLE", "GAUSS_NEWTON", "score_members = evaluate"),
        "generate": ("DataPlan",),
        "selftest": ("random_table",),
        "session": ("TowerProgress", "simulate_stations", "train_member"),
        "stations": ("StationPlan", "station_cells", "table_of"),
        "unpack": ("judged_cards",),
    },
)
