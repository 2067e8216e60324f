"""The same records with parts of the method left out, and how visible the truth was; run after answers are sealed.

    python -m hil.bench.discovery_ablation

`linear` is the contest alone, without the joint fit and its verdict; `raw` the same without projecting the tunables
out of the signatures; `sindy` is pysindy on the same data, where it is installed.

The forecast is the score that the true effect would get at its true size.
"""

from __future__ import annotations

import dataclasses
import importlib.util
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hil.bench.discovery_score import family, same_driver
from hil.bench.discovery_worker import Request, serve
from twin.discovery.basis import basis
from twin.discovery.contest import Contest
from twin.discovery.engine import HELD_OUT
from twin.discovery.grid import on_grid
from twin.discovery.laws import Book, Law
from twin.discovery.null import FALSE_ALARMS, null_scores
from twin.discovery.search import Entry, scan
from twin.network import Array, Network

STIFF = 1e12
"""Precision of a prior that lets nothing move."""
NEAR = 4
MODULES = 6
_UNITS = {"bias": "K", "drift_per_h": "K", "lag_s": "s"}


def answer(request: Request) -> Request:
    """Both ablations over one record, and forecasts of the true effects."""
    from hil.diagnosing import read_columns, with_clock
    from twin.twinfile import load

    network = with_clock(load(Path(request["twin"])))
    record, _ = read_columns(network, Path(request["record"]), request["hour"])
    healthy, _ = read_columns(network, Path(request["healthy"]), request["hour"])
    whole = on_grid(network, record.time_s, record.inputs, record.measured)
    known = basis(network, healthy, whole)
    grid = whole.part(0, int(len(whole.time) * (1.0 - HELD_OUT)))
    state = known.probe.first_state(grid)
    run = known.probe.run(grid, state)
    found = Book(network).laws(grid, run)
    stiff = dataclasses.replace(known.prior, precision=STIFF * np.eye(len(known.prior.precision)))
    said: Request = {}
    for name, prior in (("linear", known.prior), ("raw", stiff)):
        contest = Contest(known.probe, grid, state, run, known.noise, prior)
        said[name] = [_row(e) for e in scan(contest, found)[:NEAR]]
        if name == "linear":
            said["threshold"] = null_scores(contest, found).quantile(FALSE_ALARMS)
            forecasts = [
                forecast(contest, found, network, table, label)
                for table, label in zip(request["effects"], request["labels"], strict=False)
            ]
            said["z_truth"] = [f.z if f else None for f in forecasts]
            said["z_beside"] = beside(contest, forecasts)
            said["sizes"] = [f.size if f else None for f in forecasts]
    if importlib.util.find_spec("pysindy"):
        from hil.bench.peers.sindy_peer import contributions

        calm = on_grid(network, healthy.time_s, healthy.inputs, healthy.measured)
        usual = contributions(network, calm, known.probe.run(calm, known.probe.first_state(calm)))
        rows = contributions(network, grid, run)
        said["sindy"] = [{**row, "z": row["z"] / max(usual[0]["z"], 1e-9)} for row in rows[:NEAR]]
    return said


def _row(e: Entry) -> dict[str, Any]:
    return {"kind": e.candidate.kind, "where": e.candidate.where, "driver": e.driver, "z": e.z, "size": e.size}


@dataclasses.dataclass(frozen=True)
class Forecast:
    """Score `z` of a true effect at its true size; that size in the catalogue's unit at the end of the fit.

    Where the catalogue measures the effect otherwise, the score is that of the fitted size and `size` None. `vector`
    (sites, b) is the effect at its size.
    """

    z: float
    size: float | None
    vector: Array


def beside(contest: Contest, forecasts: list[Forecast | None]) -> list[float]:
    """Scores of true effects at their true sizes, each with the others' sizes fitted along."""
    known = [f for f in forecasts if f is not None]
    if len(known) < len(forecasts):
        return []
    covariance = np.linalg.pinv(contest.joint(np.stack([f.vector for f in known]))[0], rcond=1e-12, hermitian=True)
    # Of one that the part at hand does not hold nothing is known, whatever the inverse says.
    return [min(f.z, float(max(v, 1e-30) ** -0.5)) for f, v in zip(known, np.diag(covariance), strict=True)]


def forecast(
    contest: Contest, found: list[Law], network: Network, table: Mapping[str, Any], label: tuple[str, str, str]
) -> Forecast | None:
    """How visible a true effect is; None where the catalogue has none of its kind there."""
    laws_of: list[Law] = []
    for where in dict.fromkeys((label[1], family(label[1]))):
        laws_of = laws_of or [w for w in found if (w.candidate.kind, w.candidate.where) == (label[0], where)]
    # What grows with time is the steady law in a growing shape.
    driver = "constant" if table.get("driver") == "elapsed_time" else str(table.get("driver"))
    drivers = [w for w in laws_of if same_driver(w.candidate.driver, driver)]
    chosen = drivers or laws_of
    if not chosen:
        return None
    course = course_of(table, contest.edges * contest.grid.step_s)
    best: Forecast | None = None
    for law in chosen:
        p = contest.vector(law) * course
        gram, score = contest.joint(p[None])
        bottom = max(float(gram[0, 0]), 1e-12)
        size = catalogue_size(table, law, network)
        full = size if size is not None else float(score[0]) / bottom
        z = abs(full) * bottom**0.5
        if best is None or z > best.z:
            best = Forecast(z, None if size is None else size * float(course[-1]), p * full)
    return best


def course_of(table: Mapping[str, Any], edges_s: Array) -> Array:
    """Share of its size that an effect has in each block."""
    middle = 0.5 * (edges_s[1:] + edges_s[:-1])
    since = np.maximum(middle - table.get("onset_s", 0.0), 0.0)
    course = np.clip((edges_s[1:] - table.get("onset_s", 0.0)) / np.diff(edges_s), 0.0, 1.0)
    if table.get("ramp_s"):
        course = np.clip(since / table["ramp_s"], 0.0, 1.0)
    if "tau_s" in table:
        course = -np.expm1(-since / table["tau_s"])
    if "drift_per_h" in table:
        course = since / 3600.0
    if "end_s" in table:
        course = np.where(middle > table["end_s"], 0.0, course)
    return np.asarray(course, dtype=np.float64)


def catalogue_size(table: Mapping[str, Any], law: Law, network: Network) -> float | None:
    """Size of an effect in the unit of its candidate; None where the two measure different things.

    So it is with the fan's exponent, of the air side in the rig and of the whole way from water to air in the twin, and
    with a mass, whose capacity the catalogue has in steps.
    """
    c = law.candidate
    kind, driver = table["kind"], table.get("driver")
    if kind == "heat_source" and driver in ("constant", "elapsed_time", "pump_speed", "fan_speed"):
        return float(table["power_W"])
    if kind == "heat_source" and driver == "heater_power":
        return float(table["power_W"]) / 1000.0
    if kind == "heat_loss" and c.unit == "W/K":
        return float(table["conductance_W_per_K"])
    if kind == "heat_rejection" and "lost_fraction" in table and "fins.UA_100" in c.changes:
        return -float(table["lost_fraction"]) * network.parameters["fins.UA_100"].value
    if kind == "flow" and "lost_fraction" in table and "circuit.factor" in c.changes:
        return -float(table["lost_fraction"]) * network.parameters["circuit.factor"].value
    for key in ("bypass_fraction", "bias", "drift_per_h", "lag_s"):
        if key in table and c.unit == _UNITS.get(key, c.unit):
            # The mean of the modules' thermometers takes a share of what one of them is off.
            alone = key == "lag_s" or c.where == table["where"]
            return float(table[key]) * (1.0 if alone else 1.0 / MODULES)
    if kind == "actuator":
        return float(table["gain"]) - 1.0
    return None


if __name__ == "__main__":
    serve(answer)
