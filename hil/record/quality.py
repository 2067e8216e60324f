"""Quality codes of a record, in columns of their own."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.signals import Quality, split_column
from hil.record.values import trimmed

ENDINGS = ("_quality", "_status")
OPC_GOOD, OPC_UNCERTAIN = 192, 64
"""Least code of a good and of an uncertain value (OPC Data Access 3.0, 6.8); smaller ones are bad."""
_OPC = {*range(0, 32, 4), 64, 80, 84, 88, 192, 216}
"""Codes of OPC without the two bits of a limit."""
_UA_UNCERTAIN, _UA_BAD = 0x40000000, 0x80000000
"""Least code of an uncertain and of a bad value (OPC UA part 4, 7.39)."""
_WORDS = {"good": 192.0, "ok": 192.0, "valid": 192.0, "uncertain": 64.0, "bad": 0.0, "invalid": 0.0}


def valued_by(name: str, names: Iterable[str]) -> str | None:
    """Return the column whose quality the column `name` may hold, named with or without its unit; None if there is
    none.
    """
    for ending in ENDINGS:
        if name.lower().endswith(ending):
            stem = name[: -len(ending)]
            for other in names:
                if other != name and (other == stem or (split_column(other) or ("",))[0] == stem):
                    return other
    return None


def codes_of_words(cells: Any) -> NDArray[np.float64] | None:
    """Return text cells of the words good, uncertain and bad as OPC codes; None for other words."""
    text = trimmed(cells)
    found = [] if text is None else [cell.as_py() for cell in cells]
    words = [None if cell is None else cell.strip().lower() for cell in found]
    if not any(words) or any(word and word not in _WORDS for word in words):
        return None
    return np.array([_WORDS[word] if word else np.nan for word in words])


def usable_by(name: str, cells: list[str]) -> tuple[list[bool] | None, str]:
    """Return the usable readings by their cells of quality, or None and a remark if no kind of codes fits.

    Words are good, uncertain and bad, with more behind them (`Bad, comm failure`). Numbers are OPC's (192 is good), OPC
    UA's (0 is good, its two highest bits say bad or uncertain), or in a column called validity 1 and 0.
    """
    words = [cell.strip().lower() for cell in cells]
    first = [re.split(r"[^a-z]", word, maxsplit=1)[0] for word in words]
    if all(word in _WORDS or not whole for word, whole in zip(first, words, strict=True)):
        return [not whole or _WORDS[word] > 0.0 for word, whole in zip(first, words, strict=True)], ""
    numbers = [int(word, 0) if re.fullmatch(r"0x[0-9a-f]{1,8}|0|[1-9]\d{0,9}", word) else None for word in words]
    codes = {number for number in numbers if number is not None}
    if None not in numbers and codes:
        if "valid" in name.lower() and codes <= {0, 1}:
            return [number == 1 for number in numbers], ""
        if any(OPC_GOOD <= code <= 0xFF for code in codes) and max(codes) <= 0xFFFF:
            return [number is not None and number & 0xFF >= OPC_UNCERTAIN for number in numbers], ""
        if 0 in codes and all(code == 0 or code >= _UA_UNCERTAIN for code in codes):
            return [number is not None and number < _UA_BAD for number in numbers], ""
    return None, f"column '{name}' has codes of no known kind: not used"


def reasons(codes: NDArray[np.float64]) -> tuple[NDArray[np.uint8], str] | None:
    """Return the `Quality` of each row by `codes (n,)` and the name of their kind; None for codes of another kind.

    Zero and one alone are of no kind: one is stale in this project's records and good in others. The reason of a code
    that is bad in OPC is SENSOR_FAULT; an uncertain value stays.
    """
    known = set(np.unique(codes[np.isfinite(codes)]).tolist())
    if OPC_GOOD in known and all(code == int(code) and int(code) & 0xFC in _OPC for code in known):
        low = np.nan_to_num(codes, nan=0.0).astype(np.int64) & 0xFF  # The high byte belongs to the vendor.
        return np.where(low < OPC_UNCERTAIN, Quality.SENSOR_FAULT, Quality.GOOD).astype(np.uint8), "OPC codes"
    if known <= {float(member) for member in Quality} and 0.0 in known and max(known) > 1.0:
        return np.nan_to_num(codes, nan=0.0).astype(np.uint8), "codes of this project"
    return None
