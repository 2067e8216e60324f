"""Kinds of the variables and expressions of generated source, which its translators need and Python does not write.

A variable is an integer where all its values are, else a floating-point number. Truth values count as integers.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass

from twin.kernel.generated_code import MATH, GeneratedCodeError


@dataclass(frozen=True)
class Kind:
    """Kind of a value: 64-bit integer or floating-point number, and the number of axes of an array in C order."""

    whole: bool
    axes: int = 0


INT, FLOAT = Kind(True), Kind(False)


@dataclass(frozen=True)
class Signature:
    """Kinds of result and parameters of a function; `inline` is True for one that is copied to where it is called."""

    result: Kind | None
    parameters: tuple[Kind, ...]
    inline: bool


class ModuleKinds:
    """Kinds of the constants and functions of a checked module.

    Attributes
    ----------
    constants
        Name of a constant -> its value.
    functions
        Name of a function -> its signature.
    """

    def __init__(self, tree: ast.Module) -> None:
        self.constants: dict[str, int | float] = {}
        self.functions: dict[str, Signature] = {}
        for node in tree.body:
            if isinstance(node, ast.Assign):
                target, value = node.targets[0], node.value
                if not isinstance(target, ast.Name) or not isinstance(value, ast.Constant):
                    raise untranslatable(node)
                assert isinstance(value.value, int | float)
                self.constants[target.id] = value.value
            elif isinstance(node, ast.FunctionDef):
                self.functions[node.name] = _signature(node)


class FunctionKinds:
    """Kinds of the variables of one function.

    Attributes
    ----------
    names
        Name of a parameter or variable -> its kind.
    parameters
        The names among them that are parameters.
    """

    def __init__(self, module: ModuleKinds, node: ast.FunctionDef) -> None:
        self._module = module
        self.parameters = tuple(a.arg for a in node.args.args)
        self.names = dict(zip(self.parameters, module.functions[node.name].parameters, strict=True))
        assigned = list(_assigned(node))
        for name, value in assigned:
            self.names.setdefault(name, INT if value is None else self._begun(value))
        changed = True
        while changed:
            changed = False
            for name, value in assigned:
                if value is not None and self.names[name] == INT and self.of(value) == FLOAT:
                    self.names[name], changed = FLOAT, True

    def of(self, node: ast.expr) -> Kind:
        """Return the kind of an expression."""
        if isinstance(node, ast.Constant):
            return FLOAT if isinstance(node.value, float) else INT
        if isinstance(node, ast.Name):
            if node.id in self.names:
                return self.names[node.id]
            if node.id in self._module.constants:
                return FLOAT if isinstance(self._module.constants[node.id], float) else INT
        if isinstance(node, ast.BinOp):
            if isinstance(node.op, ast.Div | ast.Pow | ast.Mod):
                return FLOAT
            return self._wider(node.left, node.right)
        if isinstance(node, ast.UnaryOp):
            return INT if isinstance(node.op, ast.Not) else self.of(node.operand)
        if isinstance(node, ast.BoolOp | ast.Compare):
            return INT
        if isinstance(node, ast.IfExp):
            return self._wider(node.body, node.orelse)
        if isinstance(node, ast.Subscript):
            if isinstance(node.value, ast.Attribute):
                return INT  # a shape
            whole = self.of(node.value)
            return Kind(whole.whole, whole.axes - len(indices(node)))
        if isinstance(node, ast.Call):
            return self._call(node)
        raise untranslatable(node)

    def _call(self, node: ast.Call) -> Kind:
        if (sizes := allocation(node)) is not None:
            return Kind(False, len(sizes))
        if isinstance(node.func, ast.Name):
            name = node.func.id
            if name in self._module.functions:
                return self._module.functions[name].result or INT
            if name in ("min", "max"):
                return self._wider(*node.args)
            if name == "int":
                return INT
            if name == "abs":
                return self.of(node.args[0])
            if name in MATH:
                return FLOAT
        elif isinstance(node.func, ast.Attribute) and node.func.attr == "ceil":
            return FLOAT
        raise untranslatable(node)

    def _wider(self, *nodes: ast.expr) -> Kind:
        return INT if all(self.of(node) == INT for node in nodes) else FLOAT

    def _begun(self, value: ast.expr) -> Kind:
        """Return the kind of a variable's first value where it is an array, else that of an integer."""
        kind = INT
        whole = value.value if isinstance(value, ast.Subscript) else value
        if allocation(value) is not None or (isinstance(whole, ast.Name) and whole.id in self.names):
            kind = self.of(value)
        return kind if kind.axes else INT


def allocation(node: ast.expr) -> list[ast.expr] | None:
    """Return the sizes of an array that a call makes, or of another view of one; None for any other expression."""
    if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
        return None
    if node.func.attr == "reshape":
        return node.args
    if node.func.attr not in ("zeros", "empty"):
        return None
    shape = node.args[0]
    return shape.elts if isinstance(shape, ast.Tuple) else [shape]


def is_view(node: ast.expr) -> bool:
    """Return True for a call that makes another view of an array."""
    return isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "reshape"


def indices(node: ast.Subscript) -> list[ast.expr]:
    """Return the indices of an entry, one an axis."""
    return node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]


def untranslatable(node: ast.AST) -> GeneratedCodeError:
    """Return the error for a construct without translation."""
    line = getattr(node, "lineno", 0)
    return GeneratedCodeError(f"line {line} of the generated source has no translation; please report it")


def _assigned(node: ast.FunctionDef) -> Iterator[tuple[str, ast.expr | None]]:
    """Yield the names of variables with each value that they are given; None for those of a loop."""
    for part in ast.walk(node):
        if isinstance(part, ast.For) and isinstance(part.target, ast.Name):
            yield part.target.id, None
        elif isinstance(part, ast.Assign | ast.AugAssign):
            target = part.target if isinstance(part, ast.AugAssign) else part.targets[0]
            pairs = [(target, part.value)]
            if isinstance(target, ast.Tuple) and isinstance(part.value, ast.Tuple):
                pairs = list(zip(target.elts, part.value.elts, strict=True))
            for place, value in pairs:
                if isinstance(place, ast.Name):
                    yield place.id, value


def _signature(node: ast.FunctionDef) -> Signature:
    """Return the signature in the decorator `typed`; one that is `inlined` has floating-point numbers alone."""
    decorator = node.decorator_list[0]
    if not isinstance(decorator, ast.Call):
        return Signature(FLOAT, (FLOAT,) * len(node.args.args), True)
    result, _, rest = ast.literal_eval(decorator.args[0]).partition("(")
    parameters = [_kind(written) for written in rest[:-1].split(", ")]
    return Signature(None if result == "void" else _kind(result), tuple(parameters), False)


def _kind(written: str) -> Kind:
    return Kind(written.startswith("i8"), written.count(",") + 1 if "[" in written else 0)


__all__ = [
    "FLOAT",
    "INT",
    "FunctionKinds",
    "Kind",
    "ModuleKinds",
    "Signature",
    "allocation",
    "indices",
    "is_view",
    "untranslatable",
]
