"""Properties of a whole column of a register table: the base of its addresses and the decimal sign of its numbers."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from drivers.importers.vendor_table.words import squeezed
from drivers.signals import RegisterType, canonical_unit, plausible_range, raw_bounds

_PREFIXED = re.compile(r"0x[0-9a-f]{1,5}|[0-9a-f]{1,5}h", re.I)
_BARE = re.compile(r"[0-9a-f]{1,5}", re.I)


class ColumnError(ValueError):
    """Error of a column that can be read in two ways; the message has the remedy."""


def is_hexadecimal(cells: Sequence[str]) -> bool:
    """Return True where the addresses of a column without a base in its heading are hexadecimal.

    One cell with a letter A to F and without 0x makes the whole column hexadecimal. Raises ColumnError where some cells
    have the 0x of a hexadecimal number and others a letter without it, or where a cell's digits count the other way:
    a column of hexadecimal numbers of one width with a number of another width.
    """
    numbers = [cell.strip() for cell in cells if cell.strip()]
    bare = [cell for cell in numbers if _BARE.fullmatch(cell)]
    lettered = [cell for cell in bare if re.search(r"[a-f]", cell, re.I)]
    if not lettered:
        return False
    prefixed = [cell for cell in numbers if _PREFIXED.fullmatch(cell)]
    if prefixed:
        raise ColumnError(
            f"addresses {prefixed[0]!r} and {lettered[0]!r} are hexadecimal with a mark and without; call the column "
            "'address (hex)', or write 0x before each hexadecimal one"
        )
    widths = {len(cell) for cell in lettered if cell.startswith("0")} or {
        len(cell) for cell in bare if cell.startswith("0") and len(cell) > 1
    }
    other = next((cell for cell in bare if widths and len(cell) not in widths), None)
    if other is not None:
        raise ColumnError(
            f"address {lettered[0]!r} is hexadecimal and {other!r} is written otherwise; call the column "
            "'address (hex)', or write 0x before each hexadecimal one"
        )
    return True


def has_decimal_comma(cells: Sequence[str]) -> bool:
    """Return True where the numbers of a column have a decimal comma: one of them can be read in no other way."""
    return any(re.fullmatch(r"[x×*·]?-?(?:0,\d+|\d+,\d{1,2}|\d+,\d{4,}|\d{4,},\d+)", cell.strip()) for cell in cells)


def has_decimal_point(cells: Sequence[str]) -> bool:
    """Return True where the numbers of a column have a decimal point: one of them can be read in no other way."""
    return any(
        re.fullmatch(r"[x×*·]?-?(?:0\.\d+|\d+\.\d{1,2}|\d+\.\d{4,}|\d{4,}\.\d+)", cell.strip()) for cell in cells
    )


def ambiguous_thousand(text: str, *, decimal_comma: bool) -> bool:
    """Return True where a number of a column may be a thousand or a fraction: `1.000` where the comma is decimal."""
    return decimal_comma and re.fullmatch(r"[x×*·]?-?\d{1,3}(?:\.\d{3})+", text.strip()) is not None


def raw_ends(ends: Sequence[float], scale: float, offset: float, unit: str, kind: RegisterType) -> str:
    """Return the meaning of a range's ends: `raw` counts, in `unit` (degC, ...), `either`, `neither` or the `same`.

    They are the same where the type has no scale. They are raw where no reading in the unit is as large (`PLAUSIBLE`)
    or no register of type `kind` holds it, and are so once they are scaled. They are in the unit where they are no
    whole numbers.
    """
    if (scale in (0.0, 1.0) and offset == 0.0) or kind.startswith("float"):
        return "same"
    if any(end != int(end) for end in ends):
        return "unit"
    low, high = plausible_range(_symbol(unit))
    lowest, highest = raw_bounds(kind)
    as_unit = all(low <= end <= high and lowest <= (end - offset) / scale <= highest for end in ends)
    as_raw = all(low <= end * scale + offset <= high and lowest <= end <= highest for end in ends)
    if as_raw:
        return "either" if as_unit else "raw"
    return "unit" if as_unit else "neither"


def _symbol(unit: str) -> str:
    try:
        return canonical_unit(unit.strip())
    except ValueError:
        return "1"


_YES = ("yes", "y", "true", "1", "x", "ja", "j", "oui", "o", "si", "on", "swapped", "swap")
_NO = ("", "no", "n", "false", "0", "nein", "non", "off", "none", "kein", "aucun")


def order_of_swaps(cells: Mapping[str, str]) -> str | None:
    """Return the order of bytes by the columns `word swap`, `byte swap` and `swap`; None where there is none of them.

    Raises ValueError where a cell does not say yes or no, or does not say what is swapped.
    """
    given = {key: squeezed(cells[key]) for key in ("word_swap", "byte_swap", "swap") if key in cells}
    if not given:
        return None
    swapped = {"word": False, "byte": False}
    for key, word in given.items():
        column = key.replace("_", " ")
        if word in _NO:
            continue
        if key == "swap" and word in ("word", "words", "byte", "bytes", "both", "wordbyte", "byteword", "wordandbyte"):
            swapped["word"] |= "word" in word or word == "both"
            swapped["byte"] |= "byte" in word or word == "both"
        elif word in _YES and key != "swap":
            swapped[key.removesuffix("_swap")] = True
        else:
            raise ValueError(
                f"{column} {cells[key]!r} does not say what is swapped; call the column order, and give ABCD, CDAB, "
                "BADC or DCBA"
            )
    return {(False, False): "ABCD", (True, False): "CDAB", (False, True): "BADC", (True, True): "DCBA"}[
        swapped["word"], swapped["byte"]
    ]
