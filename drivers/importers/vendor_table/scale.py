"""Factors of a vendor's register table, found in a column, a unit, a name or a remark.

A factor is used only where the table leaves one meaning. `0.1` is the value of one count. `10` is not: some vendors
mean raw x 10 by it, others that the register holds ten times the value (a manual of compressor modules explains its
"scale 10" as a division). A whole number that is not positive may be a power of ten, as in SunSpec's scale factors.
"""

from __future__ import annotations

import math
import re

from drivers.signals import canonical_unit

_NUMBER = r"(?:1/10+|\d+(?:[.,]\d+)?(?:[eE]-?\d+)?)"
_TIMES = r"[x×*·]"
_LEADING = re.compile(rf"(?P<times>{_TIMES})?\s*(?P<number>{_NUMBER})\s*{_TIMES}?\s*(?P<unit>\D.*)")
_DIGIT_OF_UNIT = re.compile(r"(?<=[A-Za-z°])[234](?![0-9.,])")
"""A power or an index: m3, W/m2, CO2."""
_IN_WORDS = re.compile(
    r"\b(?:tenth|hundredth|thousandth|zehntel|hundertstel|tausendstel|dixieme|dixi.me|centi.me)", re.I
)
_IN_REMARK = re.compile(
    rf"{_TIMES}\s*(?:10+\b|0[.,]\d)|(?<![\w/])/\s*10+\b|\b1/10+\b|\b0[.,]0*1\s*(?:°|deg|K\b|%|bar|k?Pa|V\b|A\b|k?W|Hz|l/)|"
    r"\b(?:scaled?|scaling|factor|faktor|skalier\w*|divide\w*|multipl\w*|resolution|aufl.sung)\b[^.;]{0,20}\d|"
    r"\b(?:10+)\s*=\s*1(?:[.,]0+)?\b",
    re.I,
)


class ScaleError(ValueError):
    """Error of a factor whose meaning is not certain; the message has cause and remedy."""


def factor_of(text: str, *, is_exponent_column: bool = False, is_value_of_a_count: bool = False) -> float | None:
    """Return the value of one count of a cell such as `0.1`, `0,01`, `1/10`, `10/1`, `x0.1` or `/10`; None where empty.

    With `is_exponent_column` the column holds numbers that cannot be factors, so that none of it is certain. With
    `is_value_of_a_count` its heading says units per bit or the like, so that 10 has one meaning. Raises ScaleError.
    """
    bare = re.sub(r"\s", "", text)
    if bare in ("", "-", "--", "–", "n/a", "na", "none", "N/A"):
        return None
    fraction = re.fullmatch(r"(\d{1,9})/(\d{1,9})", bare)
    if fraction is not None and int(fraction[1]) and int(fraction[2]):
        return int(fraction[1]) / int(fraction[2])
    over = re.fullmatch(r"[/÷:](\d{1,9})", bare)
    if over is not None and int(over[1]):
        return 1.0 / int(over[1])
    power = re.fullmatch(r"10(?:\^|\*\*)(-?\d{1,2})", bare)
    if power is not None:
        return float(10.0 ** int(power[1]))
    number = _number(bare.lstrip("x×*·"), text)
    is_whole = number == int(number)
    if is_whole and is_exponent_column:
        raise ScaleError(
            f"scale {text!r} is in a column of whole numbers that may be powers of ten or registers that hold them; "
            "write the value of one count, 1/10 or 10/1"
        )
    if is_whole and number <= 0:
        raise ScaleError(
            f"scale {text!r} loses the value, or is a power of ten; write the value of one count, 1/10 for example"
        )
    if number > 1 and not is_value_of_a_count:
        raise ScaleError(
            f"scale {text!r} may mean raw x {number:g} or raw / {number:g}; write {number:g}/1 or 1/{number:g}"
        )
    return number


def divisor_of(text: str) -> float | None:
    """Return the value of one count of a divisor's cell, None where it is empty; raise ScaleError."""
    bare = re.sub(r"\s", "", text)
    if bare in ("", "-"):
        return None
    by = _number(bare.lstrip("/÷:"), text, "divisor")
    if by == 0:
        raise ScaleError("divisor 0 is none; correct it")
    if abs(by) < 1:
        raise ScaleError(
            f"divisor {text!r} may be the value of one count; call the column scale, or write 10 for a tenth"
        )
    return 1.0 / by


def is_exponent_like(text: str) -> bool:
    """Return whether a cell of a scale column is a whole number that is not positive, or the name of a register."""
    bare = text.strip()
    return bool(re.fullmatch(r"-\d+|0|\+\d+", bare)) or bool(re.fullmatch(r"[A-Za-z]\w*_?SF", bare, re.I))


def unit_and_factor(unit: str) -> tuple[str, float | None]:
    """Return a unit without the number in it, and the value of one count that the number is; raise ScaleError.

    `0.1 °C` and `1/10 K` are the value of one count; `x10 kPa`, `°C*10` and tenths in words are not certain.
    """
    try:
        return canonical_unit(unit.strip()), None
    except ValueError:
        pass
    if re.search(r"\d\s*[=:]\s*[A-Za-z]", unit) is not None:
        raise ScaleError(f"unit {unit!r} lists states; leave the unit empty and put them in a column remark")
    said = f"unit {unit!r} holds a factor; give the unit alone, and 1/10 or 10/1 in a column scale"
    leading = _LEADING.fullmatch(unit.strip())
    if leading is not None and leading["times"] is None and not _has_number(leading["unit"]):
        try:
            number = factor_of(leading["number"])
        except ScaleError:
            raise ScaleError(said) from None
        return leading["unit"].strip(), number
    if _has_number(unit) or _IN_WORDS.search(unit):
        raise ScaleError(said)
    return unit, None


def factor_in_words(*texts: str) -> str | None:
    """Return the first part of names and remarks that looks like a factor, or None."""
    for text in texts:
        found = _IN_REMARK.search(text) or _IN_WORDS.search(text)
        if found is not None:
            return found[0].strip()
    return None


def _has_number(unit: str) -> bool:
    return any(c.isdigit() or c in "⁻¹½¼" for c in _DIGIT_OF_UNIT.sub("", unit))


def _number(bare: str, text: str, what: str = "scale") -> float:
    if re.fullmatch(r"[1-9]\d{0,2},\d{3}", bare):
        raise ScaleError(f"{what} {text!r} may be a thousand or a fraction; write it as 1/1000 or 1000/1")
    if re.fullmatch(r"10[eE][-+]?\d+", bare):
        raise ScaleError(f"{what} {text!r} may be a power of ten or ten of them; write it as 1/10 or 10/1")
    try:
        number = float(bare.replace(",", ".")) if bare.count(",") < 2 else math.nan
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ScaleError(f"{what} {text!r} is no number; write the number alone, its unit in a column unit")
    return number
