"""Diagnosis of a record on a worker, with the files that `hil diagnose` writes."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from hil.diagnosis import DiagnosisRequest, diagnose_files, prepare, write_results
from hil.executor import Say
from hil.fleet.kinds.job_folder import JobFolder, MadeJob
from hil.record import ReadingOptions


def made(folder: JobFolder, say: Say) -> MadeJob:
    """Diagnose; the revision of the twin is among the files.

    Raises
    ------
    RecordError, TwinFileError, DiagnosingError
        The record, the twin or the healthy record cannot be used.
    """
    options, began = folder.given.options, time.monotonic()
    request = DiagnosisRequest(
        folder.one("record"),
        folder.one("twin"),
        folder.find("healthy"),
        clock=options["clock"],
        choice=reading_of(options),
        named=folder.named,
    )
    ready = prepare(request)
    found = diagnose_files(ready, say, say)
    folder.out.mkdir()
    written, _ = write_results(ready, found, folder.out, empirical=False, began=began, page=options["page"])
    files = folder.results()
    if written.revision is not None:
        files[written.revision.name] = written.revision.read_bytes()
    first = found.effects[0] if found.effects else None
    row = {
        "verdict": found.verdict,
        "effect": None if first is None else first.kind,
        "place": None if first is None else first.where,
        "size": None if first is None else float(first.value),
        "unit": None if first is None else first.unit,
        "onset_s": None if first is None else float(first.onset_s),
        "rmse_K": max((e.after for e in found.errors.values()), default=None),
    }
    return MadeJob(row, found.verdict if found.verdict == "adequate" else f"{found.verdict}: {found.summary}", files)


def reading_of(options: Mapping[str, Any]) -> ReadingOptions:
    """Return the options of reading of a job."""
    return ReadingOptions(options["decimal"], options["dates"], options["time_column"], options["time_scale"])
