"""Kernel of a network as C99, translated statement by statement from its generated source, for targets without Python.

The generated source of a kernel (`twin.kernel.codegen`) is a small language: arithmetic, loops, arrays of doubles. So
the C code has the same substeps in the same order, and its results differ from those of the kernel by rounding alone.
A variable is an integer where all its values are; division is always that of floating-point numbers.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from twin.kernel.codegen import kernel_source
from twin.kernel.generated_code import MATH, GeneratedCodeError, check_source
from twin.kernel.state_layout import StateLayout
from twin.network import Network
from twin.network.assembly import NetworkEquations

Kind = Literal["int", "float", "array"]
_C_TYPE: Mapping[Kind, str] = {"int": "long", "float": "double", "array": "array"}
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
    source = kernel_source(network, "trace", (), lanes=1)
    tree = check_source(source, {"nb": None, "np": None, "FAST": None, **MATH})
    system, layout = NetworkEquations(network, ()), StateLayout(network, ())
    width = layout.split(np.zeros((1, layout.nodes)))[0].shape[1]
    return CSource(
        _Module(tree).text(),
        width,
        layout.rows,
        any(drive.dead_time for _, drive in system.drives),
    )


class _Module:
    """Translation of a module: its constants, and its functions up to the one that simulates a piece."""

    def __init__(self, tree: ast.Module) -> None:
        self.constants: dict[str, Kind] = {}
        self.returns: dict[str, Kind | None] = {}
        self._out: list[str] = [_HEAD.strip()]
        for node in tree.body:
            if isinstance(node, ast.Assign):
                self._constant(node)
            elif isinstance(node, ast.FunctionDef):
                returns, parameters = _signature(node)
                self.returns[node.name] = returns
                self._out += _Function(self, node, returns, parameters).lines()
                if node.name == ENTRY:  # the rest joins pieces, which a caller in C does by itself
                    break

    def text(self) -> str:
        """Return the C code."""
        return "\n".join(self._out) + "\n"

    def _constant(self, node: ast.Assign) -> None:
        target, value = node.targets[0], node.value
        if not isinstance(target, ast.Name) or not isinstance(value, ast.Constant):
            raise _untranslatable(node)
        self.constants[target.id] = "int" if isinstance(value.value, int) else "float"
        self._out.append(f"#define {target.id} {value.value!r}{'L' if isinstance(value.value, int) else ''}")


class _Function:
    """Translation of one function; kinds of its variables are found first, then its statements are written."""

    def __init__(
        self, module: _Module, node: ast.FunctionDef, returns: Kind | None, parameters: Iterable[Kind]
    ) -> None:
        self.module, self.node, self.returned = module, node, returns
        self.parameters = dict(zip([a.arg for a in node.args.args], parameters, strict=True))
        self.kinds: dict[str, Kind] = dict(self.parameters)
        self._temporaries = 0
        self._find_kinds()

    def lines(self) -> list[str]:
        """Return the lines of the C function."""
        arguments = ", ".join(f"{_C_TYPE[kind]} {name}" for name, kind in self.parameters.items())
        body = self._block(self.node.body)
        result = _C_TYPE[self.returned] if self.returned else "void"
        head = [f"static {result} {PREFIX}{self.node.name}({arguments}) {{"]
        own = {name: kind for name, kind in self.kinds.items() if name not in self.parameters and kind != "array"}
        head += [f"    {_C_TYPE[kind]} {name} = 0;" for name, kind in own.items()]
        return [*head, *body, "}", ""]

    def _find_kinds(self) -> None:
        """Begin with integers, and let every variable that is assigned a float become one, until nothing changes."""
        assigned: list[tuple[str, ast.expr]] = []
        for node in ast.walk(self.node):
            if isinstance(node, ast.For) and isinstance(node.target, ast.Name):
                self.kinds.setdefault(node.target.id, "int")
            elif isinstance(node, ast.Assign | ast.AugAssign):
                target = node.target if isinstance(node, ast.AugAssign) else node.targets[0]
                pairs = [(target, node.value)]
                if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                    pairs = list(zip(target.elts, node.value.elts, strict=True))
                assigned += [(place.id, value) for place, value in pairs if isinstance(place, ast.Name)]
        for name, value in assigned:
            self.kinds.setdefault(name, "array" if _allocation(value) else "int")
        changed = True
        while changed:
            changed = False
            for name, value in assigned:
                if self.kinds[name] == "int" and self._expression(value)[1] == "float":
                    self.kinds[name], changed = "float", True

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
        raise _untranslatable(node)

    def _loop(self, node: ast.For) -> list[str]:
        call = node.iter
        if not (isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "range"):
            raise _untranslatable(node)
        ends = [self._text(argument) for argument in call.args]
        begin, end = ("0", ends[0]) if len(ends) == 1 else (ends[0], ends[1])
        name = self._text(node.target)
        return [f"for ({name} = {begin}; {name} < {end}; {name}++) {{", *self._block(node.body), "}"]

    def _assign(self, target: ast.expr, value: ast.expr) -> list[str]:
        if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
            lines, names = [], []
            for each in value.elts:
                text, kind = self._expression(each)
                names.append(f"t_{self._temporaries}")
                self._temporaries += 1
                lines.append(f"{_C_TYPE[kind]} {names[-1]} = {text};")
            put = [f"{self._text(place)} = {name};" for place, name in zip(target.elts, names, strict=True)]
            return ["{", *(f"    {line}" for line in (*lines, *put)), "}"]
        if isinstance(target, ast.Name) and (made := _allocation(value)):
            return self._allocate(target.id, made)
        return [f"{self._text(target)} = {self._text(value)};"]

    def _allocate(self, name: str, call: ast.Call) -> list[str]:
        """Return the lines of a local array, or of another view of one, with sizes that are plain numbers."""
        function = call.func
        assert isinstance(function, ast.Attribute)
        if function.attr == "reshape":  # of one particle: (-1, 1)
            assert isinstance(function.value, ast.Name)
            whole = function.value.id
            return [f"array {name} = {{ {whole}.at, {{ {whole}.n[0], 1 }} }};"]
        shape = call.args[0]
        sizes = [self._text(size) for size in (shape.elts if isinstance(shape, ast.Tuple) else [shape])]
        if not all(size.isdigit() for size in sizes):
            raise _untranslatable(call)
        total = " * ".join(sizes)
        return [f"double {name}_of[{total}] = {{ 0.0 }};", f"array {name} = {{ {name}_of, {{ {', '.join(sizes)} }} }};"]

    def _text(self, node: ast.expr) -> str:
        return self._expression(node)[0]

    def _expression(self, node: ast.expr) -> tuple[str, Kind]:
        """Return an expression as C, and its kind."""
        if isinstance(node, ast.Constant) and isinstance(node.value, bool | int | float):
            return (f"{int(node.value)}", "int") if isinstance(node.value, bool | int) else (repr(node.value), "float")
        if isinstance(node, ast.Name):
            if node.id in self.kinds:
                return node.id, self.kinds[node.id]
            if node.id in self.module.constants:
                return node.id, self.module.constants[node.id]
        if isinstance(node, ast.BinOp):
            return self._binary(node)
        if isinstance(node, ast.UnaryOp):
            text, kind = self._expression(node.operand)
            sign = {ast.USub: "-", ast.UAdd: "+", ast.Not: "!"}[type(node.op)]
            return f"({sign}{text})", kind
        if isinstance(node, ast.BoolOp):
            return f"({f' {_operator(node.op)} '.join(self._text(value) for value in node.values)})", "int"
        if isinstance(node, ast.Compare) and len(node.ops) == 1:
            return f"({self._text(node.left)} {_operator(node.ops[0])} {self._text(node.comparators[0])})", "int"
        if isinstance(node, ast.IfExp):
            (yes, one), (no, other) = self._expression(node.body), self._expression(node.orelse)
            return f"({self._text(node.test)} ? {yes} : {no})", "float" if "float" in (one, other) else "int"
        if isinstance(node, ast.Subscript):
            return self._subscript(node)
        if isinstance(node, ast.Call):
            return self._call(node)
        raise _untranslatable(node)

    def _binary(self, node: ast.BinOp) -> tuple[str, Kind]:
        (left, one), (right, other) = self._expression(node.left), self._expression(node.right)
        if isinstance(node.op, ast.Pow):
            return f"pow({left}, {right})", "float"
        if isinstance(node.op, ast.Mod):  # its sign is that of the divisor, as in Python
            return f"{PREFIX}modulo({left}, {right})", "float"
        whole = one == other == "int"
        if isinstance(node.op, ast.Div) and whole:
            return f"((double){left} / {right})", "float"
        if isinstance(node.op, ast.FloorDiv | ast.BitAnd) and not whole:
            raise _untranslatable(node)
        return f"({left} {_operator(node.op)} {right})", "int" if whole else "float"

    def _subscript(self, node: ast.Subscript) -> tuple[str, Kind]:
        """Return an entry of an array in C order, or of its shape."""
        if isinstance(node.value, ast.Attribute) and isinstance(node.value.value, ast.Name):
            return f"{node.value.value.id}.n[{self._text(node.slice)}]", "int"
        if not isinstance(node.value, ast.Name):
            raise _untranslatable(node)
        name = node.value.id
        indices = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        place = self._text(indices[0])
        for axis, index in enumerate(indices[1:], start=1):
            place = f"({place}) * {name}.n[{axis}] + {self._text(index)}"
        return f"{name}.at[{place}]", "float"

    def _call(self, node: ast.Call) -> tuple[str, Kind]:
        arguments = [self._expression(argument) for argument in node.args]
        texts = [text for text, _ in arguments]
        if isinstance(node.func, ast.Attribute) and node.func.attr == "ceil":
            return f"ceil({texts[0]})", "float"
        name = node.func.id if isinstance(node.func, ast.Name) else ""
        if name in self.module.returns:
            return f"{PREFIX}{name}({', '.join(texts)})", self.module.returns[name] or "int"
        if name in ("min", "max"):
            whole = all(kind == "int" for _, kind in arguments)
            function = PREFIX + {"min": "least", "max": "most"}[name] + ("_int" if whole else "")
            text = texts[0]
            for other in texts[1:]:
                text = f"{function}({text}, {other})"
            return text, "int" if whole else "float"
        if name == "int":
            return f"(long)({texts[0]})", "int"
        if name in ("abs", *MATH):
            return f"{'fabs' if name == 'abs' else name}({texts[0]})", "float"
        raise _untranslatable(node)


def _signature(node: ast.FunctionDef) -> tuple[Kind | None, list[Kind]]:
    """Return the kinds of result and parameters from the types in the decorator; all floats where there are none."""
    decorator = node.decorator_list[0]
    if not isinstance(decorator, ast.Call) or not decorator.args:
        return "float", ["float"] * len(node.args.args)
    text = ast.literal_eval(decorator.args[0])
    result, _, rest = text.partition("(")
    parameters, depth, word = [], 0, ""
    for sign in rest[:-1] + ",":
        depth += {"[": 1, "]": -1}.get(sign, 0)
        if sign == "," and not depth:
            parameters.append(_kind(word.strip()))
            word = ""
        else:
            word += sign
    return (None if result.strip() == "void" else _kind(result.strip())), parameters


def _kind(numba_type: str) -> Kind:
    return "array" if "[" in numba_type else "int" if numba_type == "i8" else "float"


def _allocation(value: ast.expr) -> ast.Call | None:
    """Return the call that makes an array or another view of one, or None."""
    if isinstance(value, ast.Call) and isinstance(value.func, ast.Attribute):
        return value if value.func.attr in ("zeros", "empty", "reshape") else None
    return None


def _operator(operator: ast.AST) -> str:
    if type(operator) not in _OPERATORS:
        raise _untranslatable(operator)
    return _OPERATORS[type(operator)]


def _untranslatable(node: ast.AST) -> GeneratedCodeError:
    line = getattr(node, "lineno", 0)
    return GeneratedCodeError(f"line {line} of the generated source has no translation to C; please report it")


__all__ = ["CSource", "c_source"]
