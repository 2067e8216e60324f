"""Judgement of a recorded run by a test plan, with its report made anew."""

from __future__ import annotations

from hil.report import write_report
from hil.run_folder import RunFolder, read_verdict
from hil.testing import Plan, TestResult, judge_run


def judge_recorded(plan: Plan, folder: RunFolder) -> TestResult:
    """Judge the run in `folder`; write `verdict.json`, `junit.xml` and the report.

    Raises
    ------
    RunFolderError
        This is no run folder, or its run still goes on.
    TestPlanError, JournalError
        A limit does not fit the run; the journal is missing or damaged.
    """
    folder.read_manifest()  # refuse a folder of something else before it is locked
    with folder.owned():
        result = judge_run(plan, folder)
        folder.write_manifest(folder.read_manifest() | {"verdict": read_verdict(folder)["verdict"]})
        write_report(folder)
    return result
