"""Shapes of JSON documents: what a reader uses of them, checked once, so that no later code has to expect anything
else."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

OPTIONAL = "?"
"""End of a key that may be missing."""
_WORDS = {float: "a number", int: "a whole number", str: "a text", bool: "true or false", dict: "an object"}

Shape = Any
"""`float`, `int`, `str`, `bool`; `(low, high)` for a number within a range; `[shape]` for a list; `{key: shape}` for an
object, which may have further keys; a frozenset of texts of which it is one."""


def misfit(value: object, shape: Shape, place: str = "") -> str:
    """Return what of a document does not fit its shape, such as "design.pressure_kPa is 'x', which is no number".

    Parameters
    ----------
    value
        Document, or a part of it.
    shape
        Its shape.
    place
        Path of the part within the document.

    Returns
    -------
    str
        The first misfit, "" for none.
    """
    return next(misfits(value, shape, place), "")


def misfits(value: object, shape: Shape, place: str = "") -> Iterator[str]:
    """Yield all of a document that does not fit its shape; parameters as of `misfit`."""
    if isinstance(shape, Mapping):
        yield from _of_object(value, shape, place)
    elif isinstance(shape, list):
        if not isinstance(value, list):
            yield _no(place, value, "a list")
            return
        for k, one in enumerate(value):
            yield from misfits(one, shape[0], f"{place}[{k}]")
    elif isinstance(shape, frozenset):
        if not (isinstance(value, str) and value in shape):
            yield _no(place, value, f"one of {', '.join(sorted(shape))}")
    elif isinstance(shape, tuple):
        low, high = shape
        if fault := misfit(value, float, place):
            yield fault
        elif not low <= float(value) <= high:  # type: ignore[arg-type]
            yield f"{place} is {value:g}, outside {low:g} to {high:g}"
    elif not _is(value, shape):
        yield _no(place, value, _WORDS[shape])


def _of_object(value: object, shape: Mapping[str, Shape], place: str) -> Iterator[str]:
    if not isinstance(value, dict):
        yield _no(place, value, _WORDS[dict])
        return
    for key, inner in shape.items():
        name = key.removesuffix(OPTIONAL)
        at = f"{place}.{name}" if place else name
        if name in value:
            yield from misfits(value[name], inner, at)
        elif name == key:
            yield f"{at} is missing"


def _is(value: object, kind: type) -> bool:
    if isinstance(value, bool) or kind is bool:
        return isinstance(value, bool) and kind is bool
    if kind is float:
        return isinstance(value, (int, float)) and abs(value) < 1e300 and math.isfinite(value)
    if isinstance(value, str):  # half a character, which JSON can escape, is no text that a file can hold
        return kind is str and not any("\ud800" <= one <= "\udfff" for one in value)
    return isinstance(value, kind)


def _no(place: str, value: object, wanted: str) -> str:
    shown = repr(value)
    shown = shown if len(shown) <= 40 else f"{shown[:40]}..."
    return f"{place or 'it'} is {shown}, which is not {wanted}"
