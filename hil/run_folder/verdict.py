"""Shape of `verdict.json`, the results of test plans on a run, checked when it is read: it may come from anywhere."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import ValidationError

from hil.files import read_json
from hil.run_folder.folder import RunFolder, RunFolderError
from hil.run_folder.manifest_check import DocumentShape, wrong_place

_Word = Literal["pass", "fail", "inconclusive"]


class _LimitResult(DocumentShape):
    id: str
    limit: str
    requirement: str
    severity: str
    step: str | None
    verdict: _Word
    value: float | None
    unit: str
    at_s: float | None
    text: str


class _TestResult(DocumentShape):
    id: str
    title: str
    sha256: str
    verdict: _Word
    judged: str
    limits: list[_LimitResult]


class _Verdict(DocumentShape):
    verdict: _Word
    tests: list[_TestResult]


def read_diagnosis_verdict(folder: RunFolder) -> tuple[str, str] | None:
    """Return verdict and sentence of the diagnosis in a run folder; None without a diagnosis that can be read."""
    try:
        document = read_json(folder.diagnosis / "diagnosis.json", RunFolderError)
    except (OSError, RunFolderError):
        return None
    if not isinstance(document, dict) or not isinstance(document.get("verdict"), str):
        return None
    return document["verdict"], str(document.get("sentence", ""))


def read_verdict(folder: RunFolder) -> dict[str, Any]:
    """Return the content of `verdict.json`; `verdict` is None and `tests` is empty for a run that was not judged.

    Raises
    ------
    RunFolderError
        The file is damaged.
    """
    remedy = "judge the run again with `hil test PLAN --on RUN`"
    try:
        document = read_json(folder.verdict, RunFolderError)
        _Verdict.model_validate(document)
    except FileNotFoundError:
        return {"verdict": None, "tests": []}
    except ValidationError as error:
        raise RunFolderError(
            f"{folder.verdict} is not what a test writes: {wrong_place(error)}; take it away, then {remedy}"
        ) from None
    except OSError as error:
        raise RunFolderError(f"{folder.verdict} cannot be read ({error.strerror}); {remedy}") from None
    found: dict[str, Any] = document
    return found
