"""Units that a record's numbers do not bear out: remarks in the form of questions, since nothing is sure."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from twin.column_names import celsius_conversion
from twin.network import Network

Columns = Mapping[str, NDArray[np.float64]]

SHARE = 0.01
"""Share of its declared range below which an input that is ever on may be in another unit."""
COLDEST_K = 150.0
"""Below this median a column of kelvin is none."""
FAR_K, NEAR_K, HOT_K = 20.0, 3.0, 30.0
"""From the room: what no rig reads as it is switched on, what it does read, and what one that is off seldom does."""
_DRIVES = ("_W", "_kW", "_pct", "_L_per_min", "_kg_per_s", "_rpm")


def of_a_room(name: str) -> bool:
    """Whether a column is by its name the temperature of a room or of the air outdoors."""
    return any(word.startswith(("amb", "room", "outdoor")) for word in name.lower().split("_"))


def remarks(columns: Columns) -> list[str]:
    """What the columns of a record tell without a twin."""
    return [*_by_name(columns), *_fractions(columns), *_at_first(columns)]


def beyond_declared(network: Network, columns: Columns) -> list[str]:
    """Inputs that use next to nothing of the range that their twin declares."""
    said = []
    for column, spec in network.inputs.items():
        values = _finite(columns.get(column))
        width = spec.upper - spec.lower
        if column.endswith(("_C", "_h")) or not values.size or not np.isfinite(width):
            continue
        most = float(values.max())
        if spec.lower < most <= spec.lower + SHARE * width and not _fraction(column, values):
            said.append(
                f"{column} is {values.min():.4g} to {most:.4g} in this record, where the twin declares {spec.lower:g} "
                f"to {spec.upper:g} {spec.unit}: is it in another unit?"
            )
    return said


def _by_name(columns: Columns) -> list[str]:
    said = []
    for name, values in columns.items():
        known = celsius_conversion(name)
        if known is None or not _finite(values).size:
            continue
        unit, how, renamed = known
        middle = float(np.nanmedian(values))
        if unit == "kelvin" and middle < COLDEST_K:
            said.append(
                f"{name} is in kelvin by its name, but its median is {middle:.4g}: if it is in degC, call it {renamed}"
            )
        else:
            said.append(f"{name} is in {unit} by its name, and twins read degC: {how}, and call it {renamed}")
    return said


def _fractions(columns: Columns) -> list[str]:
    return [
        f"{name} is {values.min():.4g} to {values.max():.4g}: is it a fraction of 1?"
        for name, column in columns.items()
        if _fraction(name, values := _finite(column))
    ]


def _fraction(name: str, values: NDArray[np.float64]) -> bool:
    return name.endswith("_pct") and bool(values.size) and values.min() >= 0.0 and 0.0 < values.max() <= 1.0


def _at_first(columns: Columns) -> list[str]:
    """What the first readings say of their unit, where the room's temperature stands beside them."""
    first = {name: float(known[0]) for name, values in columns.items() if (known := _finite(values)).size}
    room = next((value for name, value in first.items() if name.endswith("_C") and of_a_room(name)), None)
    read = {name: value for name, value in first.items() if name.endswith("_C") and not of_a_room(name)}
    if room is None or not read:
        return []
    names = ", ".join(read) if len(read) < 4 else f"{', '.join(list(read)[:3])} and {len(read) - 3} others"
    verb = "begin" if len(read) > 1 else "begins"
    told = f"{names} {verb} at {_between(list(read.values()))} in a room of {room:.4g} degC"
    if all(abs(x - room) > FAR_K and abs((x - 32.0) / 1.8 - room) < NEAR_K for x in read.values()):
        return [f"{told}, which is as much in degrees Fahrenheit: is that the unit?"]
    drives = [value for name, value in first.items() if name.endswith(_DRIVES)]
    if drives and not any(drives) and all(HOT_K < abs(x - room) < COLDEST_K for x in read.values()):
        return [f"{told} with everything off: is the rig hot from before, or are they in another unit?"]
    return []


def _between(values: list[float]) -> str:
    low, high = min(values), max(values)
    return f"{low:.4g}" if high - low < 0.05 else f"{low:.4g} to {high:.4g}"


def _finite(values: NDArray[np.float64] | None) -> NDArray[np.float64]:
    return np.zeros(0) if values is None else values[np.isfinite(values)]
