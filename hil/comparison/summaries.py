"""One line for each run of a folder: verdict, end, rig, profile, duration, labels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hil.journal import JournalError, JournalReader
from hil.run_folder import RunFolder, RunFolderError, labels_of, read_notes, read_verdict


@dataclass(frozen=True, slots=True)
class RunSummary:
    """Summary of a run. `verdict` is None where it was not judged, `duration_s` where its journal cannot be read.

    `problem` says why a folder cannot be read; the other entries are empty then.
    """

    folder: str
    started: str = ""
    exit_status: str = ""
    verdict: str | None = None
    rig: str = ""
    profile: str = ""
    duration_s: float | None = None
    test_object: str = ""
    serial_number: str = ""
    operator: str = ""
    tags: tuple[str, ...] = ()
    notes: int = 0
    problem: str = ""

    def document(self) -> dict[str, Any]:
        """Return the summary as plain data."""
        return asdict(self) | {"tags": list(self.tags)}


def run_summaries(runs: Path) -> list[RunSummary]:
    """Return the summaries of all run folders in `runs`, in the order of their beginning.

    A folder that is damaged is reported with its problem.

    Raises
    ------
    RunFolderError
        There is no such folder.
    """
    try:
        folders = sorted(path for path in runs.iterdir() if path.is_dir() and (path / "run.json").exists())
    except OSError as error:
        raise RunFolderError(f"{runs} cannot be read ({error.strerror}); name the parent of the runs") from None
    return sorted(_summaries(folders), key=lambda summary: (summary.started, summary.folder))


def _summaries(folders: list[Path]) -> Iterator[RunSummary]:
    for path in folders:
        folder = RunFolder(path)
        try:
            yield _summary(folder)
        except RunFolderError as error:
            yield RunSummary(str(path), problem=str(error))


def _summary(folder: RunFolder) -> RunSummary:
    manifest, notes = folder.read_manifest(), read_notes(folder)
    labels = labels_of(manifest, notes)
    files = manifest["files"]
    status = manifest["exit_status"]
    return RunSummary(
        str(folder.path),
        manifest["started"],
        "interrupted" if status == "running" and folder.was_cut else status,
        read_verdict(folder)["verdict"],
        Path(files["rig"]["path"]).stem if "rig" in files else "",
        Path(files["profile"]["path"]).stem if "profile" in files else "",
        _duration_s(folder),
        labels.test_object,
        labels.serial_number,
        labels.operator,
        labels.tags,
        len(notes),
    )


def _duration_s(folder: RunFolder) -> float | None:
    """Return the time of the last row of a run, s."""
    try:
        reader = JournalReader(folder.journal)
        try:
            return (reader.last()[0] + 1) * reader.header.period_s
        finally:
            reader.close()
    except JournalError:
        return None
