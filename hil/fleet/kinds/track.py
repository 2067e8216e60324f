"""Replay of the calibrators on a record on a worker."""

from __future__ import annotations

import json
import math
import time

from hil.executor import Say
from hil.fleet.kinds.diagnose import reading_of
from hil.fleet.kinds.job_folder import JobFolder, MadeJob
from hil.record import read_record
from hil.run.session import check_calibrators, chosen_calibrators
from hil.tracking import STATIC, ErrorTable, TrackingConfig, Twins, replay, write_predictions

EVERY_S = 10.0
"""Time between lines on the progress, s."""


def made(folder: JobFolder, say: Say) -> MadeJob:
    """Replay, and write the predictions if they are wanted.

    Raises
    ------
    RecordError, TwinFileError, ConfigurationError
        The record, the twin or a calibrator cannot be used.
    """
    options = folder.given.options
    chosen = None if options["calibrators"] is None else tuple(options["calibrators"])
    check_calibrators(chosen or ())
    names, optional = chosen_calibrators(chosen, None)
    record = read_record(folder.one("record"), choice=reading_of(options))
    twins = Twins(TrackingConfig(folder.one("twin"), tuple(record.columns), names, folder.given.seed or 0, optional))
    for name, why in twins.left_out.items():
        say(f"{name} is left out: {why}")
    for message in record.messages:
        say(message)
    last = time.monotonic()

    def progress(done: int) -> None:
        nonlocal last
        if time.monotonic() - last > EVERY_S:
            last = time.monotonic()
            say(f"{done} of {len(record.time_s)} samples")

    found = replay(twins, record, progress)
    folder.out.mkdir()
    if options["predictions"]:
        write_predictions(folder.out / "predictions.parquet", twins, record, found)
    errors = found.comparison.errors
    row: dict[str, object] = {"samples": len(record.time_s), "rmse_static_K": pooled(errors, STATIC)}
    row |= {f"rmse_{name}_K": pooled(errors, f"{name} ahead") for name in twins.calibrators}
    (folder.out / "tracking.json").write_text(json.dumps(found.document(twins), indent=1) + "\n", encoding="utf-8")
    said = ", ".join(f"{key[5:-2]} {value:.3f} K" for key, value in row.items() if isinstance(value, float))
    return MadeJob(row, f"RMSE: {said}", folder.results())


def pooled(errors: ErrorTable, column: str) -> float | None:
    """Return the root mean square of the sensors' errors in a column, K; None without one."""
    if column not in errors.columns:
        return None
    number = errors.columns.index(column)
    known = [row[number] for row in errors.rows.values() if math.isfinite(row[number])]
    return math.sqrt(sum(value * value for value in known) / len(known)) if known else None
