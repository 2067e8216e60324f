"""Small input files for the command line: a load profile, effects, a rig file and a record."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hil.record.reader import Record, write_record

PROJECT = Path(__file__).resolve().parents[2]
RIG = PROJECT / "profiles" / "rigs" / "virtual.toml"
TWIN = PROJECT / "profiles" / "twins" / "virtual.toml"
GOOD_LOAD = "time_s,heater_power_W,pump_speed_pct,fan_speed_pct\n0,700,100,70\n900,700,100,70\n"
EFFECT = '[[effect]]\nkind = "heat_source"\nwhere = "tank"\ndriver = "constant"\npower_W = 5.0\n'
ANY_RIG = '[rig]\nname = "r"\n[bus.b]\ntransport = "{}"\n{}\n[[point]]\nname = "t"\nbus = "b"\nunit = "1"\n{}\n'


def load(tmp_path: Path, text: str) -> Path:
    """Write `text` as load.csv and return its path."""
    path = tmp_path / "load.csv"
    path.write_text(text, encoding="utf-8")
    return path


def healthy_record(tmp_path: Path, **changes: np.ndarray | None) -> Path:
    """Write 3000 s of the virtual rig with these columns instead, or without them where None; return the path."""
    time_s = np.arange(0.0, 3000.0)
    columns: dict[str, np.ndarray] = {
        "heater_power_W": np.full(3000, 700.0),
        "pump_speed_pct": np.full(3000, 100.0),
        "fan_speed_pct": np.full(3000, 70.0),
        "T_ambient_C": np.full(3000, 21.0),
    }
    for name in ("heater", *(f"pm{i}" for i in range(1, 7)), "radiator", "tank"):
        columns[f"T_{name}_C"] = 30.0 + time_s / 1000
    for name, values in changes.items():
        if values is None:
            del columns[name]
        else:
            columns[name] = values
    path = tmp_path / "record.parquet"
    write_record(Record(time_s, columns), path)
    return path
