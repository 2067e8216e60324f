"""Append-only files of JSON lines in a run's folder: notes, and acts on alarms."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from hil.files import Failure, append_line, parse_json, plain, read_lines
from hil.run_folder.manifest_check import DocumentShape, wrong_place

MOST_BYTES = 8 * 10**6
"""Most bytes of a file: some ten thousand notes, or forty thousand acts on alarms."""

Shape = TypeVar("Shape", bound=DocumentShape)


def append_json_line(path: Path, document: Mapping[str, Any], failure: Failure) -> None:
    """Append a document as a line, and have it on the disk before this returns.

    Raises
    ------
    failure
        The file cannot be written; one sentence.
    """
    try:
        append_line(path, json.dumps(document))
    except OSError as error:
        raise failure(f"{path} cannot be written ({error.strerror}); make room or writable") from None


def read_json_lines(path: Path, shape: type[Shape], what: str, failure: Failure) -> list[tuple[str, Shape]]:
    """Return the documents of a file in order, each with its place for messages.

    A file that is not there has none, and a last line that a crash cut is left out.

    Parameters
    ----------
    path
        File, of which at most `MOST_BYTES` are read.
    shape
        Shape of a line.
    what
        What a damaged line is not, as `no act on an alarm`.
    failure
        Exception to raise.

    Raises
    ------
    failure
        The file cannot be read, or a line is damaged; the message names the line and the remedy.
    """
    try:
        lines = read_lines(path, MOST_BYTES)
    except OSError as error:
        raise failure(f"{path} cannot be read ({error.strerror}); take it away") from None
    found = []
    for number, line in lines:
        place = f"{path}, line {number}"
        try:
            found.append((place, shape.model_validate(parse_json(line))))
        except ValidationError as error:
            raise failure(f"{place} is {what}: {wrong_place(error)}; take the line out") from None
        except ValueError as error:
            raise failure(f"{place} is {what} ({plain(str(error), 100)}); take the line out") from None
    return found
