"""Judgement of a plan on a recorded run, whose folder gets the results."""

from __future__ import annotations

from hil.journal import JournalReader
from hil.run_folder import RunFolder
from hil.testing.bound_limits import bind
from hil.testing.judgement import judge_all
from hil.testing.plan import Plan, TestPlanError
from hil.testing.results import TestResult, write_results
from hil.testing.run_data import read_run, signals_of_run


def judge_run(plan: Plan, folder: RunFolder) -> TestResult:
    """Judge a run that is not live, write `verdict.json` and `junit.xml` into its folder, and return the result.

    Raises
    ------
    TestPlanError
        The plan is for another profile, or a limit does not fit the run.
    JournalError, RunFolderError
        The run cannot be read.
    """
    manifest = folder.read_manifest()
    _require_profile(plan, manifest, folder)
    reader = JournalReader(folder.journal)
    try:
        limits = bind(plan, signals_of_run(reader, f"run {folder.path.name}"))
        result = TestResult(plan, judge_all(limits, read_run(folder, reader)))
    finally:
        reader.close()
    write_results(folder, result)
    return result


def _require_profile(plan: Plan, manifest: dict[str, object], folder: RunFolder) -> None:
    """Check that the run replayed the profile of the plan, by its content; a plan without a profile takes any."""
    from drivers.rig_file import file_sha256

    files = manifest["files"]
    replayed = files.get("profile") if isinstance(files, dict) else None
    if plan.profile is None or replayed is None:
        return
    if replayed["sha256"] != file_sha256(plan.profile):
        raise TestPlanError(
            f"{plan.place}: profile: the run {folder.path} replayed {replayed['path']}, whose content is not that of "
            f"{plan.profile}; judge a run of this profile, or take `profile` out of the plan"
        )
