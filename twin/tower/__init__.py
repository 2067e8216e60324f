"""Cooling-tower cell: moist air, Merkel's method with four deviations, and its calibration.

The deviations multiply a clean cell: `fill` its Merkel number, `air` its air flow at full speed, `uniformity` the
wetted share of its plan. `bias` is that of the outlet thermometer, K.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin.lazy_names import lazy_names

if TYPE_CHECKING:
    from twin.tower.air import SEA_LEVEL_KPA, Array, wet_bulb
    from twin.tower.calibration.baselines import BASELINES, CellDataset, split, without_discrepancy
    from twin.tower.calibration.cell_fit import Calibrated, CalibrationError, Fitted, fit_cell, predict_cell
    from twin.tower.calibration.outlet_interval import NORMAL, QUANTILE, WET_C, WINDOW_S
    from twin.tower.cell import CellDeviations, Inputs, solve_cell
    from twin.tower.cell_observations.evidence import Label
    from twin.tower.change_detection.changes import undeclared_changes
    from twin.tower.change_detection.steps import Step, find_steps
    from twin.tower.clean_cell.commissioning import CommissionedCell, CommissioningError, TestPoints, fit_clean_cell
    from twin.tower.diagnosis.adoption import adopted, effects_of
    from twin.tower.effects import UNITS, CellEffect
    from twin.tower.estimates import DAY_S, WALK, Opening, Priors, moved_grid, time_grid
    from twin.tower.identifiability.identify import MOST_CONDITION, MOST_HIDDEN, Identifiability, condition_text
    from twin.tower.identifiability.planning import StepTest, model_sensitivities, plan_tests
    from twin.tower.minutes import MEASURED, Minutes, blocks_of, first_order_lag, minutes_of
    from twin.tower.model import (
        ANY_DRAUGHT,
        DEVIATIONS,
        FAN_DENSITY,
        FORCED,
        INDUCED,
        NAMES,
        SLOW,
        CellModel,
        DesignPoint,
    )
    from twin.tower.recursive import Recursion, filter_cell
    from twin.tower.shared_observations.basin import Drain, with_basin
    from twin.tower.shared_observations.evaporation import Balance, with_evaporation
    from twin.tower.smoother import estimate
    from twin.tower.twin_file import (
        BOUNDS,
        IDS,
        cell_network,
        cell_of,
        design_of,
        site_pressure_of,
        station_of_twin,
        value_of,
    )
    from twin.tower.windows import CONTEXT_S, TargetWindow, novelty, windows_of


__all__ = [
    "ANY_DRAUGHT",
    "BASELINES",
    "BOUNDS",
    "CONTEXT_S",
    "DAY_S",
    "DEVIATIONS",
    "FAN_DENSITY",
    "FORCED",
    "IDS",
    "INDUCED",
    "MEASURED",
    "MOST_CONDITION",
    "MOST_HIDDEN",
    "NAMES",
    "NORMAL",
    "QUANTILE",
    "SEA_LEVEL_KPA",
    "SLOW",
    "UNITS",
    "WALK",
    "WET_C",
    "WINDOW_S",
    "Array",
    "Balance",
    "Calibrated",
    "CalibrationError",
    "CellDataset",
    "CellDeviations",
    "CellEffect",
    "CellModel",
    "CommissionedCell",
    "CommissioningError",
    "DesignPoint",
    "Drain",
    "Fitted",
    "Identifiability",
    "Inputs",
    "Label",
    "Minutes",
    "Opening",
    "Priors",
    "Recursion",
    "Step",
    "StepTest",
    "TargetWindow",
    "TestPoints",
    "adopted",
    "blocks_of",
    "cell_network",
    "cell_of",
    "condition_text",
    "design_of",
    "effects_of",
    "estimate",
    "filter_cell",
    "find_steps",
    "first_order_lag",
    "fit_cell",
    "fit_clean_cell",
    "minutes_of",
    "model_sensitivities",
    "moved_grid",
    "novelty",
    "plan_tests",
    "predict_cell",
    "site_pressure_of",
    "solve_cell",
    "split",
    "station_of_twin",
    "time_grid",
    "undeclared_changes",
    "value_of",
    "wet_bulb",
    "windows_of",
    "with_basin",
    "with_evaporation",
    "without_discrepancy",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "air": ("Array", "SEA_LEVEL_KPA", "wet_bulb"),
        "calibration.baselines": ("BASELINES", "CellDataset", "split", "without_discrepancy"),
        "calibration.cell_fit": ("Calibrated", "CalibrationError", "Fitted", "fit_cell", "predict_cell"),
        "calibration.outlet_interval": ("NORMAL", "QUANTILE", "WET_C", "WINDOW_S"),
        "cell": ("CellDeviations", "Inputs", "solve_cell"),
        "cell_observations.evidence": ("Label",),
        "change_detection.changes": ("undeclared_changes",),
        "change_detection.steps": ("Step", "find_steps"),
        "clean_cell.commissioning": ("CommissionedCell", "CommissioningError", "TestPoints", "fit_clean_cell"),
        "diagnosis.adoption": ("adopted", "effects_of"),
        "effects": ("CellEffect", "UNITS"),
        "estimates": ("DAY_S", "Opening", "Priors", "WALK", "moved_grid", "time_grid"),
        "identifiability.identify": ("Identifiability", "MOST_CONDITION", "MOST_HIDDEN", "condition_text"),
        "minutes": ("MEASURED", "Minutes", "blocks_of", "first_order_lag", "minutes_of"),
        "model": (
            "ANY_DRAUGHT",
            "CellModel",
            "DEVIATIONS",
            "DesignPoint",
            "FAN_DENSITY",
            "FORCED",
            "INDUCED",
            "NAMES",
            "SLOW",
        ),
        "identifiability.planning": ("StepTest", "model_sensitivities", "plan_tests"),
        "recursive": ("Recursion", "filter_cell"),
        "shared_observations.basin": ("Drain", "with_basin"),
        "shared_observations.evaporation": ("Balance", "with_evaporation"),
        "smoother": ("estimate",),
        "twin_file": (
            "BOUNDS",
            "IDS",
            "cell_network",
            "cell_of",
            "design_of",
            "site_pressure_of",
            "station_of_twin",
            "value_of",
        ),
        "windows": ("CONTEXT_S", "TargetWindow", "novelty", "windows_of"),
    },
)
