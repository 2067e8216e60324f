"""Question about the unit of a column, among the messages of a reader."""

from __future__ import annotations


class UnitQuestion(str):
    """Message that asks whether a column is in the unit of its name; results depend on its answer."""

    __slots__ = ()
