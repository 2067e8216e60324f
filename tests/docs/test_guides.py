"""Names of the code that guides state in prose, against the code."""

from __future__ import annotations

import re

from tests.docs.fences import PROJECT
from twin.elements.base import Element

GUIDE = PROJECT / "docs" / "how-to" / "add-an-element.md"
TABLE_OTHERS = {"parameters", "kind", "linear"}
"""Class attributes of an element that the table of hooks names beside its methods."""


def test_hooks_of_an_element_exist() -> None:
    text = GUIDE.read_text(encoding="utf-8")
    table = [line.split("|")[1] for line in text.splitlines() if line.startswith("| `")]
    named = {name for cell in table for name in re.findall(r"`(\w+)(?: = \w+)?`", cell)}
    section = text.partition("## Let the diagnosis find it")[2]
    named |= {name for name in re.findall(r"`(\w+)`", section) if name != "Candidate"}
    assert TABLE_OTHERS | {"emit", "problem", "missing_candidates", "changed_candidates"} <= named
    assert sorted(name for name in named if not hasattr(Element, name) and name not in Element.__annotations__) == []
