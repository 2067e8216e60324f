"""Samples as Arrow tables, and back."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from drivers.historian.protocol import BAD, GOOD, UNCERTAIN, HistorianError, Samples

SCHEMA = pa.schema(
    [
        ("timestamp", pa.timestamp("ms", tz="UTC")),
        ("tag", pa.dictionary(pa.int32(), pa.string())),
        ("value", pa.float64()),
        ("quality", pa.int16()),
    ]
)
WORDS = {"good": GOOD, "ok": GOOD, "uncertain": UNCERTAIN, "questionable": UNCERTAIN, "bad": BAD}
"""Quality of samples by the beginning of its word."""
PER_SECOND = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}
_IS: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "timestamp": ("times; store timestamps with a zone", pa.types.is_timestamp),
    "tag": ("names; store them as text", lambda kind: pa.types.is_string(kind) or pa.types.is_large_string(kind)),
    "value": (
        "numbers; store them as double",
        lambda kind: not pa.types.is_nested(kind) and not pa.types.is_temporal(kind),
    ),
    "quality": (
        "quality codes; store them as whole numbers",
        lambda kind: not pa.types.is_nested(kind) and not pa.types.is_temporal(kind),
    ),
}
"""What each column holds, and the remedy; a text of a number is converted."""


def refuse_other_types(schema: Any) -> None:
    """Check that the columns of a schema hold what a store holds.

    Raises
    ------
    HistorianError
        A column is of another type.
    """
    for field in schema:
        if field.name not in _IS:
            continue
        kind = field.type.value_type if pa.types.is_dictionary(field.type) else field.type
        what, fits = _IS[field.name]
        if not fits(kind):
            raise HistorianError(f"column {field.name} holds {kind} and no {what}")


def table_of(samples: Mapping[str, Samples]) -> Any:
    """Return a table of all samples, with times to the millisecond."""
    names = list(samples)
    index = np.repeat(np.arange(len(names), dtype=np.int32), [len(samples[name]) for name in names])
    if not names:
        return SCHEMA.empty_table()
    time_s = np.concatenate([samples[name].time_s for name in names])
    return pa.table(
        [
            pa.array(np.round(time_s * 1e3).astype("datetime64[ms]"), pa.timestamp("ms", tz="UTC")),
            pa.DictionaryArray.from_arrays(pa.array(index), pa.array(names, pa.string())),
            pa.array(np.concatenate([samples[name].value for name in names]), pa.float64()),
            pa.array(np.concatenate([samples[name].quality for name in names]), pa.int16()),
        ],
        schema=SCHEMA,
    )


def samples_by_tag(table: Any, wanted: frozenset[str], start_s: float, end_s: float) -> dict[str, Samples]:
    """Return the samples of a table by tag, in their order within the table; a time without zone is UTC.

    Raises
    ------
    HistorianError
        A column is of a type that holds no times or no numbers.
    """
    refuse_other_types(table.schema)
    stamp = table["timestamp"]
    known = pc.is_valid(stamp)
    if not pc.all(known).as_py():
        table = table.filter(known)
        stamp = table["timestamp"]
    time_s = stamp.cast(pa.int64()).to_numpy() / PER_SECOND[stamp.type.unit]
    try:
        value = _numbers(table["value"])
        quality = _codes_of_quality(table["quality"])
    except pa.ArrowException as error:
        raise HistorianError(
            f"a value or quality is no number: {str(error).splitlines()[0]}; mend the store"
        ) from error
    names, code = _codes(table["tag"])
    order = np.argsort(code, kind="stable")
    begin = np.searchsorted(code[order], np.arange(len(names)), side="left")
    end = np.searchsorted(code[order], np.arange(len(names)), side="right")
    found = {}
    for k, name in enumerate(names):
        if name not in wanted or begin[k] == end[k]:
            continue
        rows = order[begin[k] : end[k]]
        if np.isfinite(start_s) or np.isfinite(end_s):
            rows = rows[(time_s[rows] >= start_s) & (time_s[rows] < end_s)]
        found[name] = Samples(time_s[rows], value[rows], quality[rows])
    return found


def _numbers(column: Any) -> Any:
    """Return the values of a column; a text that is no number, such as Bad Input, is none."""
    kind = column.type.value_type if pa.types.is_dictionary(column.type) else column.type
    if not (pa.types.is_string(kind) or pa.types.is_large_string(kind)):
        return column.cast(pa.float64()).to_numpy()
    return _by_text(column, _value, float("nan"))


def _codes_of_quality(column: Any) -> Any:
    """Return the quality codes of a column; words as an OPC client writes them: good, uncertain, and bad for others."""
    kind = column.type.value_type if pa.types.is_dictionary(column.type) else column.type
    if not (pa.types.is_string(kind) or pa.types.is_large_string(kind)):
        return pc.fill_null(column.cast(pa.int16()), BAD).to_numpy()
    return _by_text(column, _quality, float(BAD)).astype(np.int16)


def _by_text(column: Any, of: Callable[[str], float], empty: float) -> Any:
    """Return the number of each text, `empty` of none; each text is read once."""
    texts, code = _codes(column)
    numbers = np.array([*(of(text) for text in texts), empty])
    return numbers[code]


def _value(text: str) -> float:
    """Return a value as text; none for a word.

    Raises
    ------
    HistorianError
        It has a comma, which may divide decimals or thousands.
    """
    if "," in text and np.isfinite(_number(text.replace(",", ""))):
        raise HistorianError(f"value {text!r} has a comma: write values as numbers, or with a decimal point")
    return _number(text)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")


def _quality(text: str) -> float:
    code = _number(text)
    if np.isfinite(code) and 0.0 <= code <= np.iinfo(np.int16).max:
        return code
    word = text.strip().lower()
    for beginning, found in WORDS.items():
        if word.startswith(beginning):
            return float(found)
    raise HistorianError(f"quality {text!r} is not known; write 192 for good, 64 for uncertain, 0 for bad")


def _codes(tags: Any) -> tuple[list[str], Any]:
    """Return the names of the tags, and for each row the number of its name, -1 for none."""
    if not pa.types.is_dictionary(tags.type):
        tags = pc.dictionary_encode(tags)
    if isinstance(tags, pa.ChunkedArray):
        tags = tags.unify_dictionaries().combine_chunks()
    if isinstance(tags, pa.ChunkedArray):  # of no chunk
        return [], np.zeros(0, dtype=np.int32)
    return tags.dictionary.to_pylist(), pc.fill_null(tags.indices, -1).to_numpy()
