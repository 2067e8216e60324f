"""Shape of `run.json`: the entries that report, review and resume read, checked when it is read.

A manifest may come from anywhere. Other keys may hold anything.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from hil.files import Failure

Mode = Literal["real", "scaled", "lockstep"]
NetworkMode = Literal["shadow", "advisory", "controlled"]
_REQUIRED = ("virtual", "mode", "speed", "seed", "calibrators", "network_mode")


class DocumentShape(BaseModel):
    """Base of the shapes of JSON documents: values of the declared types exactly, other keys with any value."""

    model_config = ConfigDict(extra="allow", strict=True)


@dataclass(frozen=True, slots=True)
class Labels:
    """Labels of a run, as its operator gives them; empty where unknown."""

    test_object: str = ""
    serial_number: str = ""
    operator: str = ""
    tags: tuple[str, ...] = ()

    def given(self) -> dict[str, str | list[str]]:
        """Return the labels that are not empty, as plain data."""
        texts: dict[str, str | list[str]] = {
            "test_object": self.test_object,
            "serial_number": self.serial_number,
            "operator": self.operator,
            "tags": list(self.tags),
        }
        return {name: value for name, value in texts.items() if value}


class _Labels(DocumentShape):
    test_object: str = ""
    serial_number: str = ""
    operator: str = ""
    tags: list[str] = []


class _ManifestFile(DocumentShape):
    path: str
    sha256: str


class _Settings(DocumentShape):
    mode: Mode = "real"
    speed: float = 1.0
    virtual: bool = False
    control: tuple[str, int] | None = None
    seed: int = 0
    start_s: float = 0.0
    calibrators: list[str] = []
    network_mode: NetworkMode = "shadow"
    diagnose_s: float | Literal["end"] | None = None
    adopt: bool = False
    report: bool = True


class _Segment(DocumentShape):
    number: int
    from_s: float
    gap_s: float
    profile_s: float
    restore_s: float = 0.0
    soaked_s: float = 0.0  # name of `restore_s` before version 0.2
    why: str
    exit_status: str
    reason: str = ""


class _Errors(DocumentShape):
    columns: list[str]
    rows: dict[str, list[float | None]]
    noise_K: dict[str, float | None]


class _ManifestAdoption(DocumentShape):
    sentence: str


class _Manifest(DocumentShape):
    uid: str = ""
    started: str = ""
    ended: str | None = None
    exit_status: str
    reason: str = ""
    host: str = ""
    versions: dict[str, str] = {}
    files: dict[str, _ManifestFile] = {}
    settings: _Settings = Field(default_factory=_Settings)
    segments: list[_Segment] = []
    problems: list[str] = []
    safe: bool | None = None
    untouched: bool = False
    away: str = ""
    deviations: list[str] = []
    guardian: str = ""
    missing: dict[str, str] = {}
    overruns: int = 0
    rig_restarts: int = 0
    wall_s: float = 0.0
    errors_K: _Errors | None = None
    bands: dict[str, dict[str, tuple[float | None, float | None]]] | None = None
    parameters: dict[str, dict[str, tuple[float, float | None, bool]]] | None = None
    parameter_units: dict[str, str] | None = None
    adoption: _ManifestAdoption | None = None
    labels: _Labels = Field(default_factory=_Labels)
    verdict: Literal["pass", "fail", "inconclusive"] | None = None
    diagnosis: str | None = None


_LONGEST_SHOWN = 40
"""Characters of a key or value from a file that a message quotes."""


def wrong_place(error: ValidationError) -> str:
    """Return the first entry that a check of shapes refused, and the reason, as text for the user."""
    first = error.errors(include_url=False)[0]
    place = ".".join(ascii(part)[1:-1] if isinstance(part, str) else str(part) for part in first["loc"])
    given = ascii(first["input"])
    shown = given if len(given) <= _LONGEST_SHOWN else given[:_LONGEST_SHOWN] + "..."
    why = "is missing" if first["type"] == "missing" else f"cannot be {shown}"
    return f"{place[: 3 * _LONGEST_SHOWN] or 'the document'!r} {why}"


def checked_manifest(document: Any, path: Path, failure: Failure) -> dict[str, Any]:
    """Return the manifest with an empty value for each missing entry that a report shows.

    Raises
    ------
    failure
        An entry is of another type than a run writes, in one sentence.
    """
    try:
        _Manifest.model_validate(_as_tuples(document))
    except ValidationError as error:
        raise failure(
            f"{path} is not what a run writes: {wrong_place(error)}; the journal beside it still holds the run"
        ) from None
    empty = {"uid": "", "started": "", "host": "", "reason": "", "versions": {}, "files": {}, "settings": {}}
    checked: dict[str, Any] = empty | document
    return checked


_OF_AN_END = ("safe", "untouched", "away", "guardian", "trips", "problems", "deviations")
"""Entries of a manifest that describe how a run ended; they hold no longer once it goes on."""


def without_end(manifest: dict[str, Any]) -> dict[str, Any]:
    """Return a copy of `manifest` without the entries on an earlier end of its run."""
    return {key: value for key, value in manifest.items() if key not in _OF_AN_END}


def left_safe(manifest: dict[str, Any]) -> bool | None:
    """Return True where the run ended with its outputs at their safe values, read back, and False where it did not.

    None for a run that goes on or was interrupted: whatever `safe` says then is of an earlier end. None also for one
    that ended before it wrote to the rig or read what the rig held.
    """
    if manifest.get("exit_status") == "running" or manifest.get("safe") is None:
        return None
    return bool(manifest["safe"]) and not manifest.get("away")


def require_settings(settings: dict[str, Any], path: Path, failure: Failure) -> None:
    """Check that a manifest holds all settings for a resume; raises `failure`."""
    missing = [key for key in _REQUIRED if key not in settings]
    if missing:
        raise failure(f"{path} lacks settings.{missing[0]}, so the run cannot be resumed; start a new run")


def _as_tuples(document: Any) -> Any:
    """Return the document with tuples in place of lists of fixed length: JSON has no tuples."""
    if not isinstance(document, dict):
        return document
    found = dict(document)
    settings = found.get("settings")
    if isinstance(settings, dict) and isinstance(settings.get("control"), list):
        found["settings"] = settings | {"control": tuple(settings["control"])}
    for key in ("bands", "parameters"):
        tables = found.get(key)
        if isinstance(tables, dict):
            found[key] = {
                name: {k: tuple(v) if isinstance(v, list) else v for k, v in table.items()}
                if isinstance(table, dict)
                else table
                for name, table in tables.items()
            }
    return found


__all__ = ["DocumentShape", "Labels", "checked_manifest", "require_settings"]
