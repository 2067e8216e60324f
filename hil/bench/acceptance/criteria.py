"""Criteria of acceptance: metric, figure of the paper, our gate and class of each row.

The paper is "Record-driven calibration of cooling-tower performance digital twins using Hiera-UNet" (2023). Class S
can be shown on simulated stations, P in part or by an analogue, N not without the paper's plant. A figure of the
paper is a target of form: no simulated station can confirm it.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Criterion:
    """Row of the acceptance table, or one metric of a row that has several."""

    row: str
    metric: str
    paper: str
    gate: str
    kind: str


def _rows(*found: tuple[str, str, str, str, str, str]) -> dict[str, Criterion]:
    return {key: Criterion(*rest) for key, *rest in found}


CRITERIA: dict[str, Criterion] = _rows(
    ("commissioned", "A1", "outlet MAE / RMSE K, commissioned twin, mixed test", "1.18 / 1.54", "MAE 1.0 to 1.4", "S"),
    ("least squares", "A2", "outlet MAE K, monthly least squares", "0.72", "same windows, 3 seeds", "S"),
    ("forest", "A2", "outlet MAE K, random forest", "0.49", "same windows, 3 seeds", "S"),
    ("bilstm", "A2", "outlet MAE K, BiLSTM", "0.43", "same windows, 3 seeds", "S"),
    ("unet", "A2", "outlet MAE K, temporal U-Net", "0.37", "same windows, 3 seeds", "S"),
    ("transformer", "A2", "outlet MAE K, flat transformer", "0.35", "same windows, 3 seeds", "S"),
    ("tcn", "A2", "outlet MAE K, TCN", "-", "same windows, 3 seeds", "S"),
    ("newton", "A2", "outlet MAE K, Gauss-Newton with discrepancy", "-", "same windows, 3 seeds", "S"),
    ("persistence", "A2", "outlet MAE K, persistence", "-", "same windows, 3 seeds", "S"),
    ("network", "A3", "outlet MAE / RMSE K, Hiera-UNet", "0.24 / 0.34", "MAE <= 0.24 with readings hidden", "S"),
    ("network gain", "A3", "outlet error against the boosted rival", "-", "-10 %, interval below 0", "S"),
    ("approach", "A4", "approach MAE K", "1.09 to 0.27", "<= 0.27", "S"),
    ("effectiveness", "A4", "effectiveness MAE, points", "4.8 to 1.3", "<= 1.3", "S"),
    ("cross outlet", "A5", "outlet and approach MAE K, another site", "0.29 / 0.31", "<= 0.29, site's own before", "S"),
    ("cross effectiveness", "A5", "effectiveness MAE, points, another site", "1.6", "<= 1.6", "S"),
    ("quantiles", "A6", "outlet error p90 / p99 K", "0.48 / 1.07", "reported", "S"),
    ("median", "A6", "signed median of the outlet error K", "0.03", "within 0.05", "S"),
    ("cells", "A7", "outlet MAE K by cell, best to worst", "0.21 to 0.32", "worst <= 0.35", "S"),
    ("hot", "A8", "outlet within 0.5 K above 26 degC wet bulb", "98 %", ">= 95 %", "S"),
    ("heat", "A9", "rejected heat, mean / p95 error %", "2.2 / 4.9", "<= 2.2 / 4.9", "P"),
    ("bias", "A10", "thermometer bias MAE K", "0.12", "<= 0.12", "S"),
    ("bias sign", "A10", "sign of the bias right, condition number <= 80", "98.6 %", ">= 98 %", "S"),
    ("deviations", "A11", "fill / air / uniformity MAE %", "4.1 / 3.6 / 5.4", "<= 4.1 / 3.6 / 5.4", "S"),
    ("seeds", "A12", "standard deviation of the fill between seeds %", "0.8", "<= 0.8", "S"),
    ("ablations", "A13", "outlet MAE K without each part, another site", "0.32 to 0.41", "same sign, 3 seeds", "S"),
    ("counterfactual", "A14", "sign of the outlet's answer to the fan right", "99.1 %", ">= 99.1 %", "S"),
    ("coverage", "A15", "90 % intervals of outlet and approach hold, network", "91.3 / 89.7 %", "88.5 to 91.5 %", "S"),
    ("coverage smoothed", "A15", "the same, calibration over the record", "-", "88.5 to 91.5 %", "S"),
    ("ece", "A15", "calibration error of the outlet's levels", "0.026", "<= 0.026", "S"),
    ("width", "A16", "mean width K of the outlet's interval, network", "0.74", ">= 4.12 MAE", "P"),
    ("width smoothed", "A16", "the same, calibration over the record", "-", ">= 4.12 MAE", "P"),
    ("ramp", "A17", "fill loss of 12 % in 30 days: value, delay", "11.3 %; 4.6 d", "12 +- 1.5 %; <= 4.6 d", "S"),
    ("step", "A18", "step of 0.5 K found within 18 min", "18 min", "200 of 200 trials", "S"),
    ("step called fouling", "A18", "the same step called a change of the cell", "-", "0 of 200 trials", "S"),
    ("cleaning", "A19", "nozzle cleaning visible in 3 excited windows", "0.86 to 0.95", "uniformity alone moves", "P"),
    ("withheld", "A20", "windows that the gates withhold", "6.8 %", "<= 10 %", "S"),
    ("withheld error", "A20", "outlet MAE K of accepted / withheld windows", "0.25 / 0.71", "ratio >= 2", "S"),
    ("proposals", "A21", "persistent proposals confirmed / open / false", "35 / 4 / 3 of 42", "precision >= 0.9", "P"),
    ("review", "A22", "time of an engineer's review", "3.8 min", "-", "N"),
    ("latency", "A23", "forward of the full network, one core ms", "214 (8 cores)", "<= 107", "S"),
    ("memory", "A23", "peak memory of that forward GB", "2.7", "<= 1", "S"),
    ("record", "A24", "records of a cell MB a year", "46", "<= 46", "S"),
    ("sizes", "A25", "outlet MAE K by size of the network", "+0.01", "1.06 / 10.6 / 18.6 M", "P"),
    ("loop gain", "A26", "loop: least gain in RMSE at four sensors %", "93 / 95 / 96 / 93", ">= 93 each", "S"),
    ("loop recovery", "A26", "loop: windows to recover after a change", "2", "<= 2", "S"),
    ("merkel", "A27", "Merkel's integral against Baker and Shryock, largest error %", "-", "<= 1.5", "S"),
    ("energyplus", "A27", "held-out outlet of EnergyPlus's tower, largest error K", "-", "<= 0.05", "S"),
    ("undeclared", "A28", "undeclared effect named, with MAE before and after", "-", "right term, p < 0.01", "S"),
)
