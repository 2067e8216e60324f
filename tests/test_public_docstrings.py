"""Public functions: docstrings with errors, shapes and numpydoc sections, and few parameters."""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from collections.abc import Callable, Iterator
from importlib import import_module
from typing import Any

import pytest

from tests.test_public_names import DECLARED, public_names, syntax_trees

MOST_PARAMETERS = 8
"""Above that a function takes an object of options."""
MANY_PARAMETERS = 5
"""From that number on, the parameters are described in a section of their own."""
FORWARD = "forward"
"""Method of a torch module, which torch calls with the tensors of a batch."""
SHAPE = re.compile(r"\((?:\w+(?: [+-] \d+)?, ?)*\w*,?\)|\bshape\b")
OTHER_SECTIONS = re.compile(r"(?m)^(?:Args|Arguments|Parameters|Returns|Raises|Attributes):$")


def _functions(package: str) -> Iterator[tuple[str, Callable[..., Any], ast.FunctionDef | ast.AsyncFunctionDef]]:
    """Yield name, function and syntax tree of the public functions of a package."""
    loaded = import_module(package)
    for name in sorted(public_names(package)):
        try:
            found = inspect.unwrap(getattr(loaded, name))
        except ImportError:  # the tool of a peer that is not installed
            continue
        if inspect.isfunction(found) and found.__module__.partition(".")[0] in ("hil", "drivers", "twin"):
            node = ast.parse(textwrap.dedent(inspect.getsource(found))).body[0]
            assert isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
            yield name, found, node


def _raised(node: ast.AST) -> set[str]:
    """Return the classes of errors that the body of a function raises itself."""
    calls = [r.exc for r in ast.walk(node) if isinstance(r, ast.Raise) and isinstance(r.exc, ast.Call)]
    names = {ast.unparse(call.func).rpartition(".")[2] for call in calls}
    return {name for name in names if name[0].isupper()}


def _lacks(node: ast.FunctionDef | ast.AsyncFunctionDef, text: str) -> Iterator[str]:
    """Yield what the docstring of a function lacks."""
    if not text:
        yield "a docstring"
    yield from (f"the error {name}" for name in sorted(_raised(node)) if name not in text)
    arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    annotations = [a.annotation for a in arguments if a.annotation] + ([node.returns] if node.returns else [])
    if any(re.fullmatch(r"Array|NDArray.*|np\.ndarray", ast.unparse(a)) for a in annotations) and not SHAPE.search(
        text
    ):
        yield "the shape of an array, such as (n,)"
    if len([a for a in arguments if a.arg != "self"]) >= MANY_PARAMETERS and "Parameters\n----" not in text:
        yield "a section of its parameters"
    if OTHER_SECTIONS.search(text):
        yield "sections in numpydoc form"


@pytest.mark.parametrize("package", DECLARED)
def test_public_functions_state_errors_and_shapes(package: str) -> None:
    lacking = [
        f"{package}.{name}: {lack}"
        for name, function, node in _functions(package)
        for lack in _lacks(node, inspect.getdoc(function) or "")
    ]
    assert not lacking


def _is_called_by_a_framework(node: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Return True for a command of click, whose parameters are options, a kernel of numba, and a torch module."""
    decorators = " ".join(ast.unparse(each) for each in node.decorator_list)
    return node.name == FORWARD or re.search(r"\bcommand\b|\bnjit\b|\bcompiled_kernel\b", decorators) is not None


def test_functions_have_few_parameters() -> None:
    long = []
    for name, tree in syntax_trees().items():
        for node in ast.walk(tree):
            if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) or _is_called_by_a_framework(node):
                continue
            arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
            if len([a for a in arguments if a.arg not in ("self", "cls")]) > MOST_PARAMETERS:
                long.append(f"{name}.{node.name}")
    assert not long
