"""Files that a person gives for a tower: CSV tables and JSON objects, read whole, and regular files alone."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

from drivers.rig_file import read_regular
from hil.files import parse_json
from hil.record import RecordError
from hil.tower.station.errors import TableError
from hil.tower.station.json_shape import Shape, misfit, misfits

OTHER_MARKS = {
    mark: f": its columns are separated by {name}; save it with commas, and decimals with points"
    for mark, name in ((";", "semicolons"), ("\t", "tabs"))
}
DATASHEET: Shape = {
    "station?": str,
    "timezone?": str,
    "cells_in_station?": int,
    "design?": {
        "water_flow_kg_s?": float,
        "water_to_air?": float,
        "water_inlet_C?": (0.0, 70.0),
        "wet_bulb_C?": (-30.0, 40.0),
        "range_K?": (0.5, 50.0),
        "pressure_kPa?": float,
    },
    "fan?": {},
    "bypass?": {"share_when_open?": (0.0, 1.0)},
    "basin?": {"volume_m3?": float, "compartments?": int, "first_compartment_cells?": [int]},
}
"""Keys of a datasheet that commands use by name, with the ranges of liquid water, weather and shares; further ones are
passed on as they are."""


def read_rows(path: Path, required: tuple[str, ...]) -> list[tuple[int, dict[str, str]]]:
    """Return the rows of a CSV table with their line numbers; cells without the blanks around them.

    Raises
    ------
    RecordError
        The file cannot be read, is no UTF-8 text, or lacks a column.
    """
    # Only line feeds and carriage returns end a line of a CSV table, not the further characters of `str.splitlines`.
    reader = csv.DictReader(io.StringIO(_text(path), newline=""))
    try:
        reader.fieldnames = [name.strip() for name in reader.fieldnames or ()]
        missing = [name for name in required if name not in reader.fieldnames]
        if missing:
            have = ", ".join(reader.fieldnames or ()) or "nothing"
            other = next((words for mark, words in OTHER_MARKS.items() if mark in have), "")
            raise RecordError(f"{path}: lacks the column {', '.join(missing)}; its first line has {have}{other}")
        return [(reader.line_num, {k: (v or "").strip() for k, v in row.items() if k}) for row in reader]
    except csv.Error as error:
        raise RecordError(
            f"{path}:{reader.line_num + 1}: is no line of a CSV table ({error}); is a quotation mark missing?"
        ) from error


def read_object(path: Path, shape: Shape, remedy: str) -> dict[str, Any]:
    """Return the object of a JSON file, without keys whose value is null.

    Parameters
    ----------
    path
        The file.
    shape
        What it has to hold (`json_shape`).
    remedy
        What to do with a file that does not hold it.

    Raises
    ------
    RecordError
        The file cannot be read, is not JSON, or not of that shape.
    """
    found = _object(path, remedy)
    if fault := misfit(found, shape):
        raise RecordError(f"{path}: {fault}; {remedy}")
    return found


def read_datasheet(path: Path) -> dict[str, Any]:
    """Return the datasheet of a station.

    Raises
    ------
    RecordError
        The file cannot be read, or none of its keys has a value.
    TableError
        Keys that are used have another type.
    """
    remedy = "correct the datasheet"
    found = _object(path, remedy)
    if faults := [f"{path}: {fault}; {remedy}" for fault in misfits(found, DATASHEET)]:
        raise TableError(path, faults)
    if parse_json(_text(path)) and not _holds_value(found):
        raise RecordError(f"{path}: none of its keys has a value; {remedy}")
    return found


def _object(path: Path, remedy: str) -> dict[str, Any]:
    """Return the object of a JSON file, without keys whose value is null; raises RecordError."""
    try:
        found = _without_nulls(parse_json(_text(path)))
    except ValueError as error:
        raise RecordError(f"{path}: is not valid JSON: {error}; {remedy}") from error
    if not isinstance(found, dict):
        raise RecordError(f"{path}: is not a JSON object; {remedy}")
    return found


def _without_nulls(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_nulls(one) for key, one in value.items() if one is not None}
    return [_without_nulls(one) for one in value] if isinstance(value, list) else value


def _holds_value(value: Any) -> bool:
    return any(map(_holds_value, value.values())) if isinstance(value, dict) else value is not None


def _text(path: Path) -> str:
    try:
        return read_regular(path).decode("utf-8-sig")
    except OSError as error:
        raise RecordError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise RecordError(f"{path}: cannot be read: it is no UTF-8 text") from error
