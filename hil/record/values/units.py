"""Questions about units that a record's numbers contradict; they are questions, since nothing is certain."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from hil.record.values.question import UnitQuestion
from twin import Network, celsius_conversion

ValueColumns = Mapping[str, NDArray[np.float64]]

SHARE = 0.01
"""Share of its declared range below which an active input may be in another unit."""
COLDEST_K = 150.0
"""Lowest median of a column in kelvin."""
FAR_K, NEAR_K, HOT_K = 20.0, 3.0, 30.0
"""Distances from the room temperature: implausible at switch-on, plausible at switch-on, and rare for a rig that is
off.
"""
BOILING_C = 100.0
"""Temperature that water of a rig does not reach."""
_DIFFERENCE_WORDS = (
    "delta|diff|difference|differenz|spread|spreizung|rise|drop|minus|approach|range|lift|gradient|ecart|écart"
)
_DIFFERENCES = re.compile(rf"(^|[_ ])({_DIFFERENCE_WORDS})([_ ]|$)|^d_?T(?![a-z])", re.IGNORECASE)
_DRIVES = ("_W", "_kW", "_pct", "_L_per_min", "_kg_per_s", "_rpm")


def is_difference(name: str) -> bool:
    """Return True for the name of a temperature difference, of which a kelvin is a degree Celsius."""
    return _DIFFERENCES.search(name) is not None


def of_a_room(name: str) -> bool:
    """Return True for a column whose name is that of a room or outdoor air temperature."""
    return any(word.startswith(("amb", "room", "outdoor")) for word in name.lower().split("_"))


def remarks(columns: ValueColumns) -> list[str]:
    """Return questions about the units of a record that need no twin."""
    return [*_by_name(columns), *_fractions(columns), *_at_first(columns), *_tenths(columns)]


def beyond_declared(network: Network, columns: ValueColumns) -> list[str]:
    """Return questions about inputs that use almost none of the range that their twin declares."""
    said: list[str] = []
    for column, spec in network.inputs.items():
        values = _finite(columns.get(column))
        width = spec.upper - spec.lower
        if column.endswith(("_C", "_h")) or not values.size or not np.isfinite(width):
            continue
        most = float(values.max())
        if spec.lower < most <= spec.lower + SHARE * width and not _fraction(column, values):
            said.append(
                UnitQuestion(
                    f"{column} is {values.min():.4g} to {most:.4g} in this record, where the twin declares "
                    f"{spec.lower:g} to {spec.upper:g} {spec.unit}: is it in another unit?"
                )
            )
    return said


def _by_name(columns: ValueColumns) -> list[str]:
    said = []
    for name, values in columns.items():
        known = celsius_conversion(name)
        if known is None or not _finite(values).size or (known[0] == "kelvin" and is_difference(name)):
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


def _fractions(columns: ValueColumns) -> list[str]:
    return [
        UnitQuestion(f"{name} is {values.min():.4g} to {values.max():.4g}: is it a fraction of 1?")
        for name, column in columns.items()
        if _fraction(name, values := _finite(column))
    ]


def _fraction(name: str, values: NDArray[np.float64]) -> bool:
    return name.endswith("_pct") and bool(values.size) and values.min() >= 0.0 and 0.0 < values.max() <= 1.0


def _at_first(columns: ValueColumns) -> list[str]:
    """Return questions about the unit of first readings that do not fit the temperature of the room."""
    first = {name: float(known[0]) for name, values in columns.items() if (known := _finite(values)).size}
    room = next((value for name, value in first.items() if name.endswith("_C") and of_a_room(name)), None)
    read = {name: value for name, value in first.items() if name.endswith("_C") and not of_a_room(name)}
    if room is None or not read:
        return []
    names = ", ".join(read) if len(read) < 4 else f"{', '.join(list(read)[:3])} and {len(read) - 3} others"
    verb = "begin" if len(read) > 1 else "begins"
    told = f"{names} {verb} at {_between(list(read.values()))} in a room of {room:.4g} degC"
    if all(abs(x - room) > FAR_K and abs((x - 32.0) / 1.8 - room) < NEAR_K for x in read.values()):
        return [UnitQuestion(f"{told}, which is as much in degrees Fahrenheit: is that the unit?")]
    drives = [value for name, value in first.items() if name.endswith(_DRIVES)]
    if drives and not any(drives) and all(HOT_K < abs(x - room) < COLDEST_K for x in read.values()):
        return [f"{told} with everything off: is the rig hot from before, or are they in another unit?"]
    return []


def _tenths(columns: ValueColumns) -> list[str]:
    """Return questions about temperatures of whole numbers above boiling, in a room that fits a tenth of them."""
    rooms = [float(np.median(_finite(v))) for name, v in columns.items() if of_a_room(name) and _finite(v).size]
    room = next((value for value in rooms if value < BOILING_C / 2), None)
    said: list[str] = []
    for name, column in columns.items():
        values = _finite(column)
        if room is None or not name.endswith("_C") or of_a_room(name) or is_difference(name) or not values.size:
            continue
        least, middle = float(values.min()), float(np.median(values))
        is_whole = bool((values == np.round(values)).all()) and float(np.ptp(values)) > 0.0
        fits = least / 10.0 > room - NEAR_K and middle / 10.0 < BOILING_C
        if is_whole and least > BOILING_C and fits:
            told = f"{name} is {least:.4g} to {values.max():.4g}, whole numbers, in a room of {room:.4g} degC"
            said.append(UnitQuestion(f"{told}: is it in tenths of a degree?"))
    return said


def _between(values: list[float]) -> str:
    low, high = min(values), max(values)
    return f"{low:.4g}" if high - low < 0.05 else f"{low:.4g} to {high:.4g}"


def _finite(values: NDArray[np.float64] | None) -> NDArray[np.float64]:
    return np.zeros(0) if values is None else values[np.isfinite(values)]
