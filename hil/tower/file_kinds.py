"""Kinds of a tower's files, by name and heading: what a file or folder is before anything of it is read."""

from __future__ import annotations

import re
from pathlib import Path

from hil.files import parse_json

HEADINGS = {
    "tags": {"tag", "role"},
    "labels": {"cell", "parameter"},
    "events": {"cell", "event"},
    "points": {"cell", "water_flow_kg_s", "water_outlet_C"},
}
"""Columns by which a table of a station is known; another command's table has not both."""
DATASHEET = frozenset({"station", "timezone", "design", "fan", "basin", "bypass", "cells_in_station"})
OF_RECORD = frozenset({"alignment.json", "station.json"})
OF_RUN = frozenset({"run.json", "journal.sqlite"})
HEADING_BYTES = 20_000
SHEET_BYTES = 1_000_000


def cells_of(record: Path) -> tuple[int, ...]:
    """Return the numbers of the cells that a record holds."""
    found = (re.fullmatch(r"cell(\d+)\.parquet", path.name) for path in record.glob("cell*.parquet"))
    return tuple(sorted(int(match[1]) for match in found if match))


def tower_kind(path: Path) -> str | None:
    """Return the kind of a tower's file or folder; None for one that is not of a tower.

    Returns
    -------
    str or None
        `store`, `record`, `calibration` (folders; a DuckDB file is a store), `tags`, `labels`, `events`, `points`,
        `datasheet`, or `part` for the description inside an aligned record.
    """
    try:
        if path.is_dir():
            return _of_folder(path)
        if not path.is_file():
            return None
        if path.suffix in (".duckdb", ".ddb", ".db"):
            return "store"
        if path.suffix == ".json":
            return _of_json(path)
        if path.suffix.lower() == ".csv":
            return _of_table(path)
    except OSError:
        return None
    return None


def _of_folder(path: Path) -> str | None:
    names = {one.name for one in path.iterdir()}
    if "calibrated.parquet" in names:
        return "calibration"
    if any(re.fullmatch(r"cell\d+\.parquet", name) for name in names) and names & OF_RECORD:
        return "record"
    if names & OF_RUN or "manifest.json" in names:
        return None
    deeper = (one.parent for one in path.glob("*/*.parquet"))
    if "tags.csv" in names or any(name.endswith(".parquet") for name in names) or not all(map(_is_run, deeper)):
        return "store"
    return "store" if any(name.lower().endswith(".csv") for name in names) else None


def _is_run(folder: Path) -> bool:
    """Return True for the folder of a run, whose record is no store."""
    return any((folder / name).exists() for name in OF_RUN)


def _of_json(path: Path) -> str | None:
    if path.stat().st_size > SHEET_BYTES and path.name not in OF_RECORD:
        return None
    if path.name in OF_RECORD and any(path.parent.glob("cell*.parquet")):
        return "part"
    try:
        found = parse_json(path.read_text(encoding="utf-8-sig"))
    except ValueError:
        return "datasheet" if path.name == "datasheet.json" else None
    return "datasheet" if isinstance(found, dict) and len(DATASHEET & set(found)) >= 2 else None


def _of_table(path: Path) -> str | None:
    with path.open("rb") as content:
        first = content.read(HEADING_BYTES).decode("utf-8-sig", errors="replace").split("\n", 1)[0]
    names = {name.strip().strip('"') for name in re.split(r"[,;\t]", first)}
    return next((kind for kind, wanted in HEADINGS.items() if wanted <= names), None)
