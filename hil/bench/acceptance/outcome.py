"""Outcome of an acceptance row, and the tables of published results that outcomes come from."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil.bench.measure import Cell

REACHED, FAILED, NOT_MEASURED = "reached", "failed", "not measured"
HIDDEN, TRUTH, ONLINE = "P1", "P1, P3", "P4"
"""Protocols: readings of the target hidden; the same, scored against the truth; window after window."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """Our figure of a row.

    Attributes
    ----------
    ours
        Figure in words.
    reached
        Whether the gate holds; None if nobody measured it.
    source
        Page of results, or "here".
    protocol, seeds, interval
        Of the measurement, "" where there is none.
    why
        Reason of a failure or a gap, or a remark.
    """

    ours: str
    reached: bool | None
    source: str
    protocol: str = ""
    seeds: str = ""
    interval: str = ""
    why: str = ""

    @property
    def verdict(self) -> str:
        """Return `REACHED`, `FAILED` or `NOT_MEASURED`."""
        return NOT_MEASURED if self.reached is None else REACHED if self.reached else FAILED


def not_measured(why: str, source: str = "-") -> Outcome:
    """Return the outcome of a row that nobody measured."""
    return Outcome("-", None, source, why=why)


class Published:
    """Published results of a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._pages: dict[str, dict[str, Any]] = {}

    def rows(self, page: str, table: str) -> list[dict[str, Cell]]:
        """Return the rows of a table by column; none where the page or table is missing.

        Raises
        ------
        ValueError
            The page is no result of a bench.
        """
        found = self._page(page).get(table)
        return [] if found is None else [dict(zip(found["columns"], row, strict=True)) for row in found["rows"]]

    def row(self, page: str, table: str, **wanted: Cell) -> dict[str, Cell] | None:
        """Return the first row with these values, by column with `_` for a space; None where there is none."""
        named = {key.replace("_", " "): value for key, value in wanted.items()}
        return next((r for r in self.rows(page, table) if all(r.get(k) == v for k, v in named.items())), None)

    def notes(self, page: str, table: str) -> list[str]:
        """Return the notes of a table."""
        return list(self._page(page).get(table, {}).get("notes", []))

    def seed(self, page: str) -> str:
        """Return the seed of a page as its manifest has it, "" without one."""
        try:
            return str(json.loads((self.folder / f"{page}.manifest.json").read_text(encoding="utf-8"))["seed"])
        except (OSError, ValueError, KeyError, TypeError):
            return ""

    def _page(self, page: str) -> dict[str, Any]:
        if page not in self._pages:
            path = self.folder / f"{page}.json"
            try:
                self._pages[page] = dict(json.loads(path.read_text(encoding="utf-8"))["tables"])
            except FileNotFoundError:
                self._pages[page] = {}
            except (ValueError, KeyError, TypeError) as error:
                raise ValueError(
                    f"{path}: is no result of a bench ({error}); measure it again with its command"
                ) from error
        return self._pages[page]


def figure(value: Cell) -> float:
    """Return a figure of a table as a number; NaN where it has none."""
    return float(value) if isinstance(value, int | float) else float("nan")
