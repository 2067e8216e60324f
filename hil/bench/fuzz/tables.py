"""Tables of `hil bench files`: mutated files of every kind against their readers."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Mapping

from hil.bench.fuzz.readers import HANG, READ, REFUSED, TRACEBACK, UNCLEAR, ReaderOutcomes, fuzz_files
from hil.bench.measure import ReportTable

QUICK, FULL = 300, 20_000
RECORDS = "hil.bench.fuzz.records"
"""Records and load profiles have their own mutations: columns, stamps and separators, and Parquet's types."""
_COLUMNS = (READ, REFUSED, UNCLEAR, TRACEBACK, HANG)


def measure(
    count: int, seed: int, progress: Callable[[float], None]
) -> tuple[tuple[ReportTable, ...], tuple[str, ...], bool]:
    """Return tables of `count` mutations of each kind of file, everything left out, and True if nothing failed."""
    found = fuzz_files(count, seed, progress=lambda share: progress(0.8 * share))
    skipped = [] if "Home Assistant" in found else ["Home Assistant: PyYAML is not installed"]
    rows = _rows(found)
    failures = sum(one.failures for one in found.values())
    if importlib.util.find_spec(RECORDS) is not None:
        records = importlib.import_module(RECORDS).fuzz_records(count, seed)
        rows += _rows({f"record: {kind}": one for kind, one in records.items()})
        failures += sum(one.failures for one in records.values())  # With records that are read wrongly.
    progress(1.0)
    table = ReportTable(
        "files",
        f"{sum(sum(map(int, row[1:])) for row in rows):,} mutated files and their readers",
        ("file", *_COLUMNS),
        tuple(rows),
        (
            "Refused: one of the project's own errors, in sentences that name the file. Unclearly: without the file, "
            "or in words of pydantic or of Python.",
            "Of every fourth draft of an import the rig file is made, too, and must be accepted. Model cards have no "
            "weights beside them, so that all are refused.",
        ),
    )
    return (table,), tuple(skipped), not failures


def _rows(found: Mapping[str, ReaderOutcomes]) -> list[tuple[str | int, ...]]:
    return [(kind, *(one.counts[outcome] for outcome in _COLUMNS)) for kind, one in found.items()]
