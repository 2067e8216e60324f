"""Texts of Python modules that users read: docstrings of public objects, messages and help."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass

FEWEST_WORDS = 3
"""Strings with fewer words are keys and names, not messages."""


@dataclass(frozen=True)
class Text:
    """A text, its line, and True for the docstring of a public object."""

    line: int
    text: str
    is_docstring: bool


def texts(source: str) -> Iterator[Text]:
    """Yield the docstrings of public objects, then all other strings that are prose."""
    tree = ast.parse(source)
    known = {id(node) for node, _ in _docstrings(tree, public=True)}
    for node, public in _docstrings(tree, public=True):
        if public:
            yield Text(node.lineno, str(node.value), is_docstring=True)
    for each in ast.walk(tree):
        if not isinstance(each, ast.Constant) or not isinstance(each.value, str) or id(each) in known:
            continue
        if len(each.value.split()) >= FEWEST_WORDS:
            yield Text(each.lineno, each.value, is_docstring=False)


def _docstrings(parent: ast.AST, public: bool) -> Iterator[tuple[ast.Constant, bool]]:
    """Yield the docstrings below `parent` with True for those of public objects; also those of attributes."""
    body: list[ast.stmt] = getattr(parent, "body", [])
    for place, statement in enumerate(body):
        value = statement.value if isinstance(statement, ast.Expr) else None
        if isinstance(value, ast.Constant) and isinstance(value.value, str):
            yield value, public and _named_publicly(body[place - 1] if place else None)
        if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield from _docstrings(statement, public and not statement.name.startswith("_"))


def _named_publicly(before: ast.stmt | None) -> bool:
    """Return False for the docstring of a private attribute, the statement before it."""
    targets: list[ast.expr] = []
    if isinstance(before, ast.Assign):
        targets = before.targets
    elif isinstance(before, ast.AnnAssign):
        targets = [before.target]
    return not any(isinstance(target, ast.Name) and target.id.startswith("_") for target in targets)
