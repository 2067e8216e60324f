"""Ratings of a record's columns applied to their values: a bad value is missing, counted and named with its line."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hil.record.quality import Rating, is_rating_name, may_rate, rated_by, rating, texts_of
from hil.record.raw import RawRecord
from hil.record.values import Sign, parse

QUALITY = "_quality"
"""Ending of a column that holds the quality of the column before it."""
_LEAST_GOOD = 192


@dataclass(frozen=True, eq=False)
class RatedColumns:
    """Ratings of a record.

    Attributes
    ----------
    columns
        Columns that hold ratings and no signal.
    by_value
        Name and rating of each column that rates a value column.
    messages
        On ratings that are not used.
    """

    columns: frozenset[str]
    by_value: dict[str, list[tuple[str, Rating]]] = field(default_factory=dict)
    messages: tuple[str, ...] = ()

    def applied(
        self, column: str, values: NDArray[np.float64], raw: RawRecord, messages: list[str]
    ) -> NDArray[np.float64]:
        """Return `values (n,)` of `column` with NaN where they are rated bad; `messages` takes a sentence each."""
        for name, found in self.by_value.get(column, ()):
            bad = found.bad & np.isfinite(values)
            if bad.any():
                count = "1 value is" if bad.sum() == 1 else f"{bad.sum()} values are"
                first = raw.place(int(np.argmax(bad)))
                messages.append(f"{column}: {count} bad by '{name}' ({found.kind}; the first is {first}): missing")
                values = np.where(bad, np.nan, values)
            doubted = found.uncertain & np.isfinite(values)
            if doubted.any():
                count = "1 value is" if doubted.sum() == 1 else f"{doubted.sum()} values are"
                first = raw.place(int(np.argmax(doubted)))
                messages.append(f"{column}: {count} uncertain by '{name}' (the first is {first}): kept")
            if found.unknown is not None and np.isfinite(values).any():
                row, text = found.unknown
                messages.append(
                    f"{column}: '{text}' in '{name}' ({raw.place(row)}; {found.unknown_count} rows) is no known "
                    "rating: the values of these rows are taken without it"
                )
        return values

    def reasons(self, column: str) -> NDArray[np.uint8] | None:
        """Return the `Quality` of the rows (n,) of `column`, None where nothing rates it."""
        found = [one.reasons for _, one in self.by_value.get(column, ())]
        return None if not found else np.max(found, axis=0).astype(np.uint8)


def find_ratings(raw: RawRecord, time_columns: tuple[str, ...], signs: dict[str, Sign]) -> RatedColumns:
    """Return the columns of `raw` that rate the values of others, by their names and what they hold.

    `signs` are the decimal signs of the columns.
    """
    asked = [n for n in raw.names if n not in time_columns and (may_rate(n) or is_rating_name(n))]
    if not asked:
        return RatedColumns(frozenset())
    cells = dict(zip(raw.names, raw.cells, strict=True))
    values = [
        n for n in raw.names if n not in time_columns and n not in asked and _holds_numbers(cells[n], signs.get(n, "."))
    ]
    columns: set[str] = set()
    by_value: dict[str, list[tuple[str, Rating]]] = {}
    messages: list[str] = []
    for name in asked:
        texts = texts_of(cells[name])
        rated = rated_by(name, values, raw.names)
        own = len(rated) == 1 or name.lower().endswith("quality")
        found = rating(name, texts, project=own) if rated else None
        if found is not None:
            columns.add(name)
            for column in rated:
                by_value.setdefault(column, []).append((name, found))
            continue
        there = [text for text in texts if text is not None]
        if rated and there and not _all_good(name, there, cells, rated, signs):
            who = ", ".join(rated[:3]) + (" and others" if len(rated) > 3 else "")
            messages.append(
                f"column '{name}' has codes of no known kind (the first is '{there[0][:20]}'): not used, {who} "
                f"{'is' if len(rated) == 1 else 'are'} read without it; write Good and Bad to have it used"
            )
        elif not rated and rating(name, texts) is not None and not _holds_numbers(cells[name], "."):
            messages.append(f"column '{name}' may report which values are bad, and no column has its name: not used")
    return RatedColumns(frozenset(columns), by_value, tuple(messages))


def _all_good(name: str, there: list[str], cells: dict[str, object], rated: list[str], signs: dict[str, Sign]) -> bool:
    """Return True for codes of which none is bad in any kind, or only those of values that are missing anyway."""
    try:
        codes = np.array([float(text) if text else np.nan for text in there])
    except ValueError:
        return False
    if not codes.any() or codes.min() >= _LEAST_GOOD:
        return True
    marks = parse(cells[name])
    if marks is None:
        return False
    held = np.zeros(len(marks.values), dtype=np.bool_)
    for column in rated:
        numbers = parse(cells[column], signs.get(column, "."))
        held |= np.isfinite(numbers.values) if numbers is not None else False
    return not (held & (np.nan_to_num(marks.values) != 0)).any()


def _holds_numbers(cells: object, sign: Sign) -> bool:
    numbers = parse(cells, sign)
    return numbers is not None and numbers.bad <= numbers.present / 2
