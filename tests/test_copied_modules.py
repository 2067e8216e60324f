"""Modules that stand in several top packages, because none of these may import another: their copies have one code."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[1]
LAZY_NAMES = [f"{package}/lazy_names.py" for package in ("hil", "drivers", "twin")]
BOUNDED_TOML = ["drivers/rig_file/text/bounded_toml.py", "twin/twinfile/bounded_toml.py"]
REGULAR_FILE = ["drivers/rig_file/text/regular_file.py", "twin/regular_file.py"]


def parts(path: str) -> dict[str, str]:
    """Return name and code, without docstrings, of each function and constant of a module."""
    found = {}
    for item in ast.parse((PROJECT / path).read_text(encoding="utf-8")).body:
        if isinstance(item, ast.FunctionDef):
            item.body = item.body[1:]
            found[item.name] = ast.unparse(item)
        elif isinstance(item, ast.Assign):
            found[ast.unparse(item.targets[0])] = ast.unparse(item)
    found.pop("__all__", None)
    return found


@pytest.mark.parametrize("copies", [LAZY_NAMES, REGULAR_FILE, BOUNDED_TOML], ids=["lazy_names", "regular_file", "toml"])
def test_what_copies_share_has_one_code(copies: list[str]) -> None:
    first, *others = [parts(path) for path in copies]
    for other in others:
        for name in first.keys() & other.keys():
            assert first[name] == other[name], name


def test_copies_are_whole() -> None:
    for copies in (LAZY_NAMES, BOUNDED_TOML):
        assert all(set(parts(path)) == set(parts(copies[0])) for path in copies)
    for path in REGULAR_FILE:  # the limits of sizes differ
        assert {"_KINDS", "read_regular", "refuse_irregular"} <= set(parts(path))
