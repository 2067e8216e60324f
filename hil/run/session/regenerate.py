"""Files of a run made from its journal after the run: for `hil report`, and the verdict of a recorded run."""

from __future__ import annotations

import datetime
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from hil.journal import ENDED, JournalReader
from hil.run.session.derived_files import RECORD, REVIEW, REVISION, VERDICT, DerivedFiles, derive_files
from hil.run_folder import RunFolder, RunFolderError, read_verdict, without_end

if TYPE_CHECKING:
    from hil.testing import Plan, TestResult


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
    with folder.owned():
        manifest = completed_manifest(folder, folder.read_manifest())
        wanted = manifest.get("missing", {})
        there = [name for name in (REVISION, VERDICT) if name not in wanted]
        if not rebuild:
            files = {RECORD: folder.record, REVIEW: folder.review}
            there += [name for name, path in files.items() if folder.is_current(path)]
        return derive_files(folder, manifest, announce, there=there)


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
    finally:
        reader.close()
    if not states or states[-1].target not in ENDED:
        return manifest
    last = states[-1]
    ended = datetime.datetime.fromtimestamp(last.wall_s, datetime.UTC).isoformat(timespec="seconds")
    return without_end(manifest) | {
        "ended": ended,
        "exit_status": last.target,
        "reason": last.reason,
        "ticks": tick + 1,
    }


def has_ended(folder: RunFolder) -> bool:
    """Return True where `run.json` or the journal states that the run in `folder` went to its end."""
    try:
        return completed_manifest(folder, folder.read_manifest()).get("exit_status", "").startswith("done")
    except (RunFolderError, KeyError):
        return False
