"""Reader of rig files: TOML text to a validated `Rig`.

Every mistake is reported with the file, the line, the key and what to do about it; all mistakes of a file come in one
`RigFileError`.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from drivers.rig_file.checks import cross_checks
from drivers.rig_file.messages import sentence
from drivers.rig_file.model import Rig
from drivers.rig_file.text import MOST_DESCRIPTION, line_of, read_regular, tables_of
from drivers.signals import ConfigurationError


class RigFileError(ConfigurationError):
    """Rig file that cannot be used; one sentence a mistake, each with line, key and remedy."""


_OTHER_KINDS = {
    "elements": "a twin file and no rig file; give it with --twin",
    "effect": "an effects file and no rig file; give it with --with",
    "system": "a scenario and no rig file; `hil profile build {}` makes a load profile of it",
    "limit": "a test plan and no rig file; give it with --test",
    "inputs": "a Telegraf configuration; `hil init --from {}` makes a rig file of it",
}
"""Keys at the top of files of other kinds, with what to do with them."""
_FILES = ("dbc", "ca", "certificate", "key")


def load_rig(path: Path) -> Rig:
    """Read and validate a rig file; raise RigFileError with every mistake in it."""
    try:
        text, document = tables_of(read_regular(path))
    except FileNotFoundError:
        raise RigFileError(f"{path}: there is no such file; give the path of a rig file") from None
    except OSError as error:
        raise RigFileError(f"{path}: cannot be read ({error.strerror or error}); give the path of a rig file") from None
    except ValueError as error:
        raise RigFileError(f"{path}: {error}") from None
    if document.keys().isdisjoint(("rig", "bus", "point")):
        for key, kind in _OTHER_KINDS.items():
            if key in document:
                raise RigFileError(f"{path}, line {line_of(text, (key,))}: is {kind.format(path)}")
    mistakes = [f"{path}, line {line_of(text, place)}: {what}" for place, what in _misshapen(document)]
    if mistakes:
        raise RigFileError("\n".join(mistakes))
    for section in document.get("bus", {}).values():
        for key in _FILES:
            if isinstance(section.get(key), str):
                section[key] = os.path.normpath(path.parent / section[key])
    document = {**document.pop("rig", {}), **document}
    if isinstance(document.get("twin"), str):
        document["twin"] = os.path.normpath(path.parent / document["twin"])
    try:
        rig = Rig.model_validate(document)
    except ValidationError as error:
        sentences = [sentence(path, text, item) for item in error.errors()]
        raise RigFileError("\n".join(dict.fromkeys(sentences))) from None
    mistakes = [f"{path}, line {line_of(text, place)}: {what}" for place, what in cross_checks(rig)]
    if mistakes:
        raise RigFileError("\n".join(mistakes))
    return rig


def _misshapen(document: dict[str, Any]) -> list[tuple[tuple[Any, ...], str]]:
    """Return the sections of a document that are no table or list of tables, each with its place and the remedy."""
    found: list[tuple[tuple[Any, ...], str]] = []
    for key in ("rig", "bus", "heartbeat"):
        if not isinstance(document.get(key, {}), dict):
            heading = "[bus.NAME]" if key == "bus" else f"[{key}]"
            where = f"; a key {key!r} of a point stands below its [[point]]" if key == "bus" else ""
            found.append(((key,), f"{key} must be a section, {heading}{where}"))
    for key in ("point", "interlock", "alarm"):
        items = document.get(key, [])
        if not isinstance(items, list) or not all(isinstance(item, dict) for item in items):
            found.append(((key,), f"{key} must be sections with two brackets, [[{key}]]"))
    if found:
        return found
    for name, section in document.get("bus", {}).items():
        if not isinstance(section, dict):
            found.append((("bus", name), f"bus.{name} must be a section, [bus.{name}], with transport and its keys"))
    for key in document.get("rig", {}):
        if key in document:
            found.append(((key,), f"{key} is there twice, above [rig] and in it; take one out"))
    return found


def located(path: Path, mistakes: Sequence[tuple[Sequence[Any], str]]) -> RigFileError:
    """Return the error of mistakes found in a rig file after it was read, each with its place in the document."""
    text = read_regular(path).decode("utf-8")
    return RigFileError("\n".join(f"{path}, line {line_of(text, place)}: {what}" for place, what in mistakes))


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, in hexadecimal; raise OSError."""
    return hashlib.sha256(read_regular(path, MOST_DESCRIPTION)).hexdigest()
