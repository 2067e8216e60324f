"""Rows of several devices or sensors in one table, which a column names, to a column for each of them.

Merged into one column, the readings of two devices would jump from row to row between them. A column that names devices
is told from one of states (running, stopped) by its name, and by rows that alternate.
"""

from __future__ import annotations

import dataclasses
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.signals import split_column
from hil.files import require_cells
from hil.record.layouts.long_format import SERIES, VALUES, is_numeric
from hil.record.quality import holds_flags, is_rating_name, is_remark_name, may_rate, texts_of
from hil.record.raw import RawRecord, RecordError
from hil.record.times import holds_moments, is_time_name
from hil.record.units import name_and_unit, unit_name
from hil.record.values import Numbers, may_be_lost, parse

MOST_SOURCES = 200
"""Most devices of one table; a column of more different texts holds remarks."""
_ROWS_EACH = 3
"""Fewest rows of a source in the mean: fewer show no alternation."""
_ALTERNATES = 0.1
"""Share of the changes between rows that a random order of the same labels has, from which sources alternate.

Two devices that send ten rows in turn have a fifth of them; a device that was replaced changes once.
"""
_STRICTLY = 0.9
"""Share of rows after which the label changes, in a table of sources in turn: a state lasts for longer than a row."""
_ZIGZAG = 4.0
"""Ratio of the steps of a temperature between rows of two labels to those within a label, in a merged column."""

_WORDS = (
    r"devices?|dev|sensors?|hosts?|hostname|nodes?|stations?|loggers?|rigs?|probes?|thermocouples?|meters?|channels?|ch|chan|"
    r"tags?|points?|addr|slaves?|serial|sn|mac|imei|dev_?eui|eui|uuid|entity|statistic|boards?|modules?|controllers?|plc|"
    r"gateways?|equipment|assets?|location|room|zone|site|topic|client|transmitters?|instruments?|units?_?id|machines?|"
    r"gerät|geraet|fühler|fuehler|kanal|messstelle|knoten|anlage|raum|standort|messgerät|capteur|appareil|voie|canal|sonde"
)
_IDENTIFIES = re.compile(
    rf"(?:.*[\s_.-])?(?:{_WORDS})(?:[\s_.-]*(?:ids?|no|nr|num|number|name|address|addr|index|idx))?\.?"
)
"""Names, lower case, of a column that names a device or a sensor."""
_STATES = re.compile(
    r"state|status|phase|step|mode|program|recipe|event|alarm|error|fault|active|selected|switch|zustand"
)
"""Parts of names, lower case, of a column that holds states."""


def one_column_a_source(raw: RawRecord) -> RawRecord:
    """Return `raw` with a column of each signal for each source, if a column names several whose rows alternate.

    Any other record is returned unchanged. A table of whole numbers that name sources (`channel` 1 and 2) is of that
    kind, too, where the name of their column says so.

    Raises
    ------
    RecordError
        Rows of two temperatures alternate by a column of texts whose name does not say that it names sources.
    """
    if not raw.cells or len(raw.cells[0]) < 2 * _ROWS_EACH:
        return raw
    if not any(is_time_name(name) or holds_moments(cells) for name, cells in zip(raw.names, raw.cells, strict=True)):
        return raw
    for place, name in enumerate(raw.names):
        low = name.strip().lower()
        if _is_shared(raw, place):
            continue
        identifies = low == "id" or low in SERIES or _IDENTIFIES.fullmatch(low) is not None
        identifies = identifies and _STATES.search(low) is None
        labels = _labels(raw.cells[place], name, also_numbers=identifies)
        if labels is None:
            continue
        different = list(dict.fromkeys(labels[labels != ""].tolist()))
        if not 2 <= len(different) <= min(MOST_SOURCES, len(labels) // _ROWS_EACH):
            continue
        if identifies and _changes(labels) >= max(2.0 * len(different), _ALTERNATES * _changes_by_chance(labels)):
            return _apart(raw, place, labels, different)
        if not identifies and _changes(labels) >= _STRICTLY * (len(labels) - 1) and _zigzags(raw, labels):
            shown = ", ".join(f"'{one}'" for one in different[:3])
            raise RecordError(
                f"{raw.path}: column '{name}' names {len(different)} sources whose rows alternate ({shown}), or "
                f"states; call it 'device' to have a column for each, or take it out if it holds states"
            )
    return raw


def _labels(cells: Any, name: str, *, also_numbers: bool) -> NDArray[np.object_] | None:
    """Return the labels (n,) of a column of texts or of whole numbers, "" for none; None for a column of values."""
    numeric = is_numeric(cells, 0.0)
    if numeric and not also_numbers:  # most columns, and to write their numbers as text takes longer than all else
        return None
    texts = [(text or "").strip() for text in texts_of(cells)]
    labels: NDArray[np.object_] = np.array(texts, dtype=object)
    if int((labels == "").sum()) > may_be_lost(len(texts)) or holds_flags(texts):
        return None
    if not numeric:
        return labels
    numbers = parse(cells)
    if numbers is None or numbers.bad:  # `1A`, `2B` and 3
        return labels
    known = numbers.values[np.isfinite(numbers.values)]
    if not len(known) or (known < 0).any() or (known != np.round(known)).any():
        return None
    stem = re.sub(
        r"[\s_.-]*(?:ids?|no|nr|num|number|address|addr|index|idx)\.?$", "", name.strip(), flags=re.IGNORECASE
    )
    return np.array([f"{stem or name}_{text}" if text else "" for text in texts], dtype=object)


def _changes(labels: NDArray[np.object_]) -> int:
    known = labels[labels != ""]
    return int((known[1:] != known[:-1]).sum())


def _changes_by_chance(labels: NDArray[np.object_]) -> float:
    """Return the changes between rows that labels in random order have."""
    known = labels[labels != ""]
    shares = np.unique(known.astype(str), return_counts=True)[1] / len(known)
    return float((len(known) - 1) * (1.0 - np.sum(shares**2)))


def _zigzags(raw: RawRecord, labels: NDArray[np.object_]) -> bool:
    """Return True where a temperature steps further between rows of two labels than within a label."""
    for name, cells in zip(raw.names, raw.cells, strict=True):
        own = split_column(name) or name_and_unit(name)
        if own is None or own[1] not in ("degC", "K", "degF"):
            continue
        numbers = _values(cells)
        if numbers is None or numbers.bad > may_be_lost(numbers.present):
            continue
        across = np.abs(np.diff(numbers.values))[labels[1:] != labels[:-1]]
        within = [np.abs(np.diff(numbers.values[labels == one])) for one in set(labels.tolist()) if one]
        steps = np.concatenate(within)
        steps, across = steps[np.isfinite(steps)], across[np.isfinite(across)]
        if len(steps) and len(across) and float(np.median(across)) > _ZIGZAG * float(np.median(steps)):
            return True
    return False


def _apart(raw: RawRecord, place: int, labels: NDArray[np.object_], different: list[str]) -> RawRecord:
    """Return `raw` with each column of numbers replaced by one for each label, without the column of labels."""
    import pyarrow as pa
    import pyarrow.compute as pc

    masks = {label: pa.array(labels == label) for label in different}
    symbols = [i for i, name in enumerate(raw.names) if unit_name(name)]
    taken = [i for i in range(len(raw.names)) if i != place and _belongs_to_a_source(raw, i)]
    require_cells(raw.path, len(labels), len(different) * len(taken) + len(raw.names), RecordError)
    names: list[str] = []
    cells: list[Any] = []
    known: dict[str, dict[str, Any]] = {"units": {}, "plausible": {}, "conversions": {}}
    for i, (name, column) in enumerate(zip(raw.names, raw.cells, strict=True)):
        if i == place or (i in symbols and taken):
            continue
        if i not in taken:
            names.append(name)
            cells.append(column)
            continue
        nothing = pa.scalar(None, column.type)
        for label, mask in masks.items():
            new = label if name.strip().lower() in VALUES else f"{label}_{name}"
            own = pc.if_else(mask, column, nothing)
            if own.null_count == len(own):
                continue
            names.append(new)
            cells.append(own)
            if len(symbols) == 1:
                symbol = raw.cells[symbols[0]]
                names.append(f"{new} unit")
                cells.append(pc.if_else(pc.and_(mask, column.is_valid()), symbol, pa.scalar(None, symbol.type)))
            for key, held in known.items():
                given = getattr(raw, key) or {}
                held |= {new: given[name]} if name in given else {}
    rest = {key: {n: one for n, one in (getattr(raw, key) or {}).items() if n in names} for key in known}
    column = raw.names[place]
    shown = ", ".join(different[:4]) + ("" if len(different) <= 4 else f" and {len(different) - 4} others")
    said = [f"column '{column}' names {len(different)} sources whose rows alternate ({shown}): a column for each"]
    if (without := int((labels == "").sum())) > 0:
        first = raw.place(int(np.argmax(labels == "")))
        said.append(f"{without} of the rows have no '{column}' (the first is {first}): left out")
    return dataclasses.replace(
        raw,
        names=tuple(names),
        cells=tuple(cells),
        messages=(*raw.messages, *said),
        units={**rest["units"], **known["units"]},
        plausible={**rest["plausible"], **known["plausible"]},
        conversions={**rest["conversions"], **known["conversions"]},
    )


def _values(cells: Any) -> Numbers | None:
    """Return the numbers of a column with the decimal sign that more of its cells have."""
    found = [numbers for sign in (".", ",") if (numbers := parse(cells, sign)) is not None]
    return min(found, key=lambda numbers: numbers.bad, default=None)


def _is_shared(raw: RawRecord, place: int) -> bool:
    """Return True for times, units, remarks, and ratings of all values of a row."""
    name = raw.names[place]
    return (
        is_time_name(name)
        or is_rating_name(name)
        or is_remark_name(name)
        or unit_name(name)
        or holds_moments(raw.cells[place])
    )


def _belongs_to_a_source(raw: RawRecord, place: int) -> bool:
    """Return True for a column of numbers of each source, or of ratings of one such column.

    Times, ratings of all values of a row, texts, and numbers without a unit that only rise (a clock, a counter of rows)
    belong to all sources.
    """
    name, cells = raw.names[place], raw.cells[place]
    if _is_shared(raw, place):
        return False
    if may_rate(name):
        return True
    numbers = _values(cells)
    if numbers is None or numbers.bad > numbers.present / 2:
        return False
    if split_column(name) is None and name_and_unit(name) is None and name.strip().lower() not in VALUES:
        steps = np.diff(numbers.values[np.isfinite(numbers.values)])
        return not (len(steps) and (steps >= 0).all() and (steps > 0).any())
    return True
