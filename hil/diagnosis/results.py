"""Results of a diagnosis as files: document, curves and page, with the provenance of its inputs."""

from __future__ import annotations

import datetime
import platform
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path

from drivers.rig_file import file_sha256
from hil import __version__
from hil.diagnosis.store import CURVES, curves_of, write_curves, write_document
from twin.discovery import Diagnosis


def provenance(
    files: dict[str, Path | None], samples_sha256: str | None, options: Sequence[str] = ()
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
    """
    return {
        "files": {
            name: {"path": str(path), "sha256": file_sha256(path)} for name, path in files.items() if path is not None
        },
        "samples_sha256": samples_sha256,
        "options": list(options),
        "versions": {
            "hil": __version__,
            "python": platform.python_version(),
            **{name: metadata.version(name) for name in ("numpy", "scipy", "numba", "pyarrow", "matplotlib")},
        },
        "made": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "host": platform.node(),
    }


def write(diagnosis: Diagnosis, sensors: tuple[str, ...], out: Path, extra: dict[str, object]) -> Path:
    """Write document, curves and page into the folder; return the page. `sensors` are the twin's."""
    from hil.diagnosis.page import write_page

    out.mkdir(parents=True, exist_ok=True)
    write_document({**diagnosis.document(), **extra}, out)
    write_curves(curves_of(diagnosis, sensors), out / CURVES)
    return write_page(out)
