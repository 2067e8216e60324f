"""Degradation of the cells day by day, what is done about it, and what people find out.

Scale takes 0.2 to 0.6 % of the fill a week, nozzles plug, belts slip, eliminators clog, thermometers and flow meters
drift. Cleaning, maintenance and replacement restore a part of it. Entries of maintenance carry a day that is up to
three days off; some are missing. A plan may add ramps to it: a loss of fill within a month, nozzles that plug and are
cleaned.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.virtual.tower.physics import S_BLOCKAGE, S_FILL, S_PITCH, S_SLIP, S_UNIFORMITY, STATE
from drivers.virtual.tower.records import Happening, InspectionLabel
from drivers.virtual.tower.sites import BuiltStation

Array = NDArray[np.float64]
MINUTES_A_DAY = 1440
WORK_HOUR_UTC = 15
LONG_MONTHS = 6.0
"""From this length a record begins with a plant fresh from cleaning, so that it holds a healthy part; a shorter one
begins anywhere between two cleanings."""
CLEAN_EVERY_D = 150.0
MOST_BIAS_K = 0.8
"""Bias at which operators have a thermometer exchanged."""
WRITTEN = 0.88
"""Share of maintenance work that has an entry."""


@dataclass(frozen=True, slots=True)
class Ramp:
    """Change of a cell's degradation that a plan adds to what its seed draws: a line between two days, kept afterwards.

    Attributes
    ----------
    cell
        Numbered from 1.
    state
        Name among `STATE`.
    first, end
        Days of the simulation at which it begins and ends.
    change
        Of the state, share of the clean value.
    event
        Class of the maintenance entry at its end, such as nozzle_cleaning; "" for none.
    """

    cell: int
    state: str
    first: int
    end: int
    change: float
    event: str = ""


@dataclass(frozen=True)
class Life:
    """States by day (days, cells, states), thermometers' bias K and flow meters' gain by day (days, cells), and
    records."""

    states: Array
    bias: Array
    flow_gain: Array
    happenings: tuple[Happening, ...]
    labels: tuple[InspectionLabel, ...]


def live(
    built: BuiltStation,
    days: int,
    rng: np.random.Generator,
    outlet_tag: Callable[[int], str],
    ramps: Sequence[Ramp] = (),
) -> Life:
    """Return `days` days of degradation (two more rows than days), drawn by `rng`, with ramps; `outlet_tag` names a
    thermometer.

    Raises
    ------
    ValueError
        A ramp is of no cell or state of the station, or does not end after it begins.
    """
    cells, rows = built.site.cells, days + 2
    states, bias, gain = np.zeros((rows, cells, len(STATE))), np.zeros((rows, cells)), np.ones((rows, cells))
    happenings: list[Happening] = []
    for cell in range(cells):
        states[:, cell], done = _cell(rows, cell, rng)
        bias[:, cell], replaced = _thermometer(rows, cell, rng, outlet_tag(cell))
        gain[:, cell] = 1.0 + rng.normal(0.0, 0.006) + np.cumsum(rng.normal(0.0, 1.2e-4, rows))
        happenings += done + replaced
    for ramp in ramps:
        happenings += _add(ramp, states)
    labels, found = _found(built, states, bias, days, rng)
    return Life(states, bias, gain, tuple(happenings + found), tuple(labels))


def _add(ramp: Ramp, states: Array) -> list[Happening]:
    """Add a ramp to the states by day (days, cells, states) and return its entry, if it has one."""
    if ramp.state not in STATE or not 1 <= ramp.cell <= states.shape[1] or not ramp.first < ramp.end:
        raise ValueError(
            f"{ramp}: cannot be added; give a cell from 1 to {states.shape[1]}, a state among {', '.join(STATE)}, and "
            "an end after the first day"
        )
    share = np.clip((np.arange(len(states)) - ramp.first) / (ramp.end - ramp.first), 0.0, 1.0)
    states[:, ramp.cell - 1, STATE.index(ramp.state)] += ramp.change * share
    if not ramp.event:
        return []
    text = f"Cell {ramp.cell}: {ramp.event.replace('_', ' ')}"
    return [Happening(ramp.end * MINUTES_A_DAY, ramp.cell, "CMMS", ramp.event, text)]


def _cell(rows: int, cell: int, rng: np.random.Generator) -> tuple[Array, list[Happening]]:
    """Return the states of a cell by day, and what is done."""
    fresh = rows / 30.4 >= LONG_MONTHS
    week_share = np.array(
        [
            rng.uniform(0.002, 0.006),
            rng.uniform(0.0008, 0.0030),
            0.0,
            rng.uniform(0.0002, 0.0012),
            rng.uniform(0.0005, 0.0025),
        ]
    )
    age = (rng.uniform(0.0, 3.0) if fresh else rng.uniform(8.0, 34.0)) * week_share
    slip = rng.uniform(0.0, 0.004) if fresh else rng.uniform(0.0, 0.02)
    pitch, blocked = (rng.uniform(0.0, 0.01), 0.0) if fresh else (rng.uniform(0.02, 0.12), rng.uniform(0.0, 0.1))
    state = np.array([1.0 - age[0], 1.0 - age[1], slip, pitch + age[3], blocked + age[4]])
    out, done = np.empty((rows, len(STATE))), []
    clean_in = rng.uniform(0.35, 1.0) * CLEAN_EVERY_D
    work_in, slip_in = rng.uniform(60.0, 260.0), rng.exponential(120.0)
    for day in range(rows):
        out[day] = state
        daily = week_share / 7.0 * np.exp(0.5 * rng.normal(size=len(STATE)))
        state = state + np.array([-daily[0], -daily[1], 0.0, daily[3], daily[4]])
        clean_in, work_in, slip_in = clean_in - 1.0, work_in - 1.0, slip_in - 1.0
        minute = (day + 1) * MINUTES_A_DAY
        if slip_in < 0.0:
            state[S_SLIP], slip_in = state[S_SLIP] + rng.uniform(0.005, 0.02), rng.exponential(120.0)
        if clean_in < 0.0:
            state[S_FILL] += rng.uniform(0.7, 0.95) * (1.0 - state[S_FILL])
            state[S_UNIFORMITY] += rng.uniform(0.7, 0.95) * (1.0 - state[S_UNIFORMITY])
            text = f"Cell {cell + 1}: fill washed, nozzles cleaned"
            done.append(Happening(minute, cell + 1, "CMMS", "cleaning", text))
            clean_in = rng.uniform(0.8, 1.3) * CLEAN_EVERY_D
        elif state[S_UNIFORMITY] < 0.90:
            state[S_UNIFORMITY] += rng.uniform(0.6, 0.9) * (1.0 - state[S_UNIFORMITY])
            text = f"Cell {cell + 1}: nozzles cleaned"
            done.append(Happening(minute, cell + 1, "CMMS", "nozzle_cleaning", text))
        if work_in < 0.0:
            state[S_SLIP] *= 0.1
            state[S_PITCH] *= rng.uniform(0.1, 0.4)
            state[S_BLOCKAGE] *= rng.uniform(0.2, 0.6)
            text = f"Cell {cell + 1}: fan belt renewed, blade pitch set, drift eliminators cleaned"
            done.append(Happening(minute, cell + 1, "CMMS", "fan_maintenance", text))
            work_in = rng.uniform(140.0, 260.0)
    return out, done


def _thermometer(rows: int, cell: int, rng: np.random.Generator, tag: str) -> tuple[Array, list[Happening]]:
    """Return the bias of the outlet thermometer by day, K: a walk, steps that nobody announces, and replacements."""
    step_in, replace_in = rng.exponential(90.0), rng.exponential(160.0)
    value = rng.normal(0.0, 0.15)
    out, done = np.empty(rows), []
    for day in range(rows):
        out[day] = value
        value += rng.normal(0.0, 0.012)
        step_in, replace_in = step_in - 1.0, replace_in - 1.0
        if step_in < 0.0:
            value, step_in = value + rng.choice([-1.0, 1.0]) * rng.uniform(0.25, 0.6), rng.exponential(90.0)
        if replace_in < 0.0 or abs(value) > MOST_BIAS_K:
            value, replace_in = rng.normal(0.0, 0.06), rng.exponential(160.0)
            text = f"Transmitter of {tag} exchanged for a new one"
            done.append(Happening((day + 1) * MINUTES_A_DAY, cell + 1, "CMMS", "instrument_work", text))
    return out, done


def _found(
    built: BuiltStation, states: Array, bias: Array, days: int, rng: np.random.Generator
) -> tuple[list[InspectionLabel], list[Happening]]:
    """Return what inspections, traverses and reference thermometers find, and their entries."""
    labels, found = [], []
    for cell in range(built.site.cells):
        for event, every in (("inspection", 32.0), ("airflow_traverse", 48.0), ("reference_thermometer", 55.0)):
            for at in np.arange(rng.uniform(0.15, 0.85) * min(every, days), days - 2, every):
                day = int(at)
                minute = day * MINUTES_A_DAY + WORK_HOUR_UTC * 60
                state = states[day] + WORK_HOUR_UTC / 24.0 * (states[day + 1] - states[day])
                if event == "inspection":
                    text = f"Cell {cell + 1}: internal inspection, see report"
                    fill, even = float(state[cell, S_FILL]), built.uniformity(cell, state[cell])
                    labels.append(
                        _interval(minute, cell, "fill", fill, 0.038, "inspection, scale on samples of fill", rng)
                    )
                    if rng.random() < 0.6:
                        labels.append(
                            _interval(minute, cell, "uniformity", even, 0.03, "inspection, nozzles counted", rng)
                        )
                elif event == "airflow_traverse":
                    text = f"Cell {cell + 1}: portable air-flow traverse"
                    value = round(built.air_multiplier(cell, state[cell]) * (1.0 + rng.normal(0.0, 0.02)), 3)
                    labels.append(InspectionLabel(minute, cell + 1, "air", "portable traverse", value, 0.02))
                else:
                    text = f"Cell {cell + 1}: calibrated reference thermometer beside the outlet RTD for two days"
                    value = round(float(bias[day : day + 2, cell].mean() + rng.normal(0.0, 0.04)), 2)
                    labels.append(
                        InspectionLabel(
                            minute, cell + 1, "bias", "reference thermometer, mean of two days", value, 0.05
                        )
                    )
                found.append(Happening(minute, cell + 1, "CMMS", event, text))
    return labels, found


def _interval(
    minute: int, cell: int, name: str, true: float, half: float, source: str, rng: np.random.Generator
) -> InspectionLabel:
    """Return an interval that holds the true value in nine of ten cases."""
    middle = (
        true
        + (rng.uniform(-0.7, 0.7) if rng.random() < 0.9 else rng.choice([-1.0, 1.0]) * rng.uniform(1.0, 1.3)) * half
    )
    width = half * rng.uniform(0.85, 1.15)
    return InspectionLabel(minute, cell + 1, name, source, low=round(middle - width, 3), high=round(middle + width, 3))
