"""JSON text of others: every text that cannot be used is a ValueError, however deep it is."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from hil.diagnosis.columns import datasheet_clock
from hil.files import parse_json
from hil.files.json_text import MOST_DEPTH
from hil.record.file import _range
from tests.docs.fences import PROJECT

OWN = ("bench", "training", "guardian", "journal")
"""Packages that read no JSON of others; the journal's readers report damage by `reports_damage`."""


@pytest.mark.parametrize("depth", [MOST_DEPTH + 1, 900, 100_000])
@pytest.mark.parametrize("brackets", ["[]", '{"a": }'])
def test_a_text_that_is_nested_too_deeply_is_a_value_error(depth: int, brackets: str) -> None:
    opening, closing = brackets[:-1], brackets[-1]
    with pytest.raises(ValueError, match="nested too deeply"):
        parse_json(opening * depth + "1" + closing * depth)


def test_a_document_as_deep_as_allowed_comes_back() -> None:
    assert parse_json("[" * MOST_DEPTH + "]" * MOST_DEPTH) != []
    assert parse_json(b'{"a": [1, {"b": null}]}') == {"a": [1, {"b": None}]}


def test_a_deep_range_of_a_column_and_a_deep_datasheet_declare_nothing(tmp_path: Path) -> None:
    deep = "[" * 100_000
    (tmp_path / "datasheet.json").write_text(deep, encoding="utf-8")
    assert datasheet_clock(tmp_path / "record.csv") is None
    assert _range(deep) is None and _range(f"[0, {10**400}]") is None and _range("[0, 60]") == (0.0, 60.0)


def test_json_of_others_is_read_by_the_helper_alone() -> None:
    found = [
        str(path.relative_to(PROJECT))
        for path in (PROJECT / "hil").rglob("*.py")
        if path.relative_to(PROJECT / "hil").parts[0] not in OWN and path.name != "json_text.py"
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute) and node.attr in ("load", "loads") and ast.unparse(node.value) == "json"
    ]
    assert found == []
