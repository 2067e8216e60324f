"""Samples as Arrow tables, and back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from drivers.historian.protocol import HistorianError, Samples

SCHEMA = pa.schema(
    [
        ("timestamp", pa.timestamp("ms", tz="UTC")),
        ("tag", pa.dictionary(pa.int32(), pa.string())),
        ("value", pa.float64()),
        ("quality", pa.int16()),
    ]
)
PER_SECOND = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}


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
    stamp = table["timestamp"]
    if not pa.types.is_timestamp(stamp.type):
        raise HistorianError(f"column timestamp holds {stamp.type} and no times; store timestamps with a zone")
    known = pc.is_valid(stamp)
    if not pc.all(known).as_py():
        table = table.filter(known)
        stamp = table["timestamp"]
    time_s = stamp.cast(pa.int64()).to_numpy() / PER_SECOND[stamp.type.unit]
    try:
        value = table["value"].cast(pa.float64()).to_numpy()
        quality = pc.fill_null(table["quality"].cast(pa.int16()), 0).to_numpy()
    except pa.ArrowInvalid as error:
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


def _codes(tags: Any) -> tuple[list[str], Any]:
    """Return the names of the tags, and for each row the number of its name, -1 for none."""
    if not pa.types.is_dictionary(tags.type):
        tags = pc.dictionary_encode(tags)
    if isinstance(tags, pa.ChunkedArray):
        tags = tags.unify_dictionaries().combine_chunks()
    if isinstance(tags, pa.ChunkedArray):  # of no chunk
        return [], np.zeros(0, dtype=np.int32)
    return tags.dictionary.to_pylist(), pc.fill_null(tags.indices, -1).to_numpy()
