"""Kernel of a network as C99, translated statement by statement from its generated source, for targets without Python.

The generated source of a kernel (`twin.kernel.codegen`) is a small language: arithmetic, loops, arrays of doubles. So
the C code has the same substeps in the same order, and its results differ from those of the kernel by rounding alone.
Division is always that of floating-point numbers.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twin.kernel.codegen import kernel_source
from twin.kernel.generated_code import KERNEL_NAMES, MATH, check_source
from twin.kernel.state_layout import StateLayout
from twin.kernel.typed_source import (
    FLOAT,
    INT,
    FunctionKinds,
    Kind,
    ModuleKinds,
    allocation,
    indices,
    is_view,
    untranslatable,
)
from twin.network import Network
from twin.network.assembly import NetworkEquations

_OPERATORS: Mapping[type[ast.AST], str] = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
    ast.FloorDiv: "/",
    ast.BitAnd: "&",
    ast.Lt: "<",
    ast.LtE: "<=",
    ast.Gt: ">",
    ast.GtE: ">=",
    ast.Eq: "==",
    ast.NotEq: "!=",
    ast.And: "&&",
    ast.Or: "||",
}
PREFIX = "k_"
"""Put before the names of functions, some of which are those of the C library."""
ENTRY = "piece"
"""Function of the generated source that simulates one piece of a record."""
_HEAD = """
typedef struct { double *at; long n[4]; } array;
static double k_least(double a, double b) { return b < a ? b : a; }
static double k_most(double a, double b) { return b > a ? b : a; }
static double k_modulo(double a, double b) {
    double r = fmod(a, b);
    return r != 0.0 && (r < 0.0) != (b < 0.0) ? r + b : r;
}
static long k_least_int(long a, long b) { return b < a ? b : a; }
static long k_most_int(long a, long b) { return b > a ? b : a; }
"""


@dataclass(frozen=True)
class CSource:
    """C99 code of the kernel of one network for one particle, and the sizes of its arrays.

    `text` needs `math.h`. It defines the type `array` and the static function ``k_piece(base, lanes, start, past,
    first, n, time, inputs, Y, end, future)``, with the arguments of the generated kernel. `width` is the length of
    `start` and `end`, node temperatures first; NaN in the rest of `start` begins at rest. `rows` is the length of
    `past` and `future`. `looks_back` is True if a dead time needs the inputs of earlier samples.
    """

    text: str
    width: int
    rows: int
    looks_back: bool


def c_source(network: Network) -> CSource:
    """Return the kernel of a network as C99; all parameters are read from the vector `base` of a call.

    Raises
    ------
    GeneratedCodeError
        The generated source holds a construct that has no translation: a defect of a generator.
    """
    tree = check_source(kernel_source(network, "trace", (), lanes=1), KERNEL_NAMES)
    system, layout = NetworkEquations(network, ()), StateLayout(network, ())
    width = layout.split(np.zeros((1, layout.nodes)))[0].shape[1]
    return CSource(
        _module(tree),
        width,
        layout.rows,
        any(drive.dead_time for _, drive in system.drives),
    )


def _module(tree: ast.Module) -> str:
    """Return the C code of a module: its constants, and its functions up to the one that simulates a piece."""
    module = ModuleKinds(tree)
    out = [_HEAD.strip()]
    for name, value in module.constants.items():
        out.append(f"#define {name} {value!r}{'L' if isinstance(value, int) else ''}")
    for node in tree.body:
        if isinstance(node, ast.FunctionDef):
            out += _Function(module, node).lines()
            if node.name == ENTRY:  # the rest joins pieces, which a caller in C does by itself
                break
    return "\n".join(out) + "\n"


def _c_type(kind: Kind) -> str:
    return "array" if kind.axes else "long" if kind.whole else "double"


class _Function:
    """Translation of one function."""

    def __init__(self, module: ModuleKinds, node: ast.FunctionDef) -> None:
        self.module, self.node = module, node
        self.kinds = FunctionKinds(module, node)
        self._temporaries = 0

    def lines(self) -> list[str]:
        """Return the lines of the C function."""
        names, parameters = self.kinds.names, self.kinds.parameters
        arguments = ", ".join(f"{_c_type(names[name])} {name}" for name in parameters)
        body = self._block(self.node.body)
        returned = self.module.functions[self.node.name].result
        result = _c_type(returned) if returned else "void"
        head = [f"static {result} {PREFIX}{self.node.name}({arguments}) {{"]
        own = {name: kind for name, kind in names.items() if name not in parameters and not kind.axes}
        head += [f"    {_c_type(kind)} {name} = 0;" for name, kind in own.items()]
        return [*head, *body, "}", ""]

    def _block(self, body: list[ast.stmt]) -> list[str]:
        return [f"    {line}" for statement in body for line in self._statement(statement)]

    def _statement(self, node: ast.stmt) -> list[str]:
        if isinstance(node, ast.Expr):
            return [] if isinstance(node.value, ast.Constant) else [f"{self._text(node.value)};"]
        if isinstance(node, ast.Assign):
            return self._assign(node.targets[0], node.value)
        if isinstance(node, ast.AugAssign):
            return [f"{self._text(node.target)} {_operator(node.op)}= {self._text(node.value)};"]
        if isinstance(node, ast.If):
            lines = [f"if ({self._text(node.test)}) {{", *self._block(node.body)]
            return [*lines, "} else {", *self._block(node.orelse), "}"] if node.orelse else [*lines, "}"]
        if isinstance(node, ast.While):
            return [f"while ({self._text(node.test)}) {{", *self._block(node.body), "}"]
        if isinstance(node, ast.For):
            return self._loop(node)
        if isinstance(node, ast.Break):
            return ["break;"]
        if isinstance(node, ast.Return) and node.value is not None:
            return [f"return {self._text(node.value)};"]
        raise untranslatable(node)

    def _loop(self, node: ast.For) -> list[str]:
        call = node.iter
        if not (isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "range"):
            raise untranslatable(node)
        ends = [self._text(argument) for argument in call.args]
        begin, end = ("0", ends[0]) if len(ends) == 1 else (ends[0], ends[1])
        name = self._text(node.target)
        return [f"for ({name} = {begin}; {name} < {end}; {name}++) {{", *self._block(node.body), "}"]

    def _assign(self, target: ast.expr, value: ast.expr) -> list[str]:
        if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
            lines, names = [], []
            for each in value.elts:
                names.append(f"t_{self._temporaries}")
                self._temporaries += 1
                lines.append(f"{_c_type(self.kinds.of(each))} {names[-1]} = {self._text(each)};")
            put = [f"{self._text(place)} = {name};" for place, name in zip(target.elts, names, strict=True)]
            return ["{", *(f"    {line}" for line in (*lines, *put)), "}"]
        if isinstance(target, ast.Name) and (shape := allocation(value)) is not None:
            assert isinstance(value, ast.Call)
            return self._allocate(target.id, value, shape)
        return [f"{self._text(target)} = {self._text(value)};"]

    def _allocate(self, name: str, call: ast.Call, shape: Sequence[ast.expr]) -> list[str]:
        """Return the lines of a local array, or of another view of one, with sizes that are plain numbers."""
        if is_view(call):  # of one particle: (-1, 1)
            assert isinstance(call.func, ast.Attribute) and isinstance(call.func.value, ast.Name)
            whole = call.func.value.id
            return [f"array {name} = {{ {whole}.at, {{ {whole}.n[0], 1 }} }};"]
        sizes = [self._text(size) for size in shape]
        if not all(size.isdigit() for size in sizes):
            raise untranslatable(call)
        total = " * ".join(sizes)
        return [f"double {name}_of[{total}] = {{ 0.0 }};", f"array {name} = {{ {name}_of, {{ {', '.join(sizes)} }} }};"]

    def _text(self, node: ast.expr) -> str:
        """Return an expression as C."""
        if isinstance(node, ast.Constant) and isinstance(node.value, bool | int | float):
            return f"{int(node.value)}" if isinstance(node.value, bool | int) else repr(node.value)
        if isinstance(node, ast.Name):
            return node.id
        if isinstance(node, ast.BinOp):
            return self._binary(node)
        if isinstance(node, ast.UnaryOp):
            sign = {ast.USub: "-", ast.UAdd: "+", ast.Not: "!"}[type(node.op)]
            return f"({sign}{self._text(node.operand)})"
        if isinstance(node, ast.BoolOp):
            return f"({f' {_operator(node.op)} '.join(self._text(value) for value in node.values)})"
        if isinstance(node, ast.Compare) and len(node.ops) == 1:
            return f"({self._text(node.left)} {_operator(node.ops[0])} {self._text(node.comparators[0])})"
        if isinstance(node, ast.IfExp):
            return f"({self._text(node.test)} ? {self._text(node.body)} : {self._text(node.orelse)})"
        if isinstance(node, ast.Subscript):
            return self._subscript(node)
        if isinstance(node, ast.Call):
            return self._call(node)
        raise untranslatable(node)

    def _binary(self, node: ast.BinOp) -> str:
        left, right = self._text(node.left), self._text(node.right)
        if isinstance(node.op, ast.Pow):
            return f"pow({left}, {right})"
        if isinstance(node.op, ast.Mod):  # its sign is that of the divisor, as in Python
            return f"{PREFIX}modulo({left}, {right})"
        whole = self.kinds.of(node.left) == self.kinds.of(node.right) == INT
        if isinstance(node.op, ast.Div) and whole:
            return f"((double){left} / {right})"
        if isinstance(node.op, ast.FloorDiv | ast.BitAnd) and not whole:
            raise untranslatable(node)
        return f"({left} {_operator(node.op)} {right})"

    def _subscript(self, node: ast.Subscript) -> str:
        """Return an entry of an array in C order, or of its shape."""
        if isinstance(node.value, ast.Attribute) and isinstance(node.value.value, ast.Name):
            return f"{node.value.value.id}.n[{self._text(node.slice)}]"
        if not isinstance(node.value, ast.Name) or self.kinds.of(node) != FLOAT:
            raise untranslatable(node)
        name = node.value.id
        first, *others = (self._text(index) for index in indices(node))
        place = first
        for axis, index in enumerate(others, start=1):
            place = f"({place}) * {name}.n[{axis}] + {index}"
        return f"{name}.at[{place}]"

    def _call(self, node: ast.Call) -> str:
        texts = [self._text(argument) for argument in node.args]
        if isinstance(node.func, ast.Attribute) and node.func.attr == "ceil":
            return f"ceil({texts[0]})"
        name = node.func.id if isinstance(node.func, ast.Name) else ""
        if name in self.module.functions:
            return f"{PREFIX}{name}({', '.join(texts)})"
        if name in ("min", "max"):
            function = PREFIX + {"min": "least", "max": "most"}[name] + ("_int" if self.kinds.of(node) == INT else "")
            text = texts[0]
            for other in texts[1:]:
                text = f"{function}({text}, {other})"
            return text
        if name == "int":
            return f"(long)({texts[0]})"
        if name in ("abs", *MATH):
            return f"{'fabs' if name == 'abs' else name}({texts[0]})"
        raise untranslatable(node)


def _operator(operator: ast.AST) -> str:
    if type(operator) not in _OPERATORS:
        raise untranslatable(operator)
    return _OPERATORS[type(operator)]


__all__ = ["CSource", "c_source"]
