"""Differences between two twins: elements added or removed, parameter values, and everything else by its key."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from twin.elements import Element, Parameter
from twin.elements.law import Law
from twin.laws import law_equation
from twin.network import Network
from twin.twinfile import to_tables

ABSENT = "absent"


@dataclass(frozen=True)
class ElementDiff:
    """An element that only one of the two twins has: its places (key -> name), its parameters, a law's equation."""

    name: str
    kind: str
    places: Mapping[str, str]
    parameters: tuple[Parameter, ...]
    equation: str = ""


@dataclass(frozen=True)
class ParameterDiff:
    """A parameter whose value differs, in `unit`. `relative` is after / before - 1, None where before is 0."""

    parameter: str
    before: float
    after: float
    unit: str
    relative: float | None


@dataclass(frozen=True)
class KeyDiff:
    """Any other difference: its key in the twin file and the two values, "absent" where there is none."""

    key: str
    before: str
    after: str


@dataclass(frozen=True)
class TwinDiff:
    """The changes that turn the first twin into the second; their origin is left out.

    A parameter that shares another's value is not listed when that value changes. An element that changed its kind
    is removed and added.
    """

    added: tuple[ElementDiff, ...]
    removed: tuple[ElementDiff, ...]
    moved: tuple[ParameterDiff, ...]
    changed: tuple[KeyDiff, ...]

    @property
    def empty(self) -> bool:
        """Return True if both describe the same twin."""
        return not (self.added or self.removed or self.moved or self.changed)


def diff(a: Network, b: Network) -> TwinDiff:
    """Return the differences from `a` to `b`, in the order of their files."""
    before, after = {e.name: e for e in a.elements}, {e.name: e for e in b.elements}
    both = [n for n in before if n in after and before[n].kind == after[n].kind]
    table_a, table_b = _comparable(a), _comparable(b)
    moved: list[ParameterDiff] = []
    for name in both:
        own_a, own_b = table_a["elements"][name], table_b["elements"][name]
        for key in own_a.keys() & own_b.keys():
            if isinstance(own_a[key], dict) and "value" in own_a[key] and "value" in own_b[key]:
                old, new = own_a[key].pop("value"), own_b[key].pop("value")
                if old != new:
                    unit = b.parameters[f"{name}.{key}"].unit
                    moved.append(ParameterDiff(f"{name}.{key}", old, new, unit, new / old - 1.0 if old else None))
    for table in (table_a, table_b):
        table["elements"] = {n: t for n, t in table["elements"].items() if n in both}
    order = {id_: k for k, id_ in enumerate(b.ids)}
    return TwinDiff(
        added=tuple(_piece(b, e) for e in b.elements if e.name not in both),
        removed=tuple(_piece(a, e) for e in a.elements if e.name not in both),
        moved=tuple(sorted(moved, key=lambda m: order[m.parameter])),
        changed=tuple(_changes((), table_a, table_b)),
    )


def _piece(network: Network, element: Element) -> ElementDiff:
    places = {key: _text(getattr(element, field.name)) for key, field in element.places().items()}
    own = tuple(p for p in network.parameters.values() if p.element == element.name)
    equation = str(law_equation(network, element)) if isinstance(element, Law) else ""
    return ElementDiff(element.name, element.kind, {k: v for k, v in places.items() if v}, own, equation)


def _comparable(network: Network) -> dict[str, Any]:
    """Return the tables of a twin without its revision; members of a set by parameter, so that one more is one
    change.
    """
    table = to_tables(network)
    del table["revision"], table["format"]
    for chosen in table.get("sets", {}).values():
        chosen["members"] = {m.pop("parameter"): m for m in chosen["members"]}
    return table


def _changes(keys: tuple[str, ...], a: Any, b: Any) -> list[KeyDiff]:
    if a == b:
        return []
    if not isinstance(a, dict) or not isinstance(b, dict):
        return [KeyDiff(".".join(keys), ABSENT if a is None else _text(a), ABSENT if b is None else _text(b))]
    found: list[KeyDiff] = []
    for key in (*a, *(key for key in b if key not in a)):
        found += _changes((*keys, key), a.get(key), b.get(key))
    return found


def _text(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{k} = {_text(v)}" for k, v in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(_text(v) for v in value)
    return f"{value:.12g}" if isinstance(value, float) else str(value)
