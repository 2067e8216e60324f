"""Columns of a register table: their meaning, the base of its addresses and the decimal sign of its numbers."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from drivers.importers.draft import ImportFileError
from drivers.importers.vendor_table.cells import device_number
from drivers.importers.vendor_table.headings import FACTORS, contents_that_matter, heading_key, is_harmless
from drivers.importers.vendor_table.range_cells import pair_in
from drivers.importers.vendor_table.scale import is_exponent_like
from drivers.importers.vendor_table.words import NO, YES, squeezed

_PREFIXED = re.compile(r"0x[0-9a-f]{1,5}|[0-9a-f]{1,5}h", re.I)
_BARE = re.compile(r"[0-9a-f]{1,5}", re.I)


_REMEDY = (
    "rename it scale (value = raw x scale, 1/10 for one decimal) or divisor (value = raw / divisor), or take it out"
)
_RENAME = {
    "numbers": (
        "call it scale, divisor, offset, raw min, raw max, unit id, function, bits, mask or length if it is one of "
        "these, and remark if no value and no address depends on it"
    ),
    "orders of bytes": "call it order",
    "signs of numbers": "call it signed",
    "tables": "call it table",
    FACTORS: "give the value of one count in a column scale, and call this one remark",
}
_IN_SEVERAL = ("doc", "function")
"""Keys that several columns may have: their cells are put together."""
_TAG = "tag"
"""Heading that names a point only where no other column does."""
_MOST_NAMES = 4
"""Names that a message lists before it says how many more there are."""
Rows = list[tuple[int, list[str]]]
"""First line and cells of each record."""


@dataclass(slots=True)
class VendorColumns:
    """Columns of a table by key; `inside` are the words in brackets behind their headings."""

    at: dict[str, int] = field(default_factory=dict)
    more: dict[str, list[int]] = field(default_factory=dict)
    """Further columns of the keys that may be in several."""
    called: dict[str, str] = field(default_factory=dict)
    inside: dict[str, str] = field(default_factory=dict)
    unused: list[str] = field(default_factory=list)
    is_exponent: bool = False
    is_value_of_a_count: bool = False
    """True where the heading says that the scale is the value of one count."""
    is_hex: bool = False
    decimal_comma: set[str] = field(default_factory=set)

    def cells(self, row: Sequence[str]) -> dict[str, str]:
        """Return the cells of a record by key."""
        found = {key: _cell(row, index) for key, index in self.at.items()}
        for key, more in self.more.items():
            found[key] = "; ".join(filter(None, [found[key], *(_cell(row, index) for index in more)]))
        return found


def _cell(row: Sequence[str], index: int) -> str:
    return row[index].strip() if index < len(row) else ""


def columns_of(path: Path, line: int, head: Sequence[str], rows: Rows) -> VendorColumns:
    """Return the columns of a table; raise ImportFileError for one that may change a value and is unclear."""
    found = VendorColumns()
    weak: list[tuple[str, int, str, list[str]]] = []
    unclear: list[str] = []
    for index, cell in enumerate(head):
        key, inside = heading_key(cell)
        called = " ".join(cell.split()) or f"number {index + 1} without a heading"
        values = [_cell(row, index) for _, row in rows]
        if key == "?":
            if any(value not in ("", "-") for value in values):
                unclear.append(f"column {called.lower()!r} has no agreed meaning; {_REMEDY}")
        elif key is None or (key == "range" and contents_that_matter(values) == FACTORS):
            matters = contents_that_matter(values)
            if is_harmless(cell) and matters != FACTORS:
                matters = None
            if matters is not None:
                unclear.append(f"column {called!r} is not known and holds {matters}; {_RENAME[matters]}")
            elif cell.strip() or any(values):
                found.unused.append(called)
        elif key in ("device_name", "place") or (key == "device" and not any(_has_digit(value) for value in values)):
            weak.append((key, index, called, values))
        else:
            _add(path, line, found, index, key, inside, called, values)
    lacking = [key for key in ("name", "address", "type") if key not in found.at]
    if len(lacking) == 3:
        raise ImportFileError(
            path, line, "has no columns for name, address and type: it is no register table; hil check reads records"
        )
    if lacking:
        key = lacking[0]
        raise ImportFileError(
            path, line, f"has no column for {key}; call one {key} (the first line must be the heading)"
        )
    if unclear:
        raise ImportFileError(path, line, unclear[0])
    _settle_devices(path, line, found, weak, rows)
    if not any(key.startswith("raw_") for key in found.at) and "range" in found.at:
        # Each line is checked by it: it may be a raw range, or give the values of its ends.
        gives_scale = any(pair_in(_cell(row, found.at["range"])) for _, row in rows)
        found.unused += [] if gives_scale else [found.called["range"]]
    return found


def _add(
    path: Path, line: int, found: VendorColumns, index: int, key: str, inside: str, called: str, values: Sequence[str]
) -> None:
    """Add a column of a known key."""
    if key in ("unit_per_count", "count_per_unit"):
        found.is_value_of_a_count |= key == "unit_per_count"
        key = "scale" if key == "unit_per_count" else "divisor"
    if key in found.at:
        if key in _IN_SEVERAL:
            found.more.setdefault(key, []).append(index)
            return
        if key == "address" and {inside, found.inside[key]} == {"hex", "dec"}:  # one address, written twice
            found.unused.append(found.called[key] if inside == "dec" else called)
            if inside != "dec":
                return
        elif key == "name" and _TAG in (squeezed(called), squeezed(found.called[key])) and called != found.called[key]:
            is_tag = squeezed(called) == _TAG
            found.unused.append(called if is_tag else found.called[key])
            if is_tag:
                return
        else:
            said = f"has two columns for {key}, {found.called[key]!r} and {called!r}; take out or rename one of them"
            raise ImportFileError(path, line, said)
    found.at[key], found.inside[key], found.called[key] = index, inside, called
    if key == "scale":
        is_factor = found.is_value_of_a_count or any(re.fullmatch(r"0[.,]\d+|1/\d+", value) for value in values)
        found.is_exponent = not is_factor and any(is_exponent_like(value) for value in values)
    elif key == "unit":
        numbers = [value for value in values if value]
        if set(numbers) - {"1"} and all(re.fullmatch(r"\d{1,3}", value) for value in numbers):
            said = f"column {called!r} holds numbers alone; call it unit id if they are devices, or give units"
            raise ImportFileError(path, line, said)


def _has_digit(text: str) -> bool:
    return any(letter.isdigit() for letter in text)


def _settle_devices(
    path: Path, line: int, found: VendorColumns, weak: Sequence[tuple[str, int, str, list[str]]], rows: Rows
) -> None:
    """Take a column of devices as unit ids if it holds numbers; refuse several names without a number each."""
    for key, index, called, values in weak:
        names = list(dict.fromkeys(filter(None, values)))
        if key == "device_name" and "device" not in found.at and names and None not in map(device_number, names):
            found.at["device"], found.inside["device"], found.called["device"] = index, "", called
            continue
        found.unused.append(called)
        if len(names) < 2:
            continue
        numbers = [_cell(row, found.at["device"]) for _, row in rows] if "device" in found.at else []
        if key != "place" and numbers and len(set(zip(numbers, values, strict=True))) == len(set(numbers)):
            continue  # the numbers part them
        listed = ", ".join(names[:_MOST_NAMES]) + (
            f" and {len(names) - _MOST_NAMES} more" if names[_MOST_NAMES:] else ""
        )
        if key == "place":
            said = (
                f"column {called!r} names several places ({listed}); import one file for each, with --host and --port"
            )
        elif numbers:
            said = f"column {called!r} names several devices of one number ({listed}); import one file for each"
        else:
            said = (
                f"column {called!r} names several devices ({listed}); add a column unit id, or import one file for each"
            )
        raise ImportFileError(path, line, said)


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
        if word in NO:
            continue
        if key == "swap" and word in ("word", "words", "byte", "bytes", "both", "wordbyte", "byteword", "wordandbyte"):
            swapped["word"] |= "word" in word or word == "both"
            swapped["byte"] |= "byte" in word or word == "both"
        elif word in YES and key != "swap":
            swapped[key.removesuffix("_swap")] = True
        else:
            raise ValueError(
                f"{column} {cells[key]!r} does not say what is swapped; call the column order, and give ABCD, CDAB, "
                "BADC or DCBA"
            )
    return {(False, False): "ABCD", (True, False): "CDAB", (False, True): "BADC", (True, True): "DCBA"}[
        swapped["word"], swapped["byte"]
    ]


_ADDRESSING = (
    ("zero", r"(?:zero|0) ?based|base (?:0|zero)|nullbasiert|ab 0|from 0|pdu|protocol|base zero"),
    ("one", r"(?:one|1) ?based|base (?:1|one)|einsbasiert|ab 1|from 1|base un"),
    ("modicon", r"modicon|[0134]x+|entity|[56] digits?"),
)


def addressing_of(inside: str) -> str | None:
    """Return the addressing that the words in brackets behind a heading state, `0-based` for one; None without any."""
    return next((name for name, words in _ADDRESSING if re.search(rf"\b(?:{words})\b", inside)), None)
