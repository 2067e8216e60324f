"""Check of generated source as a syntax tree before it is compiled, and its execution without builtins.

The generators write arithmetic and loops in identifiers of their own; names from files never enter (see
`twin.elements.symbols`). This module does not rely on that. It admits only the syntax that the generators need. Any
import, attribute, string or call beyond that is refused, and the rest can reach nothing but arrays and arithmetic.
"""

from __future__ import annotations

import ast
import functools
import math
import re
from collections.abc import Callable, Iterable, Mapping
from types import CodeType
from typing import Any

from twin.network.affine import PARSER_LOCK

MATH: Mapping[str, Callable[..., Any]] = {"exp": math.exp, "log": math.log}
"""Functions of plain numbers that formulas call."""
BUILTINS: Mapping[str, Any] = {"abs": abs, "int": int, "max": max, "min": min, "range": range}
"""The Python builtins that generated code may use."""
KERNEL_NAMES = ("np", "typed", "inlined", *MATH)
"""Names that a kernel may use beside those: arrays, functions of numbers, and the decorators of its functions.

``@typed('i8(f8[:,::1], f8)')`` gives the types of result and arguments: ``i8`` and ``f8``, arrays in C order, ``void``.
``@inlined`` marks a function of floating-point numbers that is copied to where it is called.
"""
_ARRAY_FUNCTIONS = frozenset(("zeros", "empty", "ceil"))
_TYPES = re.compile(r"(void|[fi]8)\(([fi]8(\[(:,)*::1\])?(, (?!\))|(?=\))))*\)")
_IDENTIFIER = re.compile(r"(?!__)[A-Za-z_][A-Za-z0-9_]*")
_SYNTAX: tuple[type[ast.AST], ...] = (
    *(ast.Module, ast.FunctionDef, ast.arguments, ast.arg, ast.Return, ast.Expr, ast.Assign, ast.AugAssign, ast.For),
    *(ast.While, ast.If, ast.Break, ast.BinOp, ast.UnaryOp, ast.BoolOp, ast.Compare, ast.IfExp, ast.Call, ast.keyword),
    *(ast.Subscript, ast.Slice, ast.Tuple, ast.List, ast.Attribute, ast.Name, ast.Constant, ast.Load, ast.Store),
    *(ast.operator, ast.unaryop, ast.boolop, ast.cmpop),
)

_PLAIN = frozenset(
    (ast.BinOp, ast.Add, ast.Sub, ast.Mult, ast.Div, ast.USub, ast.Pow, ast.Load, ast.Store, ast.Assign, ast.Subscript)
)
"""Nodes of that syntax of which nothing more is asked, and of which most of a source consists."""


class GeneratedCodeError(RuntimeError):
    """Generated source with a construct that no formula needs: a defect of a generator, or an attack."""


def check_source(source: str, given: Iterable[str]) -> ast.Module:
    """Return the syntax tree of generated source that holds nothing but arithmetic on arrays.

    Parameters
    ----------
    source
        A module of functions.
    given
        Names that it may use beside its own and `BUILTINS`.

    Raises
    ------
    GeneratedCodeError
        The source holds anything else.
    """
    try:
        with PARSER_LOCK:
            tree = ast.parse(source)
    except (SyntaxError, ValueError, RecursionError) as error:
        raise GeneratedCodeError(f"the generated source is no Python ({error}); please report it") from None
    _Check(tree, frozenset((*given, *BUILTINS)))
    return tree


def compile_tree(tree: ast.Module, file: str) -> CodeType:
    """Compile a checked tree; `file` stands in tracebacks."""
    with PARSER_LOCK:
        compiled: CodeType = compile(tree, file, "exec", dont_inherit=True)
    return compiled


def define_functions(source: str, file: str, given: Mapping[str, Any] = MATH) -> dict[str, Any]:
    """Run generated source and return the functions that it defines.

    Parameters
    ----------
    source
        A module of functions.
    file
        Name of the source in tracebacks.
    given
        Functions that the source calls; they replace builtins of the same name.

    Raises
    ------
    GeneratedCodeError
        See `check_source`.
    """
    scope: dict[str, Any] = {"__builtins__": dict(BUILTINS), **given}
    exec(_checked_code(source, file, frozenset(given)), scope)
    return scope


@functools.lru_cache(maxsize=256)
def _checked_code(source: str, file: str, given: frozenset[str]) -> CodeType:
    """Check and compile; a search of effects asks for the same few dozen texts again and again, and the check of one
    takes longer than its formulas on a whole record."""
    return compile_tree(check_source(source, given), file)


def evaluate_formula(formula: str, names: Mapping[str, float]) -> float:
    """Evaluate one formula with numbers for its names.

    Raises
    ------
    GeneratedCodeError
        See `check_source`.
    """
    arguments = ", ".join(names)
    scope = define_functions(f"def formula({arguments}):\n    return {formula}\n", "<formula>")
    return float(scope["formula"](**names))


def _nodes_of(tree: ast.AST) -> list[ast.AST]:
    """Return all nodes of a tree, a node before its parts, as `ast.walk` does, which asks more of each."""
    found = [tree]
    for node in found:
        for name in node._fields:
            value = getattr(node, name, None)
            if isinstance(value, ast.AST):
                found.append(value)
            elif isinstance(value, list):
                found += [part for part in value if isinstance(part, ast.AST)]
    return found


class _Check:
    """A walk over a syntax tree in which every kind of node, name, call and constant must be known."""

    def __init__(self, tree: ast.Module, given: frozenset[str]) -> None:
        nodes = _nodes_of(tree)
        defined = {n.name for n in nodes if isinstance(n, ast.FunctionDef)}
        self.known = given | defined | {n.arg for n in nodes if isinstance(n, ast.arg)}
        self.known |= {n.id for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
        self.callable = given | defined
        self.options: set[int] = set()
        """Types in decorators, and texts that are docstrings: strings are allowed there alone."""
        self.called: set[int] = set()
        for node in nodes:
            if isinstance(node, ast.FunctionDef):
                self.function(node)
            elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
                self.options.add(id(node.value))
        for node in nodes:
            self.node(node)

    def refuse(self, node: ast.AST, construct: str) -> None:
        """Raise GeneratedCodeError for a node."""
        line = getattr(node, "lineno", 0)
        raise GeneratedCodeError(f"line {line} of the generated source has {construct}, which no formula needs")

    def function(self, node: ast.FunctionDef) -> None:
        """Check arguments and decorators of a function."""
        a = node.args
        if a.vararg or a.kwarg or a.defaults or a.kw_defaults or a.kwonlyargs or a.posonlyargs or node.returns:
            self.refuse(node, "a function with other than plain arguments")
        for decorator in node.decorator_list:
            if isinstance(decorator, ast.Name) and decorator.id == "inlined":
                continue
            types = decorator.args[0] if isinstance(decorator, ast.Call) and len(decorator.args) == 1 else None
            if not (isinstance(types, ast.Constant) and isinstance(types.value, str) and _TYPES.fullmatch(types.value)):
                self.refuse(node, "a decorator")
            assert isinstance(decorator, ast.Call)
            if not isinstance(decorator.func, ast.Name) or decorator.func.id != "typed":
                self.refuse(node, "a decorator")
            self.options.add(id(types))

    def node(self, node: ast.AST) -> None:
        """Check one node of any kind."""
        if type(node) in _PLAIN:
            return
        if not isinstance(node, _SYNTAX):
            self.refuse(node, f"the syntax {type(node).__name__}")
        if isinstance(node, ast.Name | ast.arg | ast.FunctionDef):
            name = node.id if isinstance(node, ast.Name) else node.arg if isinstance(node, ast.arg) else node.name
            if not _IDENTIFIER.fullmatch(name) or name not in self.known:
                self.refuse(node, f"the name {name!r}")
        elif isinstance(node, ast.Constant):
            fine = isinstance(node.value, int | float) or (isinstance(node.value, str) and id(node) in self.options)
            if not fine:
                self.refuse(node, f"the constant {node.value!r}")
        elif isinstance(node, ast.Call) and id(node) not in self.options:
            self.call(node)
        elif isinstance(node, ast.Attribute) and id(node) not in self.options | self.called:
            fine = node.attr == "shape" and isinstance(node.value, ast.Name) and isinstance(node.ctx, ast.Load)
            if not fine:
                self.refuse(node, f"the attribute {node.attr!r}")

    def call(self, node: ast.Call) -> None:
        """Check the target of a call."""
        target = node.func
        if node.keywords:
            self.refuse(node, "a call with keywords")
        if isinstance(target, ast.Name):
            fine = target.id in self.callable
        elif isinstance(target, ast.Attribute) and isinstance(target.value, ast.Name):
            fine = target.attr == "reshape" or (target.value.id == "np" and target.attr in _ARRAY_FUNCTIONS)
            self.called.add(id(target))  # the walk comes to a call before its parts
        else:
            fine = False
        if not fine:
            self.refuse(node, f"the call of {ast.unparse(target)}")


__all__ = [
    "BUILTINS",
    "MATH",
    "GeneratedCodeError",
    "check_source",
    "compile_tree",
    "define_functions",
    "evaluate_formula",
]
