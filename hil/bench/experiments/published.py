"""Published figures of Energies 2026, 19, 2452 for the experiments, in K."""

from __future__ import annotations

PLACES = ("heater", "modules", "radiator", "tank")
STATIC_RMSE_K = (0.708, 0.511, 0.562, 0.318)
"""Table 3: the manually tuned twin over 40 h."""
TRACKED_RMSE_K = (0.051, 0.024, 0.071, 0.021)
"""Table 4, with the radiator's RMSE as its MSE of 0.005 gives it; the paper prints 0.024, below the MAE of 0.048."""
TABLE_4_NOTE = (
    "Paper, radiator: Table 4 prints RMSE 0.024 below MAE 0.048, which cannot be; its MSE of 0.005 gives 0.071, "
    "an improvement of 87 %, not 96 %."
)
ONSET_S = 12_600.0
"""Onset of every change of section 3, s: three and a half hours."""
RANDOMISED_WINDOWS = 2
"""Windows until the twin with random parameters is back at its initial accuracy, section 3.1."""
INITIAL_ACCURACY_K = 0.54
"""Initial accuracy, K: Table 3 over all four points."""
