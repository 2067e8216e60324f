"""Subject of a command about a record: the record and its twin, named one by one or by the folder of a run."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path

from hil.journal import JournalError, export_record
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
    """Resolve a record file, or a run folder to its record, which is made if an ended run has none.

    Raises
    ------
    SubjectError
        The folder has no record and none can be made.
    """
    if not target.is_dir():
        return target
    folder = RunFolder(target)
    if not folder.record.is_file():
        if folder.was_cut:
            name = shlex.quote(str(target))
            raise SubjectError(
                f"{target} was interrupted and has no record yet; `hil report {name}` makes one without heating "
                f"anything, `hil resume {name}` continues the run"
            )
        _make_record(folder)
    return folder.record


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
        return RecordAndTwin(target, twin, None)
    folder, record = RunFolder(target), record_of(target)
    chosen = twin or folder.twin
    if not chosen.is_file():
        raise SubjectError(f"{target} holds no twin.toml; name the twin with --twin")
    return RecordAndTwin(record, chosen, target)


def _make_record(folder: RunFolder) -> None:
    """Make the record of a run that ended without one; raise SubjectError if that is not possible."""
    if not folder.manifest.is_file() or not folder.journal.is_file():
        raise SubjectError(f"{folder.path} holds no record.parquet; give a run folder of a finished run, or a record")
    try:
        with folder.owned():
            export_record(folder.journal, folder.record)
    except RunFolderError as error:
        raise SubjectError(str(error)) from None
    except (JournalError, OSError) as error:
        raise SubjectError(
            f"{folder.path} holds no record.parquet, and none can be made from its journal: {error}"
        ) from error
