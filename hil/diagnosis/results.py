"""Results of a diagnosis as files: document, curves and page, with the provenance of its inputs."""

from __future__ import annotations

import datetime
import json
import platform
from collections.abc import Callable, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from drivers.rig_file import file_sha256
from hil import __version__
from hil.diagnosis.store import CURVES, DOCUMENT, PAGE, REVIEW, curves_of, write_curves, write_document
from twin.discovery import Diagnosis


def provenance(
    files: dict[str, Path | None],
    samples_sha256: str | None,
    options: Sequence[str] = (),
    named: Callable[[Path], str] = str,
) -> dict[str, object]:
    """Return the hash of each file, versions, host and time.

    Parameters
    ----------
    files
        Files by their names in the document.
    samples_sha256
        Digest of the samples that were diagnosed (`hil.journal.samples_sha256`); None for a record of other origin.
    options
        Options of the command that change what the diagnosis can find.
    named
        Function that returns the path of a file in the document.
    """
    return {
        "files": {
            name: {"path": named(path), "sha256": file_sha256(path)} for name, path in files.items() if path is not None
        },
        "samples_sha256": samples_sha256,
        "options": list(options),
        "versions": {
            "hil": __version__,
            "python": platform.python_version(),
            **{name: metadata.version(name) for name in ("numpy", "scipy", "llvmlite", "pyarrow", "matplotlib")},
        },
        "made": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "host": platform.node(),
    }


def write(diagnosis: Diagnosis, sensors: tuple[str, ...], out: Path, extra: dict[str, object]) -> Path:
    """Write document, curves and page into the folder; return the page. `sensors` are the twin's.

    A diagnosis that was made there with another twin is kept in a folder below, `before-1` and so on.
    """
    from hil.diagnosis.page import write_page

    write_data(diagnosis, sensors, out, extra)
    return write_page(out)


def write_data(diagnosis: Diagnosis, sensors: tuple[str, ...], out: Path, extra: dict[str, object]) -> None:
    """Write document and curves as `write` does, without the page."""
    _keep_other(out, _twin_of(extra))
    out.mkdir(parents=True, exist_ok=True)
    write_document({**diagnosis.document(), **extra}, out)
    write_curves(curves_of(diagnosis, sensors), out / CURVES)


def _keep_other(folder: Path, twin: str | None) -> None:
    """Move the files of a diagnosis with another twin than that of this SHA-256 out of the way."""
    try:
        there = _twin_of(json.loads((folder / DOCUMENT).read_bytes()))
    except (OSError, ValueError):
        return
    if there is None or there == twin:
        return
    number = 1
    while (kept := folder / f"before-{number}").exists():
        number += 1
    kept.mkdir()
    for name in (DOCUMENT, CURVES, PAGE, REVIEW):
        if (folder / name).is_file():
            (folder / name).rename(kept / name)


def _twin_of(document: Mapping[str, Any]) -> str | None:
    """Return the SHA-256 of the twin of a diagnosis, None where it does not say."""
    try:
        return str(document["provenance"]["files"]["twin"]["sha256"])
    except (KeyError, TypeError):
        return None
