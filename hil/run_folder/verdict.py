"""Verdicts on a run: `verdict.json`, the results of test plans, and the verdict of the run's diagnosis.

Both are checked when they are read: they may come from anywhere.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError

from drivers.rig_file import file_sha256
from hil.files import read_json
from hil.run_folder.folder import RunFolder, RunFolderError
from hil.run_folder.manifest_check import DocumentShape, wrong_place

_Word = Literal["pass", "fail", "inconclusive"]
_Number = Annotated[float, Field(allow_inf_nan=False)]
_ORDER: tuple[_Word, ...] = ("pass", "inconclusive", "fail")


class _Line(DocumentShape):
    columns: list[str]
    levels: list[_Number]
    from_s: _Number
    to_s: _Number


class _Span(DocumentShape):
    from_s: _Number
    to_s: _Number


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
    line: _Line | None = None
    failed_s: list[_Span] = Field(default_factory=list)


class _EarlierVerdict(DocumentShape):
    sha256: str
    judged: str
    verdict: _Word
    failed: list[str]


class _TestResult(DocumentShape):
    id: str
    title: str
    sha256: str
    verdict: _Word
    judged: str
    limits: list[_LimitResult]
    history: list[_EarlierVerdict] = Field(default_factory=list)


class _Verdict(DocumentShape):
    verdict: _Word
    tests: list[_TestResult]


@dataclass(frozen=True, slots=True)
class DiagnosisVerdict:
    """Verdict of the diagnosis in a run folder, and its summary.

    `samples_sha256` is the digest of the samples that were diagnosed, None where it is not stated. `doubts` state, as
    clauses, why the diagnosis is not of the twin of the run as it ran; empty for one that is.
    """

    verdict: str
    summary: str
    samples_sha256: str | None = None
    doubts: tuple[str, ...] = ()

    def __str__(self) -> str:
        return ": ".join(filter(None, (self.verdict, self.summary))) + "".join(f" ({text})" for text in self.doubts)


def read_diagnosis_verdict(folder: RunFolder) -> DiagnosisVerdict | None:
    """Return the verdict of the diagnosis in a run folder; None without a diagnosis that can be read."""
    try:
        document = read_json(folder.diagnosis / "diagnosis.json", RunFolderError)
    except (OSError, RunFolderError):
        return None
    if not isinstance(document, dict) or not isinstance(document.get("verdict"), str):
        return None
    source = document.get("provenance")
    source = source if isinstance(source, dict) else {}
    digest, summary = source.get("samples_sha256"), document.get("summary", "")
    return DiagnosisVerdict(
        document["verdict"],
        summary.strip().rstrip(".") if isinstance(summary, str) else "",
        digest if isinstance(digest, str) else None,
        (*_doubts_of_twin(folder, source), *_doubts_of_options(source)),
    )


def _doubts_of_twin(folder: RunFolder, source: dict[str, Any]) -> list[str]:
    """Return the doubt that a diagnosis is of another twin than the run's, by their content."""
    diagnosed = _file(source.get("files"), "twin")
    if diagnosed is None:
        return ["it does not state its twin"]
    try:
        ran_with = _file(folder.read_manifest()["files"], "twin")
        digest = file_sha256(folder.twin) if ran_with is None else ran_with["sha256"]
    except (OSError, RunFolderError):
        return ["the twin of the run is unknown"]
    if diagnosed["sha256"] == digest:
        return []
    return [f"it is of the twin {Path(diagnosed['path']).name}, whose content is not that of the twin of the run"]


def _doubts_of_options(source: dict[str, Any]) -> list[str]:
    """Return the doubt that a diagnosis was made with options that change what it can find."""
    options = source.get("options")
    if not isinstance(options, list) or not options:
        return []
    return [f"it was made with {', '.join(map(str, options))}"]


def _file(files: object, name: str) -> dict[str, str] | None:
    """Return path and SHA-256 of an entry of `files`; None where it is not complete."""
    entry = files.get(name) if isinstance(files, dict) else None
    if not isinstance(entry, dict) or not all(isinstance(entry.get(key), str) for key in ("path", "sha256")):
        return None
    return entry


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
    for what, word, parts in (
        *((f"test {test['id']}", test["verdict"], test["limits"]) for test in found["tests"]),
        ("the run", found["verdict"], found["tests"]),
    ):
        if word != _worst(part["verdict"] for part in parts):
            raise RunFolderError(
                f"{folder.verdict} says {word} of {what}, and the verdicts in it do not give that: it was changed by "
                f"hand; take it away, then {remedy}"
            )
    return found


def _worst(words: Iterable[_Word]) -> _Word:
    return max(words, key=_ORDER.index, default="inconclusive")
