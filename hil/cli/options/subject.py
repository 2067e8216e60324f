"""Subject of a command about a record: the record and its twin, named one by one or by the folder of a run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import click

from hil.run_folder import RunFolder, RunFolderError


class SubjectError(ValueError):
    """Error of a record or twin that does not exist; the message is one plain sentence."""


@dataclass(frozen=True)
class RecordAndTwin:
    """Files of a record and its twin, and the folder of their run or None."""

    record: Path
    twin: Path
    run: Path | None

    @property
    def diagnosis(self) -> Path:
        """Return the default folder for its diagnosis."""
        if self.run is not None:
            return RunFolder(self.run).diagnosis
        return Path(f"diagnosis-{self.record.parent.name or self.record.stem}-{self.record.stem}")


def record_of(target: Path) -> Path:
    """Resolve a record file, or a run folder to its record, which is made if an ended run has none with all ticks.

    The record in a run folder is checked, too, where it is named as a file.

    Raises
    ------
    SubjectError
        The folder has no record and none can be made.
    """
    folder = RunFolder(target if target.is_dir() else target.parent)
    if not target.is_dir() and not (target.name == folder.record.name and folder.manifest.is_file()):
        return target
    from hil.run.session import current_record

    try:
        return current_record(folder, lambda text: click.echo(text, err=True))
    except RunFolderError as error:
        raise SubjectError(str(error)) from error


def subject_of(target: Path, twin: Path | None) -> RecordAndTwin:
    """Resolve a record file or a run folder; `twin` replaces the run's own.

    Raises
    ------
    SubjectError
        A part is missing.
    """
    if not target.is_dir():
        if target.suffix == ".toml":
            raise SubjectError(f"{target} is no record; give a run folder or a record first, and a twin with --twin")
        if twin is None:
            raise SubjectError(f"{target} is a record and names no twin; name it with --twin")
        return RecordAndTwin(record_of(target), twin, None)
    folder, record = RunFolder(target), record_of(target)
    chosen = twin or folder.twin
    if not chosen.is_file():
        raise SubjectError(f"{target} holds no twin.toml; name the twin with --twin")
    return RecordAndTwin(record, chosen, target)
