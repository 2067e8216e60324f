"""Columns of a record as its file stores them, before numbers and times are interpreted."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal


class RecordError(ValueError):
    """Error in reading or writing a record; one sentence with the file, the line if there is one, and the remedy."""

    def __init__(self, message: str) -> None:
        super().__init__(" ".join(message.split()))  # a cell that is quoted may hold a line break


@dataclass(frozen=True, eq=False)
class RawRecord:
    """Columns as stored: `cells` are Arrow arrays of any type, all of one length, named by `names`.

    `units` are those that the file itself gives; `header_line` and `skipped_lines` map rows to lines of a
    CSV (0 and empty for Parquet); `lines`, where it is not empty, are the rows' lines one by one. `delimiter` separates
    its columns. `plausible` are ranges that the file itself declares for a column. `conversions` are factor and offset
    that make the numbers of a column those of its unit, for the column or row by row.
    """

    path: Path
    sha256: str
    names: tuple[str, ...]
    cells: tuple[Any, ...]
    messages: tuple[str, ...] = ()
    metadata: dict[str, str] | None = None
    units: dict[str, str] | None = None
    header_line: int = 0
    skipped_lines: tuple[int, ...] = ()
    delimiter: str = ""
    plausible: dict[str, tuple[float, float]] = field(default_factory=dict)
    lines: tuple[int, ...] = ()
    conversions: dict[str, tuple[Any, Any]] = field(default_factory=dict)

    def place(self, row: int) -> str:
        """Return the place of `row` (from 0) in the file, for a message."""
        if self.lines:
            return f"line {self.lines[row]}"
        if not self.header_line:
            return f"row {row + 1}"
        line = self.header_line + 1 + row
        for skipped in self.skipped_lines:
            line += skipped <= line
        return f"line {line}"


@dataclass(frozen=True)
class ReadingOptions:
    """Choices of the user for properties that the record does not show itself.

    Attributes
    ----------
    decimal
        Sign of all numbers, "." or ",". dates: order of day, month and year, "dmy", "mdy" or "ymd".
    time_column
        Name of the column of times, or two names with a comma between them: of dates and times of day.
    time_scale
        S of the rig's time in a unit of that column; 60 for a rig whose clock counts minutes as seconds.
    """

    decimal: Literal[".", ","] | None = None
    dates: Literal["dmy", "mdy", "ymd"] | None = None
    time_column: str | None = None
    time_scale: float = 1.0


def repeat_message(name: str, renamed: str) -> str:
    """Return the message on a column whose name stands in the file a second time."""
    return f"column '{name}' stands twice: the second is read as '{renamed}'"


def unique(names: list[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return `names` with repeats renamed so that the first keeps its name, and messages on the renamed ones."""
    found: list[str] = []
    messages = []
    for place, given in enumerate(names, start=1):
        name = given or f"column_{place}"
        if name in found:
            count = 2
            while f"{name}_{count}" in found or f"{name}_{count}" in names:
                count += 1
            messages.append(repeat_message(name, f"{name}_{count}"))
            name = f"{name}_{count}"
        found.append(name)
    return tuple(found), tuple(messages)
