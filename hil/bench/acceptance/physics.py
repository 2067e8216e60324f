"""Rows measured against references: Merkel's integral, EnergyPlus's tower, size of records, memory of a forward."""

from __future__ import annotations

import csv
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from hil.bench.acceptance.outcome import Outcome, not_measured
from hil.bench.measure import in_new_process
from hil.tower import CellLines, Verdict, append_records
from twin.tower import air as moist
from twin.tower.cell import WETTED, CellDeviations, Design, Inputs, solve_cell
from twin.tower.clean_cell.merkel import merkel_number

HERE = "here"
REFERENCE = Path("real") / "tower_reference"
BAKER, ENERGYPLUS = "baker_shryock_1961_table1b.csv", "energyplus_variable_speed_merkel_SIMULATED.dat"
PRESSURE_KPA = 101.325
COLD_F, WET_F, RATIO = 80.0, 70.0, 1.2
"""Cold water, entering wet bulb and water over air of the published table."""
DAY_LINES, YEAR_DAYS = 288, 365.25
"""Records of a day, one in five minutes."""
FORWARD = """
from pathlib import Path
from twin.calibrators.hiera_unet.model.network import HieraUNet
from twin.calibrators.hiera_unet.tower.table import SUBJECT
from twin.calibrators.hiera_unet.tower import Fleet
from twin.calibrators.hiera_unet.tower.member import own_rows
from twin.calibrators.hiera_unet.tower.predict import answer
from twin.calibrators.hiera_unet.weights.device import ready
from hil.training.tower import random_table
ready("cpu", 1)
fleet = Fleet([random_table(0)])
answer(HieraUNet(SUBJECT.config("full")).eval(), fleet.batch(own_rows(fleet, 0.0, 1.0)[:1]), True, False)
lines = Path("/proc/self/status").read_text().splitlines()
print(next(float(line.split()[1]) for line in lines if line.startswith("VmHWM")) * 1024.0 / 1e9)
"""


def physics_measures(data: Path) -> dict[str, Callable[[], Outcome]]:
    """Return a measure for each row, with the references of a folder of data."""
    folder = data / REFERENCE
    return {
        "merkel": lambda: merkel(folder / BAKER),
        "energyplus": lambda: energyplus(folder / ENERGYPLUS),
        "record": record_size,
        "memory": memory,
    }


def merkel(path: Path) -> Outcome:
    """Compare Merkel's integral with the table of Baker and Shryock (J. Heat Transfer 83 (1961) 339, table 1b)."""
    if not path.is_file():
        return not_measured(f"no {path.name}; set HIL_DATA to the folder that holds `real`")
    h = float(moist.saturated_enthalpy(_celsius(WET_F), PRESSURE_KPA))
    errors = [
        float(merkel_number(_celsius(hot), _celsius(COLD_F), h, RATIO, PRESSURE_KPA)) / published - 1.0
        for _, hot, published in _numbers(path)
    ]
    worst = 100.0 * float(np.abs(errors).max())
    return Outcome(f"{worst:.2f}", worst <= 1.5, HERE, seeds=f"{len(errors)} points")


def energyplus(path: Path) -> Outcome:
    """Fit a clean cell to every second minute of EnergyPlus's tower, and predict the others."""
    if not path.is_file():
        return not_measured(f"no {path.name}; set HIL_DATA to the folder that holds `real`")
    d = np.array(_numbers(path))
    d = d[(d[:, 5] > 0.0) & (d[:, 9] > 0.0)]
    rho = moist.density(d[:, 1], moist.ratio_from_wet_bulb(d[:, 1], d[:, 2], PRESSURE_KPA), PRESSURE_KPA)
    u = Inputs(d[:, 3], d[:, 5], d[:, 9] * 1.15 / rho, d[:, 1], d[:, 2], np.full(len(d), PRESSURE_KPA))

    def error(p: np.ndarray, part: np.ndarray) -> np.ndarray:
        design = Design(d[:, 5].max(), p[2] * d[:, 5].max(), p[0], p[1], 1.0, 1.15)
        return solve_cell(u.take(part), design, CellDeviations(uniformity=1.0 / WETTED)).t_out - d[part, 4]

    fitted = least_squares(error, [1.5, 0.6, 0.8], args=(np.arange(0, len(d), 2),)).x
    held = error(fitted, np.arange(1, len(d), 2))
    worst = float(np.abs(held).max())
    return Outcome(f"{worst:.3f}", worst <= 0.05, HERE, seeds=f"{len(held)} minutes")


def record_size() -> Outcome:
    """Write the records of a day of one cell, and return their size over a year."""
    rng = np.random.default_rng(0)
    told: Any = SimpleNamespace(condition=61.3, hidden=0.083)
    windows: Any = [SimpleNamespace(told=told, end_s=7200.0 * (k + 1)) for k in range(12)]
    lines = CellLines(
        cell=1,
        time_s=np.arange(0.0, 300.0 * DAY_LINES, 300.0),
        deviations=rng.normal(0.0, 0.1, (DAY_LINES, 4)),
        sd=rng.uniform(0.01, 0.1, (DAY_LINES, 4)),
        correction=rng.normal(0.0, 0.5, DAY_LINES),
        half=rng.uniform(0.05, 0.5, DAY_LINES),
        regime=np.full(DAY_LINES, 3, dtype=np.uint8),
        window=np.arange(DAY_LINES) // 24,
        windows=windows,
        verdicts=[Verdict(("HIGH_UNCERTAINTY",), {"fill": ("LOW_SENSITIVITY:fill",)})] * 12,
        source="0123456789ab",
        twin="0123456789ab",
    )
    with tempfile.TemporaryDirectory(prefix="hil-records-") as folder:
        path = Path(folder) / "records.jsonl"
        count = append_records(path, [lines], "shadow")
        size = path.stat().st_size / count * DAY_LINES * YEAR_DAYS / 1e6
    return Outcome(f"{size:.1f}", size <= 46.0, HERE, seeds=f"{count} records", why="each with two reason codes")


def memory() -> Outcome:
    """Return the peak memory of a process that answers one window with the full network, torch included."""
    try:
        (peak,) = in_new_process(FORWARD, {"OMP_NUM_THREADS": "1"})
    except RuntimeError as error:
        return not_measured(f"the forward did not run ({error})")
    return Outcome(f"{peak:.2f}", peak <= 1.0, HERE, seeds="1 window", why="one window; weights before training")


def _celsius(fahrenheit: float) -> float:
    return (fahrenheit - 32.0) / 1.8


def _numbers(path: Path) -> list[list[float]]:
    """Return the rows of numbers of a table."""
    with path.open(encoding="utf-8") as handle:
        rows = [row for row in csv.reader(line for line in handle if line[:1].isdigit()) if row[1:]]
    return [[float(v) for v in row] for row in rows]
