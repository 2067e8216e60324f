"""Diagnosis of a tower's aligned record, as `hil diagnose` runs it."""

from __future__ import annotations

import contextlib
import json
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import click

from hil.errors import FOUND

STEPS = 5.0


def is_tower(target: Path) -> bool:
    """Return True if a folder is of a tower: an aligned record, or results of its calibration."""
    from hil.tower import cells_of

    return target.is_dir() and (bool(cells_of(target)) or (target / "calibrated.parquet").is_file())


@contextlib.contextmanager
def _held(folder: Path) -> Iterator[None]:
    """Hold the folder of the results, so that no other process writes there meanwhile."""
    from hil.files import held
    from hil.tower import TowerOutputError, writing

    with writing(folder), held(folder, TowerOutputError):
        yield


def diagnose_tower(
    record: Path,
    twins: Sequence[Path],
    labels: Path | None,
    out: Path | None,
    dry: bool,
    as_json: bool,
    others: Sequence[str],
) -> None:
    """Diagnose the cells of a record, write diagnosis.json and revisions of their twins, and print the result.

    Parameters
    ----------
    record
        Folder of an aligned record.
    twins
        Twin files of its cells.
    labels
        Inspections of the cells, or None.
    out
        Folder of the results; None: a folder named after the record.
    dry, as_json
        True: nothing is written; the result is printed as JSON.
    others
        Options that were given and do not apply.

    Raises
    ------
    RecordError
        The folder holds no aligned record.
    TowerOutputError
        The folder of the results cannot be written, or another process works on it.
    click.UsageError
        No twin is named, or an option does not apply.
    """
    from hil.record import RecordError
    from hil.run.session import ProgressBar, console
    from hil.tower import adopt, cells_of, diagnose_station, document, write_document

    if not cells_of(record):
        raise RecordError(f"{record}: holds a calibration and no aligned record; give the folder of hil tower align")
    if others:
        raise click.UsageError(f"{', '.join(others)} do not apply to the aligned record of a tower; leave them out")
    if not twins:
        raise click.UsageError(f"{record} is the aligned record of a tower; name the twins of its cells with --twin")
    began, stages = time.monotonic(), 0
    with ProgressBar("diagnosing", STEPS, quiet=as_json) as steps:

        def say(stage: str) -> None:
            nonlocal stages
            stages += 1
            steps.update(min(float(stages), STEPS), stage)

        folder = out or Path(f"diagnosis-{record.resolve().name}")
        with contextlib.nullcontext() if dry else _held(folder):
            found = diagnose_station(record, twins, labels, say)
            revisions = [] if dry else adopt(found)
            path = None if dry else write_document(found, folder, revisions)
    content = document(found, revisions)
    if as_json:
        click.echo(json.dumps(content | {"seconds": round(time.monotonic() - began, 1)}, indent=1))
    else:
        to = console()
        to.print(f"{content['verdict']}", markup=False)
        for sentence in (*content["summary"], *(f"not claimed: {text}" for text in content["rejected"])):
            to.print(sentence, markup=False, soft_wrap=True)
        for cell, errors in content["error_K"].items():
            to.print(
                f"cell {cell}: mean error of the outlet on the held-out weeks {errors['before']} K before, "
                f"{errors['after']} K after",
                markup=False,
            )
        for revision in revisions:
            to.print(f"revision of the twin: {revision}", markup=False, soft_wrap=True)
        if path is not None:
            to.print(f"written: {path}", markup=False, soft_wrap=True)
        to.print(f"{time.monotonic() - began:.1f} s")
    if content["effects"]:
        sys.exit(FOUND)
