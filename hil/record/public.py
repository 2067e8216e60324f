"""Public records of other rigs as columns that a twin file can name.

Each reader takes the folder `real` of the development data and returns `PublicRecord`. What a source leaves to its text
(an ambient temperature, which sample an input belongs to) is put in here, with a message.

`tclab`: two small heaters with thermistors (Park, Martin, Kelly, Hedengren, Comput. Chem. Eng. 135 (2020) 106736).
`heated_pipe`: 39 m of insulated pipe (University of Liege, in the Modelica Buildings library).
`dry_cooler`, `wet_tower`: fan cooler and tower of a 200 kWth plant (CIEMAT Plataforma Solar de Almeria, doi
10.5281/zenodo.17885527).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TCLAB_AMBIENT_C = 23.0
PIPE_AMBIENT_C = 18.0
PIPE_TESTS = ("ulg_150801", "ulg_151202", "ulg_151204_1", "ulg_160104_2")
WATER_DENSITY = 0.997
"""kg/L; the value that the twin's flow elements use."""
DRY_COOLER_FULL_L_MIN = 400.0
"""Flow in L/min that counts as 100 %: 24 m3/h, about the largest flow of the calibration set."""
TOWER_FULL_L_MIN = 400.0
"""Flow in L/min of the wet tower that counts as 100 %."""
HOLD_S = 3600.0
"""Seconds for which each steady state is held in a record."""
HOLD_ROWS = 4


class PublicRecordError(ValueError):
    """Error of a missing or unexpected public record; the message is one plain sentence."""


@dataclass(frozen=True)
class PublicRecord:
    """Record: `time_s` (n,) s and `columns` by name, each (n,), NaN if missing; `messages` a sentence each."""

    name: str
    time_s: Array
    columns: dict[str, Array]
    messages: tuple[str, ...] = ()


def tclab(real: Path, part: str) -> PublicRecord:
    """Return one of `mimo_train`, `mimo_validation`, `siso_train`, `siso_validation`.

    The source's own model takes a row's heater values as in force during the second that ends at the row; a twin
    holds its inputs from a row to the next, so they move up by one row here.
    """
    table = _read(real / "tclab" / f"{part}.csv", ("Time", "H1", "H2", "T1", "T2"))
    columns = {f"heater_{k}_pct": np.append(table[f"H{k}"][1:], table[f"H{k}"][-1]) for k in (1, 2)}
    columns |= {f"T{k}_C": table[f"T{k}"] for k in (1, 2)}
    columns["T_ambient_C"] = np.full_like(table["T1"], TCLAB_AMBIENT_C)
    messages = (
        f"ambient temperature not measured, taken as {TCLAB_AMBIENT_C:g} degC as published",
        "heater values act during the second that ends at their row, as in the published model",
    )
    return PublicRecord(part, table["Time"] - table["Time"][0], columns, messages)


def heated_pipe(real: Path, test: str) -> PublicRecord:
    """Return one of `PIPE_TESTS`: `flow_pct` in per cent of 100 L/min, without channels that never move."""
    names = ("time_s", "m_flow_kg_s", "T_pipe_out_C", "T_water_out_C", "T_pipe_in_C", "T_water_in_C")
    table = _read(real / "heated_pipe" / f"{test}.csv", names)
    columns = {"flow_pct": table["m_flow_kg_s"] * 60.0 / WATER_DENSITY}
    columns["T_ambient_C"] = np.full_like(table["time_s"], PIPE_AMBIENT_C)
    messages = [f"ambient temperature not measured, taken as {PIPE_AMBIENT_C:g} degC as published"]
    for name in names[2:]:
        column = table[name]
        if np.ptp(column[np.isfinite(column)]) == 0.0:
            messages.append(f"{name} shows {column[0]:g} degC from beginning to end; dead channel, left out")
            column = np.full(column.size, np.nan)
        columns[name] = column
    return PublicRecord(test, table["time_s"], columns, tuple(messages))


def dry_cooler(real: Path, experiment: str) -> PublicRecord:
    """Return steady states of `dc_exp1` or `dc_exp3`, one row each; `time_s` only counts them."""
    table = _read(real / "psa_cooling" / f"{experiment}_exp.csv", ("Tamb", "Tin", "w_fan", "q", "Tout"))
    columns = {
        "T_ambient_C": table["Tamb"],
        "T_in_C": table["Tin"],
        "fan_speed_pct": table["w_fan"],
        "flow_pct": table["q"] * 1000.0 / 60.0 / DRY_COOLER_FULL_L_MIN * 100.0,
        "T_out_C": table["Tout"],
    }
    return PublicRecord(experiment, np.arange(table["Tin"].size, dtype=np.float64), columns)


def wet_tower(real: Path, experiment: str) -> PublicRecord:
    """Return steady states of `wct_exp1` or `wct_exp3`, one row each; `time_s` only counts them."""
    table = _read(real / "psa_cooling" / f"{experiment}_exp.csv", ("Tamb", "HR", "Tin", "w_fan", "q", "Tout"))
    columns = {
        "T_ambient_C": table["Tamb"],
        "humidity_pct": table["HR"],
        "T_in_C": table["Tin"],
        "fan_speed_pct": table["w_fan"],
        "flow_pct": table["q"] * 1000.0 / 60.0 / TOWER_FULL_L_MIN * 100.0,
        "T_out_C": table["Tout"],
    }
    return PublicRecord(experiment, np.arange(table["Tin"].size, dtype=np.float64), columns)


def held_steady(states: PublicRecord, measured: tuple[str, ...], hold_s: float = HOLD_S) -> PublicRecord:
    """Return steady states as a record that can be simulated and fitted.

    Each state is held for `hold_s`; the columns named in `measured` appear at the end of its hold only, when the
    network has come to rest.
    """
    count = len(states.time_s)
    rows = np.repeat(np.arange(count), HOLD_ROWS)
    last = np.tile(np.arange(HOLD_ROWS) == HOLD_ROWS - 1, count)
    columns = {name: column[rows] for name, column in states.columns.items()}
    for name in measured:
        columns[name] = np.where(last, columns[name], np.nan)
    time_s = np.arange(rows.size, dtype=np.float64) * (hold_s / HOLD_ROWS)
    return PublicRecord(states.name, time_s, columns, states.messages)


def _read(path: Path, names: tuple[str, ...]) -> dict[str, Array]:
    """Return the columns of a CSV file with one header line, as floats; a cell that is no number is NaN."""
    try:
        table: Any = np.genfromtxt(path, delimiter=",", names=True)
    except OSError:
        raise PublicRecordError(f"{path}: cannot be read; set HIL_DATA to the folder that holds 'real'") from None
    except ValueError as error:
        raise PublicRecordError(f"{path}: is not a table ({str(error).splitlines()[0]})") from None
    missing = [name for name in names if name not in (table.dtype.names or ())]
    if missing:
        raise PublicRecordError(f"{path}: lacks {', '.join(missing)}; it has {', '.join(table.dtype.names or ())}")
    return {name: np.atleast_1d(np.asarray(table[name], dtype=np.float64)) for name in names}
