"""Meaning of a unit as written: the known unit and the factor to it, as in `0.1 °C`, `mK` and `1/10 bar`.

A number before a unit is the value of one count, where it is not above one. `x10 W`, `10 W` and `°C*10` may mean that
the numbers are to be multiplied, or that they have been: such a factor is open, and nothing is read with it.
"""

from __future__ import annotations

import re

from drivers.signals import known_unit, prefixed_unit

FAHRENHEIT = ("°f", "degf", "deg f", "fahrenheit")
"""Ways to write degrees Fahrenheit, lower case; no signal of this project is in them."""

_NUMBER = r"(?:1\s*/\s*10+|10\s*(?:\^|\*\*)\s*-\d|10[⁻]?[¹²³⁴⁵⁶]|\d+(?:[.,]\d+)?(?:[eE][+-]?\d+)?)"
_TIMES = r"[xX×*·]"
_BEFORE = re.compile(rf"(?P<times>{_TIMES})?\s*(?P<number>{_NUMBER})\s*{_TIMES}?\s*(?P<unit>[^\s\d].*)")
_BEHIND = re.compile(rf"(?P<unit>.*?[^\s\d])[\s(\[]*(?:{_TIMES}|/|÷)\s*{_NUMBER}\s*[)\]]?")
_IN_NAME = re.compile(rf"(?:^|[\s_(\[]){_TIMES}\s?(?:10+|0[.,]0*1)(?=$|[\s_)\]])|(?:^|[\s_(\[])1/10+(?=$|[\s_)\]])")

SCALES: dict[str, tuple[str, float, float]] = {
    "degC": ("temperature", 1.0, 0.0),
    "K": ("temperature", 1.0, -273.15),
    "degF": ("temperature", 1.0 / 1.8, -32.0 / 1.8),
    "W": ("power", 1.0, 0.0),
    "kW": ("power", 1e3, 0.0),
    "L/min": ("flow", 1.0, 0.0),
    "L/s": ("flow", 60.0, 0.0),
    "L/h": ("flow", 1.0 / 60.0, 0.0),
    "m3/h": ("flow", 1000.0 / 60.0, 0.0),
    "Pa": ("pressure", 1.0, 0.0),
    "mbar": ("pressure", 1e2, 0.0),
    "kPa": ("pressure", 1e3, 0.0),
    "bar": ("pressure", 1e5, 0.0),
    "MPa": ("pressure", 1e6, 0.0),
    "V": ("voltage", 1.0, 0.0),
    "mV": ("voltage", 1e-3, 0.0),
    "kV": ("voltage", 1e3, 0.0),
    "A": ("current", 1.0, 0.0),
    "mA": ("current", 1e-3, 0.0),
    "Wh": ("energy", 1.0, 0.0),
    "kWh": ("energy", 1e3, 0.0),
    "kJ": ("energy", 1.0 / 3.6, 0.0),
    "s": ("time", 1.0, 0.0),
    "ms": ("time", 1e-3, 0.0),
}
"""Quantity of a unit, and factor and offset to the first unit of that quantity (exact by definition; BIPM SI brochure).
"""


def unit_of(text: str) -> str | None:
    """Return the unit in a cell of a heading or a line of units, `degF` among them; None where it has none."""
    bare = text.strip().strip("[](){} ")
    if bare.lower() in FAHRENHEIT:
        return "degF"
    unit = known_unit(bare) if bare else None
    return None if unit == "1" else unit


def meaning_of(text: str) -> tuple[str, float] | None:
    """Return the known unit in `text` and the factor that makes its numbers those of that unit.

    None for a text that is no known unit, and for one whose factor is open (`has_open_factor`).
    """
    bare = text.strip().strip("[](){} ")
    if (unit := "degF" if bare == "F" else unit_of(bare)) is not None:
        return unit, 1.0
    if (prefixed := prefixed_unit(bare)) is not None:
        return prefixed
    before = _BEFORE.fullmatch(bare)
    if before is None or (count := _number(before["number"])) is None or count > 1.0:
        return None
    inner = _plain(before["unit"])
    return None if inner is None else (inner[0], inner[1] * count)


_BROKEN = {
    "Â°": "UTF-8 read as Latin-1; save the file as UTF-8",
    "Â": "UTF-8 read as Latin-1; save the file as UTF-8",
    "¬∞": "UTF-8 read as Mac Roman; save the file as UTF-8",
    "ø": "code page 437 or 850 read as Latin-1; save the file as UTF-8",
    "¡": "Mac Roman read as Latin-1; save the file as UTF-8",
    "?": "a degree sign that its encoding lacks; write °",
    "ï¿½": "a degree sign that was lost; write °",
    "\N{REPLACEMENT CHARACTER}": "a degree sign that was lost; write °",
}
"""Broken degree sign before C, F or K -> its cause and the remedy."""


def broken_sign(text: str) -> tuple[str, str] | None:
    """Return the broken degree sign of a unit such as `Â°C` and its cause with the remedy; None for any other text."""
    bare = text.strip().strip("[](){} ")
    sign = bare[:-1].strip()
    return (sign, _BROKEN[sign]) if bare[-1:] in ("C", "F", "K") and sign in _BROKEN else None


_FOREIGN = re.compile(
    r"(?:us|i)?gpm|s?cfm|acfm|s?lpm|sccm|psi[agd]?|(?:in|mm)hg|torr|at[ma]|(?:in|mm)?h2o|mwc|mmws|ft|feet|inch|inche?s|yd|"
    r"lbs?|lbf|oz|btuh?|mbh|bhp|k?cal|therm|rankine|reaumur|degr|grad|frac(?:tion)?|ratio|counts?|digits?|ticks?|"
    r"ph|ppm|ppb|ntu|lux|k?nm|knots?|kn|mph|fps|rps|gal|tons?|ltr|lit(?:er|re)s?|mg"
)
"""Units and kinds of numbers, lower case, that no signal of this project is in.

Words that also name something else in a rig, such as `in` (inlet) and `HP` (high pressure), are not among them.
"""
_PER = (
    r"(?:h|hr|hrs|hour|std|min|s|sec|d|day|m|m2|m3|m²|m³|cm|mm|ft|ft2|ft3|in|in2|in²|kg|g|lb|l|gal|k|c|°c|°f|f|rev|v|a)"
)
_SYMBOLIC = re.compile(
    rf"[a-zµ°³²0-9]{{1,6}}\s?/\s?{_PER}|°\s?\w{{1,3}}|µ\w{{1,3}}(?:/\w+)?|\w{{1,3}}[²³](?:/\w+)?|%.*|0\.\.1"
)


def looks_like_unit(text: str) -> bool:
    """Return True for a text that is a unit, though perhaps none that is known here: `gpm`, `BTU/hr`, `m³/s`, `°Ré`."""
    bare = text.strip().strip("[](){} ").lower()
    return meaning_of(text) is not None or _FOREIGN.fullmatch(bare) is not None or _SYMBOLIC.fullmatch(bare) is not None


def has_open_factor(text: str) -> bool:
    """Return True for a known unit with a number whose meaning is open, as in `x10 W`, `10 W`, `°C*10` and `°C/10`."""
    bare = text.strip().strip("[]{} ")
    bare = bare[1:-1] if bare.startswith("(") and bare.endswith(")") else bare
    if meaning_of(bare) is not None:
        return False
    found = _BEFORE.fullmatch(bare) or _BEHIND.fullmatch(bare)
    return found is not None and _plain(found["unit"]) is not None


def names_factor(name: str) -> bool:
    """Return True for a name that holds a factor of ten outside its unit, as `T x10` and `P_x0.1_W` do."""
    return _IN_NAME.search(name) is not None


def conversion(unit: str, factor: float, target: str) -> tuple[float, float] | None:
    """Return factor and offset from numbers in `factor` times `unit` to `target`; None for other quantities."""
    if unit == target:
        return factor, 0.0
    if unit not in SCALES or target not in SCALES or SCALES[unit][0] != SCALES[target][0]:
        return None
    (_, by, offset), (_, target_by, target_offset) = SCALES[unit], SCALES[target]
    return factor * by / target_by, (offset - target_offset) / target_by


def _plain(text: str) -> tuple[str, float] | None:
    unit = unit_of(text)
    return (unit, 1.0) if unit is not None else prefixed_unit(text.strip())


def _number(text: str) -> float | None:
    """Return the number before a unit, None where it is zero."""
    bare = re.sub(r"\s", "", text).replace(",", ".")
    if bare.startswith("1/"):
        return 1.0 / float(bare[2:])
    if power := re.fullmatch(r"10(?:\^|\*\*)(-\d)", bare):
        return float(10.0 ** int(power[1]))
    if power := re.fullmatch("10(⁻?)([¹²³⁴⁵⁶])", bare):
        size = "¹²³⁴⁵⁶".index(power[2]) + 1
        return float(10.0 ** (-size if power[1] else size))
    return float(bare) or None
