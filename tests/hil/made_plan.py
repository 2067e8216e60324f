"""Test plans of tests, and data of a run made of simple curves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.signals.points import Signal
from hil.testing import BoundLimit, RigSignals, RunData, bind, read_plan

SIGNALS = (
    Signal("heater_power", "W", role="heater_power"),
    Signal("flow", "L/min"),
    Signal("T_tank", "degC"),
    Signal("T_pm1", "degC"),
    Signal("T_pm2", "degC"),
    Signal("cycles", "1", "status"),
    Signal("heater_power_set", "W", "setpoint", role="heater_power"),
)
SENSORS = {"T_modules_C": ("T_pm1_C", "T_pm2_C"), "T_tank_C": ("T_tank_C",)}
DURATION_S = 400.0


def known(duration_s: float = DURATION_S, longest_hold_s: float | None = None) -> RigSignals:
    """Return the names of a small rig with a twin."""
    return RigSignals(SIGNALS, SENSORS, ("static", "pso"), duration_s, 1.0, "rig small", longest_hold_s)


def plan_text(*sentences: str, more: str = "", head: str = "") -> str:
    """Return a plan with a limit L1, L2, ... for each sentence; `more` goes into each limit."""
    limits = (
        f'[[limit]]\nid = "L{number}"\nlimit = "{sentence}"\nrequirement = "REQ-{number}"\n{more}\n'
        for number, sentence in enumerate(sentences, 1)
    )
    return f'id = "small"\n{head}\n' + "\n".join(limits)


def bound(folder: Path, sentence: str, more: str = "", head: str = "") -> BoundLimit:
    """Return the limit of one sentence for the small rig."""
    path = folder / "plan.toml"
    path.write_text(plan_text(sentence, more=more, head=head), encoding="utf-8")
    (limit,) = bind(read_plan(path), known())
    return limit


def made_run(end_s: float = DURATION_S, **columns: NDArray[np.float64] | float) -> RunData:
    """Return a run of the small rig up to `end_s`: a step of the heater at 200 s, and a tank that follows in 20 s."""
    time_s = np.arange(end_s + 1.0)
    power = np.where(time_s < 200.0, 100.0, 300.0)
    tank = 30.0 + 10.0 * np.where(time_s < 200.0, 0.0, 1.0 - np.exp(-(time_s - 200.0) / 20.0))
    made = {
        "heater_power_W": power - 1.0,
        "flow_L_per_min": np.full(len(time_s), 5.0),
        "T_tank_C": tank,
        "T_pm1_C": tank + 5.0,
        "T_pm2_C": tank + 7.0,
        "cycles": time_s,
        "heater_power_set_W": power,
    }
    made |= {name: np.zeros(len(time_s)) + values for name, values in columns.items()}
    twin = {"T_modules_C": made["T_tank_C"] + 6.1, "T_tank_C": made["T_tank_C"] + 0.2}
    return RunData(
        time_s,
        made,
        ("heater_power_set_W",),
        1.0,
        DURATION_S,
        {"static": twin, "pso": twin},
        SENSORS,
        has_ended=end_s >= DURATION_S,
    )
