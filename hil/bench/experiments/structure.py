"""Model error of commissioned twins: two structures on healthy rigs of another maker.

Each twin is made from the rig's data sheet, fitted to the first four fifths of its commissioning record, and simulated
freely over the last fifth and over a healthy campaign of forty hours that it never saw. What is left above the noise
of the thermometers is structure: physics that the network cannot express.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hil.bench.experiments.campaigns import PROFILES
from hil.bench.measure import Cell, ReportTable
from hil.record import read_record
from hil.run.session import ProgressBar
from twin import Array, CommissionOptions, Kernel, commission, from_datasheet, simulate

TEMPLATES = {"four volumes": "loop.toml", "ten volumes": "loop_six.toml"}
"""Name of a twin in the tables -> its template."""
MEAN_S = 10.0
HELD_OUT = 0.2
START_ROWS = 30
"""Readings of a campaign that set the initial state of its simulation."""
PROTOTYPE = (
    "A prototype of nine volumes left 19 to 50 mK in means over 10 s over forty healthy hours of these rigs, one of "
    "four volumes 20 to 170 mK."
)


@dataclass(frozen=True, slots=True)
class ModelError:
    """Model error of one twin on one rig: RMSE in K per sensor (m,).

    Attributes
    ----------
    held_out, campaign
        Free runs; `_10s` of means over `MEAN_S`.
    noise
        Declared, of single readings.
    fit_s, forward_s
        CPU time of commissioning and of simulating the campaign.
    """

    rig: str
    twin: str
    sensors: tuple[str, ...]
    noise: Array
    held_out: Array
    held_out_10s: Array
    campaign: Array
    campaign_10s: Array
    fit_s: float
    forward_s: float


def measure(data: Path, seed: int) -> tuple[tuple[ReportTable, ...], tuple[str, ...]]:
    """Return a summary and a table for each rig, or a line if there are no rigs."""
    rigs = healthy_rigs(data / "stranger")
    if not rigs:
        return (), (
            f"structure: no {data / 'stranger' / 'KEY.json'}; set HIL_DATA to the folder that holds 'stranger'",
        )
    found: list[ModelError] = []
    with ProgressBar("commissioning", len(rigs) * len(TEMPLATES)) as bar:
        for rig in rigs:
            for name, template in TEMPLATES.items():
                bar.update(len(found), f"{rig.name}, {name}")
                found.append(judge(rig, name, PROFILES / "twins" / template, seed))
    return (_summary(found), *(_table(rig.name, found) for rig in rigs)), ()


def healthy_rigs(folder: Path) -> list[Path]:
    """Return the rigs whose campaign is healthy, by their key."""
    key = folder / "KEY.json"
    if not key.is_file():
        return []
    answers = json.loads(key.read_text(encoding="utf-8"))
    return [folder / rig for rig, entry in answers.items() if entry["answer"]["kind"] == "none"]


def judge(rig: Path, name: str, template: Path, seed: int) -> ModelError:
    """Commission the twin of `template` on `rig` and return its model error."""
    sheet = from_datasheet(rig / "datasheet.json", template)
    healthy = read_record(rig / "commissioning.parquet")
    inputs, measured = sheet.select(healthy.columns)
    kernel = Kernel(sheet, sheet.tunables("commission"))
    kernel.trace(np.tile(sheet.values, (2, 1)), sheet.initial_state(measured[:1]), healthy.time_s[:2], inputs[:2])
    began = time.process_time()
    done = commission(sheet, healthy.time_s, inputs, measured, CommissionOptions(held_out=HELD_OUT, seed=seed))
    fit_s = time.process_time() - began
    network = done.network
    residual = simulate(network, healthy.time_s, inputs, done.state) - measured
    late = (healthy.time_s >= done.held_out_s[0]) & (healthy.time_s <= done.held_out_s[1])

    record = read_record(rig / "campaign.parquet")
    inputs, measured = network.select(record.columns)
    state = network.initial_state(measured[:START_ROWS])
    simulate(network, record.time_s[:2], inputs[:2], state)
    began = time.process_time()
    readings = simulate(network, record.time_s, inputs, state)
    forward_s = time.process_time() - began
    both = [(healthy.time_s[late], residual[late]), (record.time_s, readings - measured)]
    (held_out, campaign), (held_out_10s, campaign_10s) = ([f(t, r) for t, r in both] for f in (_rmse, _rmse_of_means))
    return ModelError(
        rig.name,
        name,
        network.sensor_names,
        network.sigma,
        held_out,
        held_out_10s,
        campaign,
        campaign_10s,
        fit_s,
        forward_s,
    )


def _rmse(time_s: Array, residual: Array) -> Array:
    found: Array = np.sqrt(np.nanmean(residual**2, axis=0))
    return found


def _rmse_of_means(time_s: Array, residual: Array) -> Array:
    """Return the RMSE (m,) of means over `MEAN_S` of residuals (n, m); missing readings are left out of their mean."""
    block = np.floor((time_s - time_s[0]) / MEAN_S).astype(int)
    good = np.isfinite(residual)
    count = np.stack([np.bincount(block, weights=g) for g in good.T])
    total = np.stack([np.bincount(block, weights=r) for r in np.where(good, residual, 0.0).T])
    means = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    found: Array = np.sqrt(np.nanmean(means**2, axis=1))
    return found


def _summary(found: list[ModelError]) -> ReportTable:
    def spread(values: Array) -> str:
        return f"{1e3 * values.min():.0f} to {1e3 * values.max():.0f}"

    rows: list[tuple[Cell, ...]] = [
        (
            left.rig,
            left.twin,
            spread(left.noise / np.sqrt(MEAN_S)),
            spread(left.held_out_10s),
            spread(left.campaign_10s),
            left.fit_s,
            left.forward_s * 1e3,
        )
        for left in found
    ]
    columns = ("rig", "twin", "noise mK", "held out mK", "40 h mK", "fit CPU s", "40 h CPU ms")
    notes = (
        "RMSE of means over 10 s, least to greatest over the sensors. Held out: the last fifth of commissioning. 40 h: "
        "a healthy campaign, simulated freely from its first half minute. Fit: four starts.",
        PROTOTYPE,
    )
    title = "Two structures, commissioned on ten hours: error of free runs"
    return ReportTable("structure", title, columns, tuple(rows), notes)


def _table(rig: str, found: list[ModelError]) -> ReportTable:
    rows = [row for left in found if left.rig == rig for row in _rows(left)]
    columns = ("twin", "sensor", "noise mK", "held out", "40 h", "noise of 10 s", "held out, 10 s", "40 h, 10 s")
    title = f"Rig {rig}, every sensor: RMSE in mK of readings and of means over 10 s"
    return ReportTable(f"structure_{rig}", title, columns, tuple(rows))


def _rows(left: ModelError) -> list[tuple[Cell, ...]]:
    of_means = left.noise / np.sqrt(MEAN_S)
    figures = (left.noise, left.held_out, left.campaign, of_means, left.held_out_10s, left.campaign_10s)
    table = 1e3 * np.column_stack(figures)
    return [(left.twin, sensor, *row) for sensor, row in zip(left.sensors, table.tolist(), strict=True)]
