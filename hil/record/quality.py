"""Codes beside the values of a record that report their quality."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.signals.points import Quality
from drivers.signals.units import split_column
from hil.record.values.numbers import trimmed

ENDINGS = ("_quality", "_status")
OPC_GOOD, OPC_UNCERTAIN = 192, 64
"""Least code of a good and of an uncertain value (OPC Data Access 3.0, 6.8); smaller ones are bad."""
_OPC = {*range(0, 32, 4), 64, 80, 84, 88, 192, 216}
"""Codes of OPC without the two bits of a limit."""
_WORDS = {"good": 192.0, "ok": 192.0, "valid": 192.0, "uncertain": 64.0, "bad": 0.0, "invalid": 0.0}


def valued_by(name: str, names: Iterable[str]) -> str | None:
    """Return the column whose quality the column `name` may hold, called with or without its unit; None for none."""
    for ending in ENDINGS:
        if name.lower().endswith(ending):
            stem = name[: -len(ending)]
            for other in names:
                if other != name and (other == stem or (split_column(other) or ("",))[0] == stem):
                    return other
    return None


def codes_of_words(cells: Any) -> NDArray[np.float64] | None:
    """Return text cells of the words good, uncertain and bad as codes of OPC; None where they hold anything else."""
    text = trimmed(cells)
    found = [] if text is None else [cell.as_py() for cell in cells]
    words = [None if cell is None else cell.strip().lower() for cell in found]
    if not any(words) or any(word and word not in _WORDS for word in words):
        return None
    return np.array([_WORDS[word] if word else np.nan for word in words])


def reasons(codes: NDArray[np.float64]) -> tuple[NDArray[np.uint8], str] | None:
    """Return the `Quality` of each row by `codes (n,)` and the name of their kind; None for codes of another kind.

    Zero and one alone are of no kind: one is stale in this project's records and good in others. The reason of a code
    that is bad in OPC is SENSOR_FAULT; an uncertain value stays.
    """
    known = set(np.unique(codes[np.isfinite(codes)]).tolist())
    if OPC_GOOD in known and all(code == int(code) and int(code) & 0xFC in _OPC for code in known):
        low = np.nan_to_num(codes, nan=0.0).astype(np.int64) & 0xFF  # the high byte is the vendor's
        return np.where(low < OPC_UNCERTAIN, Quality.SENSOR_FAULT, Quality.GOOD).astype(np.uint8), "OPC codes"
    if known <= {float(member) for member in Quality} and 0.0 in known and max(known) > 1.0:
        return np.nan_to_num(codes, nan=0.0).astype(np.uint8), "codes of this project"
    return None
