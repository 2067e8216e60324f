"""Redundancy checks of a cell's minutes: laws that tie two measured quantities together."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from twin.historian.tags import Array

FAN_LAW, PUMP_WORK, BELOW_WET_BULB, ABOVE_INLET = 1, 2, 4, 8
"""Bits of the column `check`."""
FAN_APART = 0.25
"""Share of the power at full speed by which power may differ from the cube of the speed (density, blade pitch,
belts)."""
PUMP_APART = 0.35
"""Share of the usual pump work per flow and head; cells of a station share the pumps unevenly."""
THERMOMETER_K = 1.0
"""Bias of a thermometer that is no contradiction yet: the bound of the paper."""
SETTLED_MIN = 30
"""Minutes of flow before an outlet is held against inlet and wet bulb."""
NAMES = {
    FAN_LAW: "fan power is not that of its speed",
    PUMP_WORK: "pump power is not that of flow and pressure",
    BELOW_WET_BULB: "the outlet is below the wet bulb",
    ABOVE_INLET: "the outlet is above the inlet",
}
COMPARED = {
    FAN_LAW: ("fan_speed_pct", "fan_power_kW"),
    PUMP_WORK: ("pump_kW", "m_w_kg_s", "header_kPa"),
    BELOW_WET_BULB: ("t_out_C", "wet_C"),
    ABOVE_INLET: ("t_out_C", "t_in_C"),
}
"""Columns that a check compares."""


def check_flags(
    columns: Mapping[str, NDArray[np.generic]], minute_s: NDArray[np.float64] | None = None
) -> tuple[NDArray[np.uint8], list[str]]:
    """Return the failed checks of each minute as bits (n,), and a sentence for each check that fails often.

    Parameters
    ----------
    minute_s
        Beginning of each minute, s since 1970, for the sentences.
    """
    c = {name: np.asarray(values, dtype=np.float64) for name, values in columns.items() if values.dtype.kind == "f"}
    n = len(c["t_out_C"])
    flags = np.zeros(n, dtype=np.uint8)
    flags[_fan_law(c["fan_speed_pct"], c["fan_power_kW"])] |= FAN_LAW
    flags[_pump_work(c["pump_kW"], c["m_w_kg_s"], c["header_kPa"])] |= PUMP_WORK
    settled = _settled(c["m_w_kg_s"])
    wet = np.where(np.isfinite(c["wet_C"]), c["wet_C"], c["wet_rh_C"])
    flags[settled & (np.nan_to_num(wet - c["t_out_C"], nan=-9.0) > THERMOMETER_K)] |= BELOW_WET_BULB
    flags[settled & (np.nan_to_num(c["t_out_C"] - c["t_in_C"], nan=-9.0) > THERMOMETER_K)] |= ABOVE_INLET
    remarks = []
    for bit, text in NAMES.items():
        share = float(((flags & bit) > 0).mean())
        if share > 0.02:
            first = int(np.flatnonzero(flags & bit)[0])
            when = "" if minute_s is None else f" ({np.datetime64(int(minute_s[first]), 's')}Z)"
            remarks.append(
                f"{text} in {100 * share:.0f} % of the minutes, first in row {first + 1}{when}; check the tags of "
                f"{' and '.join(COMPARED[bit])} for a swap, a wrong unit or a fault"
            )
    return flags, remarks


def _fan_law(speed: Array, power: Array) -> NDArray[np.bool_]:
    """Return minutes whose fan power is not c n^3; c is the median of those at work."""
    cube = (speed / 100.0) ** 3
    at_work = np.isfinite(cube) & np.isfinite(power) & (cube > 0.05)
    if at_work.sum() < 100:
        return np.zeros(len(speed), dtype=bool)
    full = float(np.median(power[at_work] / cube[at_work]))
    return np.asarray(np.nan_to_num(np.abs(power - full * cube)) > FAN_APART * abs(full))


def _pump_work(power: Array, flow: Array, head: Array) -> NDArray[np.bool_]:
    """Return minutes with flow and no pump power, or pump power per flow and pressure far from its median."""
    usual_flow = float(np.nanquantile(flow, 0.95)) if np.isfinite(flow).any() else 0.0
    usual_power = float(np.nanquantile(power, 0.95)) if np.isfinite(power).any() else 0.0
    if usual_flow <= 0.0 or usual_power <= 0.0:
        return np.zeros(len(flow), dtype=bool)
    idle = (np.nan_to_num(flow) > 0.3 * usual_flow) & (np.nan_to_num(power, nan=usual_power) < 0.02 * usual_power)
    at_work = (flow > 0.3 * usual_flow) & (head > 0.0)
    work = np.where(at_work, power / np.where(at_work, flow * head, 1.0), np.nan)
    usual = float(np.nanmedian(work)) if np.isfinite(work).any() else np.nan
    return np.asarray(idle | (np.nan_to_num(np.abs(work / usual - 1.0)) > PUMP_APART + 1.0))


def _settled(flow: Array) -> NDArray[np.bool_]:
    """Return minutes with flow through all of the last `SETTLED_MIN`."""
    usual = float(np.nanquantile(flow, 0.95)) if np.isfinite(flow).any() else 0.0
    flowing = np.nan_to_num(flow) > 0.2 * max(usual, 1e-9)
    index = np.arange(len(flow))
    last = np.maximum.accumulate(np.where(flowing, -1, index))
    return np.asarray(flowing & (index - last > SETTLED_MIN))
