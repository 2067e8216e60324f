"""Table of the element kinds of a twin file: description, keys, parameters with units and bounds."""

from __future__ import annotations

import dataclasses
import inspect
import itertools
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from twin.elements import KINDS, Element, ParameterSpec

if TYPE_CHECKING:
    from rich.table import Table

_ROLES = {
    "node": "a node",
    "nodes": "a list of nodes",
    "input": "an input column",
    "columns": "a list of columns",
    "element": "an element",
}


def kinds_table() -> Table:
    """Return a table with one block a kind: its description, its keys, its parameters."""
    from rich import box
    from rich.table import Table

    table = Table(
        box=box.SIMPLE_HEAD, title="Element kinds of a twin file", title_justify="left", caption_justify="left"
    )
    for heading in ("kind", "key", "unit", "bounds", "if not given", "what it is"):
        table.add_column(heading, no_wrap=heading in ("kind", "unit"), max_width=22 if heading == "bounds" else None)
    for kind, cls in sorted(KINDS.items()):
        table.add_section()
        table.add_row(kind, "", "", "", "", _about(cls), style="bold")
        for key, field in cls.places().items():
            table.add_row("", key, "", *_place(field))
        for spec, only in parameters_of(cls):
            bounds, about = f"{spec.lower:g} to {spec.upper:g}", f"{spec.source} ({only})" if only else spec.source
            table.add_row("", spec.name, spec.unit, bounds, _default(spec.default), about)
    table.caption = (
        "A key with a unit is a parameter: a number, or a table with value, lower, upper, status, source. <node> and "
        "<unit> stand for a node of the twin and the unit of the column."
    )
    return table


def parameters_of(cls: type[Element]) -> list[tuple[ParameterSpec, str]]:
    """Return the parameters that an element of the kind may have, each with the keys that it depends on, "" for none.

    They come from elements with every choice, and with and without each optional key.
    """
    places = cls.places()
    options = {key: _options(key, field) for key, field in places.items()}
    found: dict[tuple[str, ...], tuple[ParameterSpec, list[dict[str, Any]]]] = {}
    asked = [dict(zip(options, picked, strict=True)) for picked in itertools.product(*options.values())]
    for keys in asked:
        element = cls("<name>", **{places[key].name: value for key, value in keys.items()})
        for spec in element.parameter_specs():
            same = (spec.name, spec.unit, str(spec.default), str(spec.lower), str(spec.upper))
            found.setdefault(same, (spec, []))[1].append(keys)
    return [(spec, _only(options, seen)) for spec, seen in found.values()]


def _about(cls: type[Element]) -> str:
    module = inspect.getmodule(cls)
    return (module.__doc__ or "").strip().splitlines()[0] if module else ""


def _place(field: dataclasses.Field[Any]) -> tuple[str, str, str]:
    """Return the admitted values of a key, its default, and its description."""
    role = field.metadata["role"]
    may = ", ".join(field.metadata["choices"]) if role == "choice" else _ROLES[role]
    return may, _default(None if _needed(field) else field.default), field.metadata["about"]


def _default(value: Any) -> str:
    if value is None:
        return "must be given"
    return f"{value:g}" if isinstance(value, float) else str(value) if value else "none"


def _needed(field: dataclasses.Field[Any]) -> bool:
    return field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING


def _options(key: str, field: dataclasses.Field[Any]) -> tuple[Any, ...]:
    """Return the values of a key in examples: each choice, or a name, and the default of an optional key."""
    role = field.metadata["role"]
    if role == "choice":
        return tuple(field.metadata["choices"])
    name = "<node>" if role in ("node", "nodes") else f"<{key}>_<unit>"
    value = (name,) if role in ("nodes", "columns") else name
    return (value,) if _needed(field) else (value, field.default)


def _only(options: Mapping[str, tuple[Any, ...]], seen: list[dict[str, Any]]) -> str:
    """Return the keys and choices that the elements `seen` have in common and others lack, as text."""
    parts = []
    for key, may in options.items():
        with_it = [value for value in may if any(keys[key] == value for keys in seen)]
        if len(with_it) == len(may):
            continue
        if all(isinstance(value, str) and not value.startswith("<") and value for value in may):
            parts.append(f"{key} = {' or '.join(with_it)}")
        else:
            parts.append(f"with {key}" if with_it[0] == may[0] else f"without {key}")
    return ", ".join(parts)
