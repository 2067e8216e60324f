"""Tables of `hil bench records`, from the dataclasses of `hil.bench.experiments.public_records`."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from hil.bench.measure import Cell, ReportTable
from hil.run.session import ProgressBar


def measure(data: Path, seed: int) -> tuple[tuple[ReportTable, ...], tuple[str, ...]]:
    """Return tables of the public records under `data`, and a line if there are none."""
    if not (data / "real").is_dir():
        return (), (f"records: no {data / 'real'}; set HIL_DATA to the folder that holds 'real'",)
    from hil.bench.experiments.public_records import PARTS, run

    with ProgressBar("public records", len(PARTS)) as bar:
        found = run(data, seed=seed, progress=bar.update)
    tables = list(tables_of("records", "Public records", found))
    said = tuple(getattr(found, "messages", ()))
    if tables and said:
        tables[0] = dataclasses.replace(tables[0], notes=(*tables[0].notes, *said))
    return tuple(tables), ()


def tables_of(key: str, title: str, found: Any) -> Iterable[ReportTable]:
    """Return a table for every list of equal dataclasses, and one of all single values."""
    if isinstance(found, ReportTable):
        yield found
        return
    items = [found] if dataclasses.is_dataclass(found) else list(found)
    if any(isinstance(item, ReportTable) for item in items):
        yield from (item for item in items if isinstance(item, ReportTable))
        return
    nested = [_nested(item) for item in items]
    if any(nested):
        for item, inner in zip(items, nested, strict=True):
            name = str(getattr(item, "name", getattr(item, "title", title)))
            alone = {k: v for k, v in _fields(item).items() if k not in inner and k != "messages"}
            if alone:
                yield ReportTable(_key(name), name, ("what", "value"), tuple((k, _cell(v)) for k, v in alone.items()))
            for field, rows in inner.items():
                yield from tables_of(f"{_key(name)}_{field}", f"{name}: {field.replace('_', ' ')}", rows)
        return
    groups: dict[type, list[Any]] = {}
    for item in items:
        groups.setdefault(type(item), []).append(item)
    for kind, rows in groups.items():
        columns = tuple(field.name.replace("_", " ") for field in dataclasses.fields(kind))
        cells = tuple(tuple(_cell(v) for v in _fields(row).values()) for row in rows)
        yield ReportTable(key if len(groups) == 1 else f"{key}_{_key(kind.__name__)}", title, columns, cells)


def _fields(item: Any) -> dict[str, Any]:
    return {field.name: getattr(item, field.name) for field in dataclasses.fields(item)}


def _nested(item: Any) -> dict[str, list[Any]]:
    """Return the fields that hold lists of dataclasses."""
    found = {}
    for name, value in _fields(item).items():
        if isinstance(value, list | tuple) and value and all(dataclasses.is_dataclass(v) for v in value):
            found[name] = list(value)
    return found


def _cell(value: Any) -> Cell:
    if value is None or isinstance(value, str | int | float):
        return value
    if isinstance(value, Mapping):
        return ", ".join(f"{k} {_text(v)}" for k, v in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(_text(v) for v in value)
    return str(value)


def _text(value: Any) -> str:
    from hil.bench.measure import number

    return number(value) if isinstance(value, str | int | float) or value is None else str(value)


def _key(name: str) -> str:
    return "_".join("".join(c if c.isalnum() else " " for c in name.lower()).split())
