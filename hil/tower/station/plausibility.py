"""Refusal of aligned records that are none of a plant: shuffled, flat, or in other units.

| code | refused where |
|---|---|
| `SHUFFLED_RECORD` | time does not rise from row to row, or temperatures jump between neighbouring samples as a rule |
| `FLAT_RECORD` | a temperature stands still throughout |
| `OTHER_UNITS` | the median of a column cannot be in its unit |
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.record import RecordError
from twin.tower import MEASURED, Array

TEMPERATURES = ("t_in_C", "t_out_C", "dry_C", "wet_C")
FEWEST = 100
"""Samples below which a column is not judged."""
NEAR_MIN, JUMP_K = 5, 0.5
"""Minutes between neighbouring samples, and the change of a temperature between them that water, air and thermowells
do not make as a rule: shuffled rows of a day differ by kelvins."""
STILL_K = 1e-6
MEDIANS = {
    "t_in_C": (0.0, 70.0),
    "t_out_C": (0.0, 60.0),
    "wet_C": (-30.0, 40.0),
    "dry_C": (-40.0, 60.0),
    "pressure_kPa": (50.0, 110.0),
}
"""Medians that a column can have: liquid water, weather, and sites up to 5 km."""
HINTS = {"C": "is it in degF or K? convert it to degC", "kPa": "is it in hPa, bar or psi? convert it to kPa"}
LEAST_FAN_PCT = 1.5
"""Fan speed, %, that a column in % exceeds while the fan runs; shares of one do not."""


def refuse_implausible(
    path: Path, time_s: Array, columns: Mapping[str, Array], origin: Mapping[str, NDArray[np.uint8]]
) -> None:
    """Check the minutes of a cell.

    Parameters
    ----------
    path
        Aligned record, for the message.
    time_s
        (n,) s since 1970.
    columns, origin
        (n,) each, of the aligned record by name.

    Raises
    ------
    RecordError
        The record is shuffled, flat, or in other units; the message begins with the code.
    """
    falls = np.flatnonzero(np.diff(time_s) <= 0.0)
    if len(falls):
        raise RecordError(
            f"SHUFFLED_RECORD: {path}: time does not rise from row {falls[0] + 1} to the next; align the store again"
        )
    samples = {name: _samples(columns[name], origin.get(name)) for name in TEMPERATURES if name in columns}
    for name, rows in samples.items():
        values = columns[name][rows]
        if len(values) >= FEWEST and np.ptp(values) < STILL_K:
            raise RecordError(
                f"FLAT_RECORD: {path}: {name} stands at {values[0]:.2f} throughout; map the tag of a thermometer that "
                "is alive and align again"
            )
    for name, (low, high) in MEDIANS.items():
        known = columns[name][np.isfinite(columns[name])] if name in columns else np.zeros(0)
        if len(known) and not low <= float(np.median(known)) <= high:
            hint = next(words for end, words in HINTS.items() if name.endswith(end))
            raise RecordError(
                f"OTHER_UNITS: {path}: the median of {name} is {np.median(known):.4g}, outside {low:g} to {high:g}; "
                f"{hint} in the tag dictionary and align again"
            )
    _refuse_shares(path, columns)
    jumping = [name for name, rows in samples.items() if _jumps(columns[name], rows)]
    if len(jumping) > len(samples) / 2.0:
        raise RecordError(
            f"SHUFFLED_RECORD: {path}: {', '.join(jumping)} jump by more than {JUMP_K:g} K between most neighbouring "
            "samples, as no plant does; are rows in order? align the store again"
        )


def _refuse_shares(path: Path, columns: Mapping[str, Array]) -> None:
    """Raise RecordError for a fan speed that is a share of one."""
    for name in ("fan_speed_pct", "fan_command_pct"):
        values = columns.get(name, np.zeros(0))
        running = values[np.isfinite(values) & (values > 0.0)]
        if len(running) >= FEWEST and float(running.max()) <= LEAST_FAN_PCT:
            raise RecordError(
                f"OTHER_UNITS: {path}: {name} is at most {running.max():.3g}; is it a share of one? give it in %, 0 to "
                "100, and align again"
            )


def _samples(values: Array, origin: NDArray[np.uint8] | None) -> NDArray[np.intp]:
    """Return the rows of a column that hold a raw sample; all known ones where the record does not say."""
    known = np.isfinite(values)
    return np.flatnonzero(known & (origin == MEASURED)) if origin is not None else np.flatnonzero(known)


def _jumps(values: Array, rows: NDArray[np.intp]) -> bool:
    near = np.diff(rows) <= NEAR_MIN
    if near.sum() < FEWEST:
        return False
    return bool(np.median(np.abs(np.diff(values[rows]))[near]) > JUMP_K)
