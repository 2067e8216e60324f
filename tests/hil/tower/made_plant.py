"""A made record of a cell with its datasheet and test points, and the commands that are asked of it."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from click.testing import CliRunner

from hil.cli.verbs import group
from hil.errors import exit_code
from tests.twin.tower.made_cell import M_A0, M_W0, made_cell, made_points

SHEET = {
    "station": "Z",
    "cells_in_station": 1,
    "cells_recorded": [1],
    "design": {
        "water_flow_kg_s": M_W0,
        "water_to_air": M_W0 / M_A0,
        "water_inlet_C": 34.0,
        "wet_bulb_C": 24.0,
        "range_K": 6.0,
        "pressure_kPa": 99.0,
    },
    "basin": {"volume_m3": 120, "compartments": 1},
}


def write_record(folder: Path, cell: int = 1, days: float = 6, **options: Any) -> None:
    """Write a record of a made cell as the alignment does."""
    made = made_cell(days, seed=21, **options)
    folder.mkdir(exist_ok=True)
    arrays = {"time": pa.array((made.time_s * 1e3).astype("datetime64[ms]"), pa.timestamp("ms", tz="UTC"))}
    for name, values in made.columns.items():
        whole = name in ("regime", "check")
        arrays[name] = pa.array(values.astype(np.uint8) if whole else values)
        if not whole:
            arrays[f"{name}_how"] = pa.array(made.origin[name])
    table = pa.table(arrays).replace_schema_metadata(
        {"hil.tower": json.dumps({"format": 1, "cell": cell, "station": "Z"})}
    )
    pq.write_table(table, folder / f"cell{cell}.parquet")
    events = [
        {
            "time": iso(made.time_s[1440]),
            "by_day": False,
            "cell": cell,
            "kind": "inspection",
            "source": "CMMS",
            "text": "",
            "from": iso(made.time_s[1440]),
            "to": iso(made.time_s[1500]),
            "parameters": [],
        }
    ]
    (folder / "station.json").write_text(json.dumps({"datasheet": SHEET, "events": events}))


def iso(seconds: float) -> str:
    return str(np.datetime64(int(seconds), "s")) + "Z"


def write_points(path: Path, cell: int = 1, **changed: float) -> None:
    points = made_points()
    with path.open("w", newline="") as handle:
        out = csv.writer(handle)
        out.writerow(["cell", "test", *points])
        for k in range(14):
            out.writerow([cell, f"T{k:02d}", *(f"{changed.get(n, 0.0) + v[k]:.4f}" for n, v in points.items())])


def files(root: Path) -> tuple[Any, ...]:
    return "--datasheet", root / "datasheet.json", "--points", root / "points.csv"


def run(*words: Any) -> Any:
    return CliRunner().invoke(group, ["tower", *(str(word) for word in words)])


def refused(done: Any) -> str:
    """Return the sentence of a refusal that a user can mend."""
    assert done.exit_code != 0 and done.exception is not None
    if isinstance(done.exception, SystemExit):
        return str(done.output)
    assert exit_code(done.exception) == 2, repr(done.exception)
    return str(done.exception)
