"""Rows measured on simulated stations that no training saw, with the shipped ensemble's answers.

Effectiveness and heat follow from the outlet: with inlet T_in, wet bulb T_wb and an error e of the outlet, the error of
the effectiveness is e / (T_in - T_wb), and that of the heat e / (T_in - T_out) of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import norm

from hil.bench.acceptance.outcome import TRUTH, Outcome
from hil.training.tower import StationPlan, station_cells, table_of
from twin import NORMAL90, Array
from twin.tower import CellModel, DesignPoint
from twin.tower.model import GLOBALS, SLOW, Operation

HERE = "here"
FAMILY_SEED, HOT_SEED = 9801, 9901
"""First seeds of the stations: those of no split of a training."""
MONTHS, FAMILY, HOT_START = 7.0, 6, 5
"""Length of a record, stations of the family, and remainder of a seed by twelve whose record starts in June."""
WINDOWS = 96
"""Windows of each cell."""
HOT_C, NEAR_K, SIGN_K, MOST_CONDITION = 26.0, 0.5, 0.12, 80.0
"""SIGN_K: least true bias whose sign counts, the gate of its error."""
LEAST_FALL_K = 1.0
"""Range from which on the answer of the outlet to the fan has a sign."""
FAN_SPEEDS, FAN_STEP = (0.33, 0.9), 0.1
LEVELS = np.linspace(0.1, 0.9, 9)
Say = Callable[[str], None]


@dataclass(frozen=True)
class StationAnswers:
    """Errors of the ensemble on the windows of one site's cells, and signs of the fan's effect.

    Attributes
    ----------
    error, half
        (K, 120) K, outlet less the truth, and half width of its 90 % interval.
    drive, fall, wet
        (K, 120) inlet over wet bulb K, range K, wet bulb degC.
    bias, true_bias, condition
        (K,) K, K, condition number of the day.
    signs
        (N,) whether ten per cent more and less fan move the outlet the right way.
    """

    error: Array
    half: Array
    drive: Array
    fall: Array
    wet: Array
    bias: Array
    true_bias: Array
    condition: Array
    signs: np.ndarray


def station_rows(card: Path, seed: int, say: Say) -> dict[str, Outcome]:
    """Return the outcomes of rows that the answers to simulated stations decide.

    Raises
    ------
    HieraError
        The card or a member cannot be used.
    """
    from twin.calibrators.hiera_unet.tower import load_tower_ensemble
    from twin.calibrators.hiera_unet.weights.device import ready

    ready("cpu", 1)
    ensemble = load_tower_ensemble(card)
    family = [StationPlan("F", FAMILY_SEED + 10 * seed + k, MONTHS, 1) for k in range(FAMILY)]
    hot = HOT_SEED + 12 * seed
    miami = StationPlan("B", hot + (HOT_START - hot) % 12, MONTHS, 1)
    found = {}
    for plan in (*family, miami):
        say(f"simulating station {plan.name}")
        found[plan.name] = answers_to(ensemble, plan)
    here = joined(list(found.values()))
    return outcomes(here, found[miami.name], f"{len(found)} stations")


def outcomes(every: StationAnswers, hot: StationAnswers, seeds: str) -> dict[str, Outcome]:
    """Return the outcomes by the answers to all stations, and to the hot site alone."""

    def outcome(text: str, reached: bool, count: str = seeds, why: str = "") -> Outcome:
        return Outcome(text, reached, HERE, TRUTH, count, why=why)

    share = 100.0 * _mean(np.abs(every.error) / every.drive)
    other = 100.0 * _mean(np.abs(hot.error) / hot.drive)
    heat = 100.0 * (np.abs(every.error) / every.fall)[every.fall > LEAST_FALL_K]
    mean, p95 = float(np.nanmean(heat)), float(np.nanquantile(heat, 0.95))
    median = float(np.nanmedian(every.error))
    warm = hot.error[(hot.wet > HOT_C) & np.isfinite(hot.error)]
    near = 100.0 * float((np.abs(warm) <= NEAR_K).mean()) if len(warm) else float("nan")
    clear = (np.abs(every.true_bias) > SIGN_K) & (every.condition <= MOST_CONDITION)
    right = np.sign(every.bias[clear]) == np.sign(every.true_bias[clear])
    signs = 100.0 * float(every.signs.mean())
    found = {
        "effectiveness": outcome(f"{share:.2f}", share <= 1.3),
        "cross effectiveness": outcome(f"{other:.2f}", other <= 1.6, "1 station", "Miami"),
        "heat": outcome(f"{mean:.1f} / {p95:.1f}", mean <= 2.2 and p95 <= 4.9, why="from a range of 1 K on"),
        "median": outcome(f"{median:+.3f}", abs(median) <= 0.05),
        "hot": outcome(f"{near:.1f} %", near >= 95.0, f"1 station, {len(warm)} minutes", "Miami in summer"),
        "counterfactual": outcome(
            f"{signs:.2f} %",
            signs >= 99.1,
            f"{len(every.signs)} points",
            "the twin at its belief; the correction is that of the recorded fan",
        ),
        "ece": _levels(every, outcome),
    }
    if clear.any():
        text = 100.0 * float(right.mean())
        found["bias sign"] = outcome(
            f"{text:.1f} %", text >= 98.0, f"{int(clear.sum())} windows", f"true bias above {SIGN_K:g} K"
        )
    return found


def _levels(every: StationAnswers, outcome: Callable[..., Outcome]) -> Outcome:
    """Return the mean distance of levels and shares, with a normal law of the interval's width."""
    away = np.abs(every.error) / every.half
    known = away[np.isfinite(away)]
    held = [float((known <= norm.ppf(0.5 + 0.5 * level) / NORMAL90).mean()) for level in LEVELS]
    error = float(np.abs(np.array(held) - LEVELS).mean())
    return outcome(f"{error:.3f}", error <= 0.026, why="levels 0.1 to 0.9 of a normal law with the 90 % width")


def answers_to(ensemble: Any, plan: StationPlan) -> StationAnswers:
    """Simulate a station and return the ensemble's answers to it."""
    from twin.calibrators.hiera_unet.tower import Fleet
    from twin.calibrators.hiera_unet.tower.score import targets_of

    found = []
    for cell in station_cells(plan):
        fleet = Fleet([table_of(cell)])
        rows = fleet.rows[np.unique(np.linspace(0, len(fleet.rows) - 1, WINDOWS).astype(np.int64))]
        t, answer = targets_of(fleet, rows), ensemble.ask(fleet, rows)
        wet = float(cell.sheet["design"]["wet_bulb_C"]) + 10.0 * t.minutely[..., 0]
        drive = 10.0 * (t.minutely[..., 1] + 1.0)
        found.append(
            StationAnswers(
                answer.found.water - t.true_water,
                answer.found.water_half,
                drive,
                drive + wet - t.true_water,
                wet,
                answer.found.theta[:, 3],
                t.true[:, 3],
                fleet.cycles["condition"].numpy()[rows],
                fan_signs(cell),
            )
        )
    return joined(found)


def fan_signs(cell: Any) -> np.ndarray:
    """Return whether ten per cent more and less fan move the outlet the right way, by minutes of a cell (N,).

    The twin has the belief of the last update, and the correction does not depend on the altered fan.
    """
    sheet = cell.sheet["design"]
    site = DesignPoint(
        float(sheet["water_inlet_C"]),
        float(sheet["wet_bulb_C"]),
        float(sheet["range_K"]),
        float(cell.sheet["bypass"]["share_when_open"]),
    )
    model = CellModel(cell.commissioned.design, site)
    minutes, beliefs = cell.minutes, cell.recursion
    speed = minutes.operation.inputs.speed
    running = minutes.known & (speed > FAN_SPEEDS[0]) & (speed < FAN_SPEEDS[1])
    rows = np.flatnonzero(running & (minutes.time_s >= beliefs.start_s[0]))[::30]
    at = np.searchsorted(beliefs.start_s, minutes.time_s[rows], side="right") - 1
    slow = np.zeros((len(rows), len(SLOW)))
    slow[:, :4] = beliefs.mean[at]
    constants = np.array([one.mean for one in GLOBALS])
    operation: Operation = minutes.operation.take(rows)
    u = operation.inputs

    def outlet(share: float) -> Array:
        return model.outlet(replace(operation, inputs=replace(u, speed=share * u.speed)), slow, constants)

    usual = outlet(1.0)
    cools = u.t_in - usual > LEAST_FALL_K
    right = (outlet(1.0 + FAN_STEP) < usual) & (outlet(1.0 - FAN_STEP) > usual)
    return np.asarray(right[cools])


def joined(parts: Sequence[StationAnswers]) -> StationAnswers:
    """Return the answers of several cells as one."""
    names = StationAnswers.__dataclass_fields__
    return StationAnswers(**{name: np.concatenate([getattr(one, name) for one in parts]) for name in names})


def _mean(values: Array) -> float:
    return float(np.nanmean(values))
