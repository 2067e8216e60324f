"""Effects of a cell's twin file: read for its model, and adopted as elements of a new revision."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from twin.elements.tower_effect import TowerEffect
from twin.network import Network, Revision
from twin.revisions import with_elements
from twin.tower.effects import UNITS, CellEffect
from twin.tower.twin_file import value_of


def effects_of(network: Network) -> tuple[CellEffect, ...]:
    """Return the effects of a cell's twin, in file order."""
    found = []
    for one in network.elements:
        if not isinstance(one, TowerEffect):
            continue
        v = {
            name: value_of(network, f"{one.name}.{name}")
            for name in ("size", "sd", "form", "centre", "spread", "onset_s")
        }
        has_form = one.driver in ("wind_direction", "solar", "low_flow")
        found.append(
            CellEffect(
                one.effect,
                one.path,
                one.driver,
                v["form"] if has_form else None,
                one.column,
                v["centre"],
                v["spread"],
                v["onset_s"] or None,
                v["size"],
                v["sd"],
            )
        )
    return tuple(found)


def adopted(network: Network, effects: Sequence[CellEffect], revision: Revision) -> Network:
    """Return a cell's twin with more effects.

    Raises
    ------
    TwinFileError
        A check of the twin file fails.
    """
    taken = {element.name for element in network.elements}
    tables: dict[str, dict[str, Any]] = {}
    inputs: dict[str, dict[str, Any]] = {}
    for one in effects:
        name = next(n for n in (one.kind, *(f"{one.kind}_{k}" for k in range(2, 99))) if n not in taken)
        taken.add(name)
        source = f"hil diagnose; {UNITS[one.path]} where the driver is 1"
        table: dict[str, Any] = {
            "kind": TowerEffect.kind,
            "node": "flume",
            "effect": one.kind,
            "path": one.path,
            "driver": one.driver,
            "size": _fixed(one.size, source),
            "sd": _fixed(one.sd, source),
        }
        if one.form is not None:
            table["form"] = _fixed(one.form, source)
        if one.onset_s is not None:
            table["onset_s"] = {"value": float(round(one.onset_s)), "status": "fixed", "source": source}
        if one.column:
            table |= {
                "column": one.column,
                "centre": _fixed(one.centre, source),
                "spread": _fixed(one.spread, source),
            }
            if one.column not in network.inputs:
                low, high = one.centre - 100.0 * one.spread, one.centre + 100.0 * one.spread
                inputs[one.column] = {"nominal": one.centre, "lower": low, "upper": high, "unit": "1"}
        tables[name] = table
    return with_elements(network, tables, revision=revision, inputs=inputs)


def _fixed(value: float, source: str) -> dict[str, Any]:
    return {"value": float(f"{value:.6g}"), "status": "fixed", "source": source}
