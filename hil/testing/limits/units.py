"""Conversion of amounts between the units of a limit and of a signal."""

from __future__ import annotations

from drivers.signals import known_unit, prefixed_unit
from hil.testing.limits.statements import TIMES_S

_FACTORS: tuple[dict[str, float], ...] = (
    {"W": 1.0, "kW": 1e3},
    {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "mbar": 1e2, "bar": 1e5},
    {"L/min": 1.0, "L/s": 60.0, "L/h": 1.0 / 60.0, "m3/h": 1000.0 / 60.0},
    {"V": 1.0, "mV": 1e-3, "kV": 1e3},
    {"A": 1.0, "mA": 1e-3},
    {"Wh": 1.0, "kWh": 1e3, "kJ": 1.0 / 3.6},
    {"s": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0, "d": 86400.0},
)
"""Groups of units of one quantity, each with its factor to the first unit of the group."""


class UnitError(ValueError):
    """Unit of a limit that does not fit its signal; the message states the remedy."""


def difference_unit(unit: str) -> str:
    """Return the unit of a difference of two values in `unit`: K for degC."""
    return "K" if unit == "degC" else unit


def factor_to(unit: str, written: str, *, difference: bool = False) -> float:
    """Return the factor from the unit `written` in a limit to the signal's `unit`; of differences, degC is K.

    Raises
    ------
    UnitError
        `written` is no known unit, or one of another quantity.
    """
    symbol, factor = known_unit(written), 1.0
    if symbol is None and written in TIMES_S:
        symbol, factor = "s", TIMES_S[written]
    if symbol is None and (found := prefixed_unit(written)) is not None:
        symbol, factor = found
    if symbol is None:
        raise UnitError(f"has the unit {written!r}, which is not known; write it in {unit}")
    if difference:
        symbol, unit = difference_unit(symbol), difference_unit(unit)
    if symbol == unit:
        return factor
    for group in _FACTORS:
        if symbol in group and unit in group:
            return factor * group[symbol] / group[unit]
    hint = "; K is the unit of a difference" if {symbol, unit} == {"K", "degC"} else ""
    raise UnitError(f"is in {written}, and the signal is in {unit}{hint}; write the limit in {unit}")
