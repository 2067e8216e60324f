"""Data types and byte orders of Telegraf's Modbus input, as keys of a rig file's point. Pure."""

from __future__ import annotations

from typing import Any

from drivers.signals import WIDTH

_INTEGERS = {kind.upper(): kind for kind in ("int16", "uint16", "int32", "uint32", "int64", "uint64")}
_BYTES = {"UINT8L": [0, 7], "UINT8H": [8, 15]}
_FIXED = {"FIXED": "int", "UFIXED": "uint", "FLOAT32": "uint"}
"""Of the register style: whole numbers of as many registers as there are addresses."""
_IEEE = {"FLOAT32-IEEE": "float32", "FLOAT64-IEEE": "float64"}
_REGISTER_WORDS = (*_INTEGERS, *_FIXED, *_IEEE, *_BYTES, "BIT", "STRING")
_FIELD_WORDS = (*_INTEGERS, "FLOAT32", "FLOAT64", *_BYTES, "BIT", "STRING")
_ORDERS = {
    "AB": "ABCD",
    "ABCD": "ABCD",
    "ABCDEFGH": "ABCD",
    "MSW": "ABCD",
    "MSW-BE": "ABCD",
    "CDAB": "CDAB",
    "GHEFCDAB": "CDAB",
    "LSW-BE": "CDAB",
    "BADC": "BADC",
    "BADCFEHG": "BADC",
    "MSW-LE": "BADC",
    "BA": "DCBA",
    "DCBA": "DCBA",
    "HGFEDCBA": "DCBA",
    "LSW": "DCBA",
    "LSW-LE": "DCBA",
}


def register_type(word: str, count: int) -> tuple[dict[str, Any], str]:
    """Return keys of a point and a remark for `data_type` of the register style, with `count` addresses.

    Without keys the remark is why there are none.
    """
    if word in _FIXED:
        if count not in (1, 2, 4):
            return {}, f"{word} takes 1, 2 or 4 addresses, and has {count}; correct one"
        remark = "FLOAT32 of the register style is a whole number without sign (UFIXED)" if word == "FLOAT32" else ""
        return {"type": f"{_FIXED[word]}{16 * count}"}, remark
    keys, remark = _simple(word)
    if word in _IEEE:
        keys = {"type": _IEEE[word]}
    if not keys:
        return {}, remark or f"type {word!r} has no counterpart here; use one of {', '.join(_REGISTER_WORDS)}"
    kind = keys["type"]
    if kind != "string" and count != WIDTH[kind]:
        return {}, f"is {word}, which takes {WIDTH[kind]} addresses, and has {count}; correct one"
    return keys, ""


def field_type(word: str) -> tuple[dict[str, Any], str]:
    """Return keys of a point and a remark for `type` of the request and metric styles."""
    keys, remark = _simple(word)
    if word in ("FLOAT32", "FLOAT64"):
        keys = {"type": word.lower()}
    if not keys:
        return {}, remark or f"type {word!r} has no counterpart here; use one of {', '.join(_FIELD_WORDS)}"
    return keys, ""


def _simple(word: str) -> tuple[dict[str, Any], str]:
    if word in _INTEGERS:
        return {"type": _INTEGERS[word]}, ""
    if word == "STRING":
        return {"type": "string"}, ""
    if word == "BIT":
        return {"type": "uint16", "bits": [0, 0], "kind": "status"}, ""
    if word in _BYTES:
        return {"type": "uint16", "bits": _BYTES[word]}, ""
    if word in ("INT8L", "INT8H", "FLOAT16", "FLOAT16-IEEE"):
        return {}, f"type {word} cannot be read here; read the register as UINT16, and convert it afterwards"
    return {}, ""


def byte_order(word: str, kind: str, numbers: list[int] | None) -> tuple[str | None, str]:
    """Return the rig file's byte order, or None and the mistake; `numbers` are the addresses in the register style."""
    width = WIDTH.get(kind, 1)
    if not word and (width == 1 or numbers is None):
        return "ABCD", ""
    order = _ORDERS.get(word)
    if order is None:
        said = f"byte_order {word!r} is not known" if word else "a value of several registers has no byte_order"
        return None, f"{said}; use ABCD or CDAB"
    if kind == "string":
        return "BADC" if order in ("BADC", "DCBA") else "ABCD", ""
    if numbers is not None and len(word) != 2 * len(numbers):
        return None, f"byte_order {word} names {len(word)} bytes and the addresses hold {2 * len(numbers)}; correct one"
    if width == 1:
        return "BADC" if order in ("BADC", "DCBA") else "ABCD", ""
    return order, ""
