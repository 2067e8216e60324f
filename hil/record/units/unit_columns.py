"""Columns of units beside the columns of their values, as in `CH1,UNIT,CH2,UNIT`, taken row by row."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.signals import split_column
from hil.record.raw import RawRecord, RecordError
from hil.record.times import is_time_name
from hil.record.units.headings import fahrenheit_hint, name_and_unit, suffixed
from hil.record.units.meanings import conversion, meaning_of
from hil.record.values import evidence_of, trimmed

_WORD = r"(?:units?(?:[ _]of[ _]measure(?:ment)?)?|einheit(?:en)?|unité|unite|unidad|unità|unita|uom|dim)"
_ALONE = re.compile(rf"{_WORD}(?:_\d+)?", re.IGNORECASE)
_BESIDE = re.compile(rf"(?P<stem>.+?)[ _.:/-]+[(\[]?{_WORD}[)\]]?|{_WORD}[ _.:/-]+(?:of |von |de )?(?P<rest>.+)", re.I)


def unit_name(name: str) -> bool:
    """Return True for the name of a column that holds units and nothing else."""
    return _ALONE.fullmatch(name.strip()) is not None


def with_unit_columns(raw: RawRecord) -> RawRecord:
    """Return `raw` with the units of its columns of units in the names and numbers of the columns that they belong to.

    A column of units belongs to the column of its own name (`CH1 unit`), one without a name to the column before it.
    Where the unit changes, the numbers are converted row by row.

    Raises
    ------
    RecordError
        A unit contradicts the name of its column, changes to another quantity, or is missing beside some values.
    """
    names, messages = list(raw.names), list(raw.messages)
    conversions, units = dict(raw.conversions), dict(raw.units or {})
    used: set[int] = set()
    for place, name in enumerate(raw.names):
        texts = _texts(raw.cells[place]) if _is_unit_column(name, raw.names) else None
        if texts is None or not any(texts):
            continue
        owner, others = _owner(place, raw)
        if owner is None:
            messages.append(f"column '{name}' may give the unit of {_or(others)}: not used")
            _require_constant(raw, name, texts)
            continue
        messages += _apply(raw, name, owner, texts, names, conversions, units)
        used.add(place)
    if len(names) == len(raw.names) and names == list(raw.names) and not used and messages == list(raw.messages):
        return raw
    kept = [place for place in range(len(names)) if place not in used]
    return dataclasses.replace(
        raw,
        names=tuple(names[place] for place in kept),
        cells=tuple(raw.cells[place] for place in kept),
        messages=tuple(messages),
        conversions=conversions,
        units=units,
    )


@dataclass(frozen=True, eq=False)
class RowUnits:
    """Unit of a column by the units of its rows.

    Attributes
    ----------
    unit
        One for the column, None where its rows give none or one that is not known (`unknown`).
    factor, offset
        By which the numbers become those of `unit`, for all rows or (n,) row by row.
    said
        Remark on a change of the unit, or "".
    """

    unit: str | None
    factor: float | NDArray[np.float64] = 1.0
    offset: float | NDArray[np.float64] = 0.0
    said: str = ""
    unknown: str = ""

    @property
    def is_converted(self) -> bool:
        """Return True where a number changes."""
        return bool(np.any(self.factor != 1.0) or np.any(self.offset != 0.0))


def row_units(
    head: str, texts: Sequence[str | None], held: Sequence[bool], place: Callable[[int], str], own: str | None
) -> RowUnits:
    """Return one unit for a column from the units of its rows, with the conversion of the numbers to it.

    Parameters
    ----------
    head
        Beginning of the messages, with file and columns.
    texts, held
        Units (n,), and True for rows (n,) with a value.
    place
        Names a row of the file.
    own
        Unit that the column's name gives, None where it gives none.

    Raises
    ------
    RecordError
        The unit changes to one that is not known or of another quantity, a value has none where others have one, or all
        of them contradict the name.
    """
    first: dict[str, int] = {}
    for row, (text, has_value) in enumerate(zip(texts, held, strict=True)):
        if has_value:
            first.setdefault(text or "", row)
    meanings = {text: meaning_of(text) if text else None for text in first}
    known = {text: meaning for text, meaning in meanings.items() if meaning is not None}
    unknown = next((text for text in first if text not in known), None)
    if not known and len(first) <= 1:
        return RowUnits(None, unknown=unknown or "")
    if unknown is not None:
        what = f"'{unknown}' is no known unit" if unknown else "a value has no unit"
        other = next(text for text in first if text != unknown)
        raise RecordError(
            f"{head}: {what} ({place(first[unknown])}), and other rows have '{other}'; write one known unit in all rows"
        )
    start, start_row = next(iter(first.items()))
    found = [unit for unit, _ in known.values()]
    target = own or ("degC" if "degC" in found else found[0])
    ways = {text: conversion(unit, count, target) for text, (unit, count) in known.items()}
    if own is not None and (len(set(known.values())) == 1 or None in ways.values()) and ways[start] != (1.0, 0.0):
        raise RecordError(
            f"{head} gives {start} ({place(start_row)}), and the name of that column gives {own}; correct one of them"
        )
    for text, way in ways.items():
        if way is None:
            raise RecordError(
                f"{head}: the unit changes from {start} ({place(start_row)}) to {text} ({place(first[text])}), which "
                "is another quantity; split the file there"
            )
    if len(set(ways.values())) == 1:
        return RowUnits(target, *ways[start])  # type: ignore[misc]
    cells = np.array([text or "" for text in texts], dtype=object)
    factor, offset = np.ones(len(texts)), np.zeros(len(texts))
    for text, way in ways.items():
        factor[cells == text], offset[cells == text] = way  # type: ignore[misc]
    later = next(text for text in first if ways[text] != ways[start])
    count = sum(has and ways[text or ""] != (1.0, 0.0) for text, has in zip(texts, held, strict=True))
    said = (
        f"its unit changes from {start} to {later} at {place(first[later])}: {count} values are converted to {target}"
    )
    return RowUnits(target, factor, offset, said)


def _apply(
    raw: RawRecord,
    name: str,
    owner: int,
    texts: Sequence[str | None],
    names: list[str],
    conversions: dict[str, tuple[Any, Any]],
    units: dict[str, str],
) -> list[str]:
    """Put the unit into the name and the conversions of the column at `owner`; return messages."""
    column = names[owner]
    own = _own_unit(column)
    head = f"{raw.path}: column '{name}' of the units of '{column}'"
    held = [cell is not None for cell in _texts(raw.cells[owner]) or raw.cells[owner].to_pylist()]
    found = row_units(head, texts, held, raw.place, own)
    if found.unit is None:
        if not found.unknown:
            return []
        names[owner] = column if own is not None else f"{column} [{found.unknown}]"
        return [f"column '{name}' gives '{found.unknown}' for '{column}', no known unit: read as '{names[owner]}'"]
    if column in conversions:
        raise RecordError(f"{head}: its heading gives a multiple of a unit, too; keep one of them")
    new = column if own is not None else suffixed(column, found.unit)
    if new != column and new in names:
        raise RecordError(f"{head} makes it {new}, and there is a column {new}; rename one of them")
    names[owner] = new
    if found.unit != "degF":
        units[new] = found.unit
    if found.is_converted:
        conversions[new] = (found.factor, found.offset)
    messages = [f"{new}: column '{name}' gives its unit" + (f"; {found.said}" if found.said else "")]
    return [*messages, *filter(None, [fahrenheit_hint(new)] if found.unit == "degF" else [])]


def _is_unit_column(name: str, names: Sequence[str]) -> bool:
    if unit_name(name):
        return True
    beside = _BESIDE.fullmatch(name.strip())
    return beside is not None and any(_same(beside["stem"] or beside["rest"], other) for other in names)


def _owner(place: int, raw: RawRecord) -> tuple[int | None, list[str]]:
    """Return the column whose units stand at `place`, or None and the columns that they may belong to."""
    name = raw.names[place]
    beside = None if unit_name(name) else _BESIDE.fullmatch(name.strip())
    if beside is not None:
        stem = beside["stem"] or beside["rest"]
        return next(i for i, other in enumerate(raw.names) if _same(stem, other)), []
    values = [
        i
        for i, (other, cells) in enumerate(zip(raw.names, raw.cells, strict=True))
        if not is_time_name(other) and not unit_name(other) and _numeric(cells)
    ]
    alone = sum(unit_name(other) for other in raw.names) == 1
    before = [i for i in values if i < place]
    candidates = before if before else values[:1]
    if not candidates:
        return None, []
    if alone:
        open_ones = [i for i in candidates if _own_unit(raw.names[i]) is None]
        touching = [i for i in open_ones if i == place - 1]
        if len(open_ones) > 1 and not (touching and _are_counters(raw, open_ones[:-1])):
            return None, [raw.names[i] for i in open_ones]
        return (touching or open_ones or candidates)[-1], []
    return candidates[-1], []


def _are_counters(raw: RawRecord, places: Sequence[int]) -> bool:
    """Return True for columns that number the rows: whole numbers, each one more than the one before."""
    for place in places:
        cells = (_texts(raw.cells[place]) or [])[:50]
        numbers = [int(cell) for cell in cells if cell and cell.isdigit()]
        if len(numbers) < len(cells) or any(b - a != 1 for a, b in zip(numbers, numbers[1:], strict=False)):
            return False
    return True


def _require_constant(raw: RawRecord, name: str, texts: Sequence[str | None]) -> None:
    start = next(text for text in texts if text)
    row = next((row for row, text in enumerate(texts) if text and text != start), None)
    if row is not None:
        raise RecordError(
            f"{raw.path}: the unit in column '{name}' changes from {start} to {texts[row]} at {raw.place(row)}; split "
            "the file there, or name the column after that of its values"
        )


def _own_unit(name: str) -> str | None:
    parts = split_column(name) or name_and_unit(name)
    return None if parts is None else parts[1]


def _same(stem: str, name: str) -> bool:
    parts = split_column(name) or name_and_unit(name) or (name, "")
    return stem.strip().lower() in (name.strip().lower(), parts[0].strip().lower())


def _numeric(cells: Any) -> bool:
    seen = evidence_of(cells)
    return seen is None or seen.numbers > seen.present / 2


def _texts(cells: Any) -> list[str | None] | None:
    text = trimmed(cells)
    return None if text is None else text.to_pylist()


def _or(names: Sequence[str]) -> str:
    return " or ".join(f"'{name}'" for name in names) or "no column of numbers"
