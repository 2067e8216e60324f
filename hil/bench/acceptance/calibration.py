"""Rows of deviations, intervals, detection, cost and the loop, from published results."""

from __future__ import annotations

import re

import numpy as np

from hil.bench.acceptance.outcome import HIDDEN, ONLINE, TRUTH, Outcome, Published, figure, not_measured
from hil.bench.acceptance.outlet import ENSEMBLE, NETWORK, TOWER
from twin import NORMAL90

STEPS, STATIONS, PAPER = "tower_steps", "tower_stations", "paper"
WIDTH_OVER_MAE = 2.0 * NORMAL90 / np.sqrt(2.0 / np.pi)
"""Least mean width of 90 % intervals over the mean absolute error of a mixture of normal laws, 4.12: both are
proportional to the standard deviation of each component, and an interval of that component's own width is the
narrowest that holds 90 % of it."""
PARTS = {"deviations": ("fill %", 4.1), "air": ("air %", 3.6), "uniformity": ("uniformity %", 5.4)}


def calibration_rows(published: Published) -> dict[str, Outcome]:
    """Return the outcomes of A10 to A28 that published results have."""
    found = {
        "review": not_measured("needs engineers at a plant"),
        "sizes": not_measured("10.6 M was not trained, and both other sizes have the start's outlet"),
    }
    for rows in (_deviations, _intervals, _steps, _withheld, _latency, _loop, _undeclared):
        found |= rows(published)
    return found


def _deviations(published: Published) -> dict[str, Outcome]:
    found: dict[str, Outcome] = {}
    cells = len(published.rows(NETWORK, "cells"))
    if ours := published.row(NETWORK, "deviations_all", method=ENSEMBLE):
        errors = [figure(ours[name]) for name, _ in PARTS.values()]
        good = all(e <= limit for e, (_, limit) in zip(errors, PARTS.values(), strict=True))
        text = " / ".join(f"{e:.2f}" for e in errors)
        found["deviations"] = Outcome(
            text, good, NETWORK, TRUTH, f"{cells} cells", why="on all windows, not on accepted ones alone"
        )
        bias = figure(ours["bias K"])
        found["bias"] = Outcome(f"{bias:.3f}", bias <= 0.12, NETWORK, TRUTH, f"{cells} cells")
    for note in published.notes(NETWORK, "branches"):
        if spread := re.search(r"fill (\d+\.?\d*) %", note):
            value = float(spread[1])
            found["seeds"] = Outcome(f"{value:.2f}", value <= 0.8, NETWORK, TRUTH, "4 members")
    return found


def _intervals(published: Published) -> dict[str, Outcome]:
    found: dict[str, Outcome] = {}
    ours = published.row(NETWORK, "intervals", method=ENSEMBLE)
    error = published.row(NETWORK, "outlet_all", method=ENSEMBLE)
    cells = f"{len(published.rows(NETWORK, 'cells'))} cells"
    if ours and error:
        inside, width, mae = figure(ours["outlet within 90 %"]), figure(ours["width K"]), figure(error["MAE K"])
        found["coverage"] = _coverage([inside], NETWORK, cells)
        found["width"] = _width([(width, mae)], NETWORK, cells)
    smoothed = [r for r in published.rows(TOWER, "outlet") if r["part"] == "all"]
    if smoothed:
        cells = f"{len(smoothed)} cells, 1 station"
        found["coverage smoothed"] = _coverage([figure(r["within 90 %"]) for r in smoothed], TOWER, cells)
        pairs = [(figure(r["width K"]), figure(r["calibrated K"])) for r in smoothed]
        found["width smoothed"] = _width(pairs, TOWER, cells)
    return found


def _coverage(shares: list[float], source: str, seeds: str) -> Outcome:
    text = " and ".join(f"{100.0 * s:.1f} %" for s in shares)
    good = all(0.885 <= s <= 0.915 for s in shares)
    return Outcome(text, good, source, TRUTH, seeds, why="approach: that of the outlet, at a measured wet bulb")


def _width(pairs: list[tuple[float, float]], source: str, seeds: str) -> Outcome:
    text = " and ".join(f"{width:.3f}, {width / mae:.2f} MAE" for width, mae in pairs)
    good = all(width >= WIDTH_OVER_MAE * mae for width, mae in pairs)
    why = "" if good else "narrower than normal laws with such an error have: see the coverage"
    return Outcome(text, good, source, TRUTH, seeds, why=why)


def _steps(published: Published) -> dict[str, Outcome]:
    figures = {str(r["figure"]): figure(r["value"]) for r in published.rows(STEPS, "steps")}
    if not figures:
        return {}
    steps, late, missed = (int(figures[n]) for n in ("steps", "found later", "missed"))
    within = int(figures["found within 18 min"])
    wrong = int(figures["taken for a change of the water"] + figures["called fouling by the refit"])
    median = figures["median minutes to the alarm"]
    trials = f"{steps} trials, 2 cells"
    return {
        "step": Outcome(
            f"{within} of {steps}; median {median:g} min",
            within == steps,
            STEPS,
            ONLINE,
            trials,
            why=f"{late} found later, {missed} missed" if within < steps else "",
        ),
        "step called fouling": Outcome(f"{wrong} of {steps}", wrong == 0, STEPS, ONLINE, trials),
    }


def _withheld(published: Published) -> dict[str, Outcome]:
    shares: dict[str, float] = {}
    for row in published.rows(TOWER, "withheld"):
        shares[str(row["cell"])] = shares.get(str(row["cell"]), 0.0) + figure(row["% of windows"])
    if not shares:
        return {}
    text = " and ".join(f"at most {share:.1f} %" for share in shares.values())
    why = "sum over reason codes: a window with two codes counts twice"
    return {
        "withheld": Outcome(
            text, max(shares.values()) <= 10.0, TOWER, HIDDEN, f"{len(shares)} cells, 1 station", why=why
        )
    }


def _latency(published: Published) -> dict[str, Outcome]:
    row = published.row(NETWORK, "latency", configuration="full, untrained")
    if row is None:
        return {}
    ms = figure(row["forward ms"])
    return {"latency": Outcome(f"{ms:.0f}", ms <= 107.0, NETWORK, "P4", "-", why="weights before training")}


def _loop(published: Published) -> dict[str, Outcome]:
    found: dict[str, Outcome] = {}
    sensors, gains = ("heater", "modules", "radiator", "tank"), []
    for rig in ("tracking_virtual", "tracking_rig_d0"):
        rows = {str(r["twin"]).strip(): r for r in published.rows(PAPER, rig)}
        static, fitted = rows.get("by hand: static"), rows.get("least_squares, fitted")
        if static and fitted:
            gains.append([100.0 * (1.0 - figure(fitted[s]) / figure(static[s])) for s in sensors])
    if gains:
        text = " and ".join(" / ".join(f"{g:.0f}" for g in one) for one in gains)
        found["loop gain"] = Outcome(
            text,
            min(min(one) for one in gains) >= 93.0,
            PAPER,
            ONLINE,
            f"{len(gains)} rigs",
            why="a gain ends at the noise: the twin by hand starts nearer than the paper's",
        )
    worst = [
        r["fitted"]
        for name in ("modules_heat", "tank_insulation")
        for r in published.rows(PAPER, name)
        if r["calibrator"] == "least_squares"
    ]
    if worst:
        good = all(isinstance(w, int) and w <= 2 for w in worst)
        found["loop recovery"] = Outcome(
            f"{worst[0]}" if len(set(worst)) == 1 else ", ".join(str(w) for w in worst),
            good,
            PAPER,
            ONLINE,
            f"{len(worst)} changes",
        )
    return found


def _undeclared(published: Published) -> dict[str, Outcome]:
    rows = published.rows(STATIONS, "recirculation")
    named = [r for r in rows if r["named"] == "yes"]
    if not rows:
        return {}
    before, after = (float(np.mean([figure(r[f"error {w} K"]) for r in named])) for w in ("before", "after"))
    worst = max(figure(r["p value"]) for r in named) if named else 1.0
    better = all(figure(r["error after K"]) < figure(r["error before K"]) for r in named)
    good = len(named) >= 0.9 * len(rows) and worst < 0.01 and better
    missed = len(rows) - len(named)
    return {
        "undeclared": Outcome(
            f"{len(named)} of {len(rows)}; {before:.3f} to {after:.3f} K; p <= {worst:g}",
            good,
            STATIONS,
            HIDDEN,
            f"{len(rows)} seeds",
            why=f"{missed} seed without a name" if missed else "",
        )
    }
