"""Files of a run made from its journal after the run: for `hil report`, readers of its record, and its verdict."""

from __future__ import annotations

import datetime
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.files import require_writable
from hil.journal import ENDED, JournalError, JournalReader, export_record, recorded_rows
from hil.run.session.derived_files import RECORD, REVIEW, REVISION, VERDICT, DerivedFiles, derive_files
from hil.run.session.manifest import END_KEYS, END_OF_RUN, TWIN_KEYS, foreign_journal
from hil.run_folder import RunFolder, RunFolderError, read_verdict, without_end

if TYPE_CHECKING:
    from hil.testing import Plan, TestResult


_COPY = "make it writable, or copy the run and take the copy"
"""Remedy for the folder of a run in which no file can be made."""


def regenerate_files(folder: RunFolder, rebuild: bool, announce: Callable[[str], None]) -> DerivedFiles:
    """Make the missing files of the run in `folder`, and its report in any case.

    Parameters
    ----------
    folder
        Folder of a run that is not live.
    rebuild
        Make record and review anew, too.
    announce
        Gets a line for each file.

    Raises
    ------
    RunFolderError
        This is no run folder, its run still goes on, or its `run.json` cannot be written.
    JournalError
        The journal is missing or damaged.
    """
    folder.read_manifest()  # refuse a folder of something else before it is locked
    require_writable(folder.path, RunFolderError, _COPY)
    with folder.owned():
        before = folder.read_manifest()
        finished = before.get("exit_status") != "running"
        manifest = completed_manifest(folder, before)
        # A process that was killed after the end of its run has noted no missing files.
        wanted = manifest.get("missing", {}) if finished or manifest is before else (REVISION, VERDICT)
        omitted = [name for name in (REVISION, VERDICT) if name not in wanted]
        if not rebuild:
            current = {
                RECORD: folder.is_current(folder.record) and not _lacks_ticks(folder),  # a copy may have any times
                REVIEW: folder.is_review_current(finished=finished),
            }
            omitted += [name for name, is_current in current.items() if is_current]
        if manifest.get("exit_status") == "done" and _lacks_diagnosis(folder, manifest):
            run = shlex.quote(str(folder.path))
            announce(f"the run was killed before its diagnosis was made; `hil diagnose {run}` makes it")
        return derive_files(folder, manifest, announce, omitted=omitted)


def _lacks_diagnosis(folder: RunFolder, manifest: dict[str, Any]) -> bool:
    """Return True for a run that was killed before its diagnosis, or before it noted why there is none."""
    asked = manifest["settings"].get("diagnose_s") is not None
    return asked and "diagnosis" not in manifest and not (folder.diagnosis / "diagnosis.json").is_file()


def current_record(folder: RunFolder, announce: Callable[[str], None]) -> Path:
    """Return the record of a run, made from its journal where it is missing or lacks ticks of the journal.

    A run that was resumed and killed has such a record. Every reader of a run's record calls this.

    Parameters
    ----------
    folder
        Folder of a run that has ended, or folder with a record alone.
    announce
        Gets a line where an existing record is made anew.

    Raises
    ------
    RunFolderError
        There is neither a record nor a run, the run still goes on or was interrupted, or no record can be made; the
        message names the remedy.
    """
    is_there = folder.record.is_file()
    if is_there and not _lacks_ticks(folder):
        return folder.record
    if not folder.manifest.is_file() or not folder.journal.is_file():
        raise RunFolderError(f"{folder.path} holds no {RECORD}; give a run folder of a finished run, or a record")
    state = f"lacks the last ticks of {folder.journal.name}" if is_there else "is not there"
    try:
        with folder.owned():
            manifest = completed_manifest(folder, folder.read_manifest())
            if manifest.get("exit_status") == "running":
                run = shlex.quote(str(folder.path))
                raise RunFolderError(
                    f"{folder.record} {state}, because the run was interrupted; `hil resume {run}` continues it, and "
                    f"`hil report {run}` makes the record as far as it came"
                )
            if (foreign := foreign_journal(folder, manifest)) is not None:
                raise RunFolderError(foreign)
            if is_there:
                announce(f"writing {folder.record}, which lacked the last ticks of {folder.journal.name}")
            export_record(folder.journal, folder.record)
    except (JournalError, OSError) as error:
        raise RunFolderError(f"{folder.record} {state}, and none can be made from its journal: {error}") from error
    return folder.record


def _lacks_ticks(folder: RunFolder) -> bool:
    """Return True for a record with fewer rows than its journal has ticks, or an older one that no run wrote."""
    if not folder.manifest.is_file() or not folder.journal.is_file():
        return False
    rows = recorded_rows(folder.record)
    try:
        reader = JournalReader(folder.journal)
        try:
            ticks = reader.sample_count()
        finally:
            reader.close()
    except JournalError:
        return not folder.is_current(folder.record)
    return rows < ticks if rows is not None else not folder.is_current(folder.record)


def judge_recorded(plan: Plan, folder: RunFolder) -> TestResult:
    """Judge the run in `folder`; write `verdict.json`, `junit.xml` and the report.

    Raises
    ------
    RunFolderError
        This is no run folder, or its run still goes on.
    TestPlanError, JournalError
        A limit does not fit the run; the journal is missing or damaged.
    """
    from hil.report import write_report
    from hil.testing import judge_run

    folder.read_manifest()  # refuse a folder of something else before it is locked
    require_writable(folder.path, RunFolderError, _COPY)
    with folder.owned():
        result = judge_run(plan, folder)
        folder.write_manifest(folder.read_manifest() | {"verdict": read_verdict(folder)["verdict"]})
        write_report(folder)
    return result


def completed_manifest(folder: RunFolder, manifest: dict[str, Any]) -> dict[str, Any]:
    """Return `manifest` with the end of the run, where its process was killed before it could write that.

    The manifest of an interrupted run, which has not ended, is returned unchanged. Raises JournalError.
    """
    if manifest.get("exit_status") != "running":
        return manifest
    reader = JournalReader(folder.journal)
    try:
        states = reader.states()
        tick, _ = reader.last()
        noted = reader.meta(END_OF_RUN)
    finally:
        reader.close()
    if not states or states[-1].target not in ENDED:
        return manifest
    end = {key: noted[key] for key in (*END_KEYS, *TWIN_KEYS) if key in noted} if isinstance(noted, dict) else {}
    last = states[-1]
    ended = datetime.datetime.fromtimestamp(last.wall_s, datetime.UTC).isoformat(timespec="seconds")
    return (
        without_end(manifest)
        | {
            "ended": ended,
            "exit_status": last.target,
            "reason": last.reason,
            "ticks": tick + 1,
        }
        | end
    )


def has_ended(folder: RunFolder) -> bool:
    """Return True where `run.json` or the journal states that the run in `folder` went to its end."""
    try:
        return completed_manifest(folder, folder.read_manifest()).get("exit_status", "").startswith("done")
    except (RunFolderError, KeyError):
        return False
