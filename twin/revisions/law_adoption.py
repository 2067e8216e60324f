"""Adoption of a law: the edit that puts an effect which no named element describes into a twin."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from twin.column_names import UNITS_OF_SUFFIX
from twin.elements import KINDS
from twin.elements.base import STAMP
from twin.elements.candidates import free_name
from twin.elements.law import Law
from twin.network import Network, Revision, TwinFileError
from twin.revisions.revision_chain import NOTHING, with_elements

_PLACES_OF_INPUTS = ("driver", "minus_input", "ambient")
SOURCE = "adopted law"


def adopt_law(
    network: Network,
    law: Mapping[str, str],
    parameters: Mapping[str, float],
    *,
    name: str = "",
    columns: Mapping[str, ArrayLike] = NOTHING,
    sample_s: float | None = None,
    revision: Revision | None = None,
) -> Network:
    """Return the network with one more law; the old one stays unchanged.

    Input columns that the network lacks are declared: a column of the record with the median and the range that it
    has there, and the stamps. A law of an actuator or of an input brings a neutral actuator with it where the column
    has none.

    Parameters
    ----------
    network
        The present network.
    law
        Keys of the law as in a twin file: its ``kind`` and places, the driver (``driver``, ``of``, ``minus``,
        ``minus_input``), ``form`` and ``course``, as ``{"kind": "law_heat", "node": "tank", "form": "constant"}``.
        Forms and courses are those of `twin.elements.law_forms`; the course is ``always`` by default.
    parameters
        Name -> value in the parameter's unit; the others keep their defaults.
    name
        Name of the new element; by default one that is free, made of kind and place.
    columns
        Columns of the record (n,), for those that the network does not declare yet.
    sample_s
        Interval of the record's samples, s, over which a time course is averaged.
    revision
        Origin of the new network; None keeps the present one.

    Raises
    ------
    TwinFileError
        The law is inconsistent, or a column is neither declared nor in the record; one plain sentence.
    """
    keys = {"course": "always", **law}
    kind = keys.get("kind", "")
    if kind not in KINDS or not issubclass(KINDS[kind], Law):
        laws = ", ".join(sorted(k for k, cls in KINDS.items() if issubclass(cls, Law)))
        raise TwinFileError(f"{kind!r} is no kind of law; give one of {laws} as the kind of the site")
    course = keys["course"]
    if course != "always" and sample_s is not None and "edge_s" not in parameters:
        parameters = {**parameters, "edge_s": float(sample_s)}
    name = name or _free_name(network, keys)
    table: dict[str, Any] = dict(keys)
    table |= {key: {"value": float(value), "source": SOURCE} for key, value in parameters.items()}
    wanted = [keys[key] for key in _PLACES_OF_INPUTS if keys.get(key)] + ([STAMP] if course != "always" else [])
    inputs = {column: _declared(network, column, columns) for column in wanted if column not in network.inputs}
    tables = {name: table}
    column = keys.get("column", "")
    delivering = any(e.kind == "actuator" and column in e.inputs() for e in network.elements)
    if kind in ("law_actuator", "law_input") and not delivering:
        tables = {f"actuator_of_{column}": {"kind": "actuator", "column": column}, **tables}
    return with_elements(network, tables, revision=revision, inputs=inputs)


def _free_name(network: Network, keys: Mapping[str, str]) -> str:
    place = next((keys[key] for key in ("node", "flow", "sensor", "column") if keys.get(key)), "site")
    return free_name(f"{keys['kind']}_{place}", network.elements)


def _declared(network: Network, column: str, columns: Mapping[str, ArrayLike]) -> dict[str, Any]:
    """Return the declaration of a new input."""
    if column == STAMP:
        return {"nominal": 0.0, "unit": "s", "source": "stamps of the samples"}
    values = np.asarray(columns.get(column, ()), dtype=np.float64).ravel()
    good = values[np.isfinite(values)]
    if not good.size:
        raise TwinFileError(
            f"column {column!r} is no input of twin {network.name!r} and has no values in the record; "
            "name a recorded column as the driver"
        )
    suffix = max((s for s in UNITS_OF_SUFFIX if column.endswith(f"_{s}")), key=len, default="")
    unit = {"unit": UNITS_OF_SUFFIX[suffix][0]} if suffix else {}
    lower, upper = float(good.min()), float(good.max())
    nominal = min(max(float(np.median(good)), lower), upper)
    return {"nominal": nominal, "lower": lower, "upper": upper, **unit, "source": "declared with a law"}
