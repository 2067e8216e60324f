"""Tracking of one campaign by one calibrator: errors, recovery, place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.bench.experiments.campaigns import Campaign
from twin import Array, Network, TwinTracker, right_hand_side
from twin.calibrators import Calibration

EDGE = 60
"""Samples averaged at either end of a window for the change of stored heat."""
IN_A_ROW = 2
"""Windows that must stay below the threshold for a recovery to count."""


@dataclass(frozen=True, slots=True)
class Tracked:
    """Result of a tracker.

    Attributes
    ----------
    rmse
        Sensor -> K, rows `static`, `tracked` (predicted ahead), `fitted` (same window).
    static, ahead
        (n, m) degC, predictions of both twins.
    calibrations
        Of all windows.
    threshold_K
        Error below which a window is calibrated.
    """

    rmse: dict[str, dict[str, float]]
    static: Array
    ahead: Array
    calibrations: tuple[Calibration, ...]
    threshold_K: float

    def row(self, kind: str) -> tuple[float, ...]:
        """Return the RMSE of one kind at every sensor, K."""
        return tuple(sensor[kind] for sensor in self.rmse.values())

    def pooled(self, kind: str) -> float:
        """Return the RMSE of one kind over all sensors, K."""
        return float(np.sqrt(np.mean(np.square(self.row(kind)))))


def follow(network: Network, campaign: Campaign, calibrator: str, seed: int) -> Tracked:
    """Track the whole campaign with a twin that starts as `network`."""
    tracker = TwinTracker(network, calibrator, seed=seed)
    update = tracker.push(campaign.time, campaign.inputs, campaign.measured)
    return Tracked(tracker.table(), update.static, update.tracked, update.calibrations, network.rules.calibrated_K)


def windows_to_recover(calibrations: list[Calibration], threshold_K: float, *, ahead: bool) -> int | None:
    """Return the number of windows until the error stays below the threshold, the first after the change counting as 1.

    Parameters
    ----------
    ahead
        Judge the prediction, made before the window was seen, rather than the fit.
    """
    below = [(c.error_before_K if ahead else c.error_K) < threshold_K for c in calibrations]
    for k in range(len(below)):
        if all(below[k : k + IN_A_ROW]):
            return k + 1
    return None


def after(calibrations: tuple[Calibration, ...], onset_s: float) -> list[Calibration]:
    """Return the windows that begin at the change or later, with half a minute of settling allowed in the first."""
    return [c for c in calibrations if c.start_s >= onset_s - 1.0 and c.kind != "skipped"]


def first_error(campaign: Campaign, tracked: Tracked, window: Calibration) -> str:
    """Return the sensor with the largest prediction error, with its error in K, in the first window after a change."""
    rows = slice(*np.searchsorted(campaign.time, [window.start_s, window.end_s + 0.5]))
    error = np.sqrt(np.nanmean((tracked.ahead[rows] - campaign.measured[rows]) ** 2, axis=0))
    return campaign.commissioned.sensor_names[int(np.nanargmax(error))]


def heat_balance(campaign: Campaign) -> tuple[Array, Array]:
    """Return the heat in W that the twin lacks in the first window after the change, by volume, and its z.

        E_j = C_j dT_j/dt - (heat into j by the twin's formulas at the measured temperatures)

    averaged over a window, minus what the healthy windows before show; z is in their standard deviations. No
    calibrator takes part. It knows volumes with a thermometer of their own only: for the others NaN.
    """
    network = campaign.commissioned
    length = network.rules.window_s
    starts = np.arange(campaign.onset_s - 12 * length, campaign.onset_s + 0.5 * length, length)
    balances = np.array([_residual_power(campaign, start, start + length) for start in starts if start > 0.0])
    before, now = balances[:-1], balances[-1]
    spread = np.maximum(before.std(axis=0, ddof=1), 1e-9)
    return now - before.mean(axis=0), (now - before.mean(axis=0)) / spread


def _residual_power(campaign: Campaign, start_s: float, end_s: float) -> Array:
    network = campaign.commissioned
    rows = slice(*np.searchsorted(campaign.time, [start_s, end_s]))
    time, inputs, y = campaign.time[rows], campaign.inputs[rows], campaign.measured[rows]
    state = np.full((len(time), len(network.nodes)), np.nan)
    for j, sensor in enumerate(network.sensors):
        state[:, network.nodes.index(sensor.node)] = y[:, j]
    edge = min(EDGE, max(len(time) // 4, 1))
    step_s = float(time[-edge:].mean() - time[:edge].mean())
    rate = (np.nanmean(state[-edge:], axis=0) - np.nanmean(state[:edge], axis=0)) / step_s
    rhs, values = right_hand_side(network), network.values
    every = slice(edge // 2, len(time) - edge // 2, 5)
    model = np.mean([rhs(x, u, values) for x, u in zip(state[every], inputs[every], strict=True)], axis=0)
    capacity = np.array([network.parameters[f"{node}.capacitance"].value for node in network.nodes])
    power: Array = capacity * (rate - model)
    return power
