"""Files that a person gives for a tower: CSV tables and JSON objects, read whole, and regular files alone."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

from drivers.rig_file import read_regular
from hil.record import RecordError


def read_rows(path: Path, required: tuple[str, ...]) -> list[tuple[int, dict[str, str]]]:
    """Return the rows of a CSV table with their line numbers; cells without the blanks around them.

    Raises
    ------
    RecordError
        The file cannot be read, is no UTF-8 text, or lacks a column.
    """
    reader = csv.DictReader(_text(path).splitlines())
    missing = [name for name in required if name not in (reader.fieldnames or ())]
    if missing:
        have = ", ".join(reader.fieldnames or ()) or "nothing"
        raise RecordError(f"{path}: lacks the column {', '.join(missing)}; its first line has {have}")
    return [(reader.line_num, {k: (v or "").strip() for k, v in row.items() if k}) for row in reader]


def read_object(path: Path) -> dict[str, Any]:
    """Return the object of a JSON file.

    Raises
    ------
    RecordError
        The file cannot be read, is not JSON or not an object.
    """
    try:
        found = json.loads(_text(path))
    except ValueError as error:
        raise RecordError(f"{path}: is not valid JSON: {error}") from error
    if not isinstance(found, dict):
        raise RecordError(f"{path}: is not a JSON object; a datasheet has keys such as design and fan")
    return found


def _text(path: Path) -> str:
    try:
        return read_regular(path).decode("utf-8-sig")
    except OSError as error:
        raise RecordError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise RecordError(f"{path}: cannot be read: it is no UTF-8 text") from error
