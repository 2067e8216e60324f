"""Question about the unit of a column, among the messages of a reader."""

from __future__ import annotations

import re
from collections.abc import Iterable


class UnitQuestion(str):
    """Message that asks whether a column is in the unit of its name; results depend on its answer."""

    __slots__ = ()


def open_questions(columns: Iterable[str], messages: Iterable[str]) -> list[UnitQuestion]:
    """Return the questions among `messages` about the unit of one of `columns`."""
    names = re.compile("|".join(rf"\b{re.escape(column)}\b" for column in columns) or r"(?!)")
    return [said for said in messages if isinstance(said, UnitQuestion) and names.search(said)]
