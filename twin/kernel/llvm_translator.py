"""Kernel of a network as LLVM assembly, translated statement by statement from its generated source.

The generated source of a kernel (`twin.kernel.codegen`) is a small language: arithmetic, loops, arrays of doubles. It
is translated as it stands, with the freedom of rounding in `FREEDOM`; LLVM does the rest, and turns the loops over
lanes into vector instructions.

An array is the address of its first entry and four sizes, 1 beyond its axes. A variable is a place on the stack, which
LLVM turns into a register. Indices are never negative, and division is always that of floating-point numbers.
"""

from __future__ import annotations

import ast
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from twin.kernel.generated_code import MATH
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

FREEDOM = "contract nsz arcp"
"""Freedom of rounding with which kernels are compiled: fused multiply-adds, sign of zero, reciprocals."""
ENTRY = "kernel"
AXES = 4
"""Sizes that come with the address of an array."""
_LARGEST_POWER = 8
"""Largest whole exponent that is written as products."""
_FLOATS = {ast.Add: "fadd", ast.Sub: "fsub", ast.Mult: "fmul", ast.Div: "fdiv"}
_WHOLE = {ast.Add: "add nsw", ast.Sub: "sub nsw", ast.Mult: "mul nsw", ast.FloorDiv: "sdiv", ast.BitAnd: "and"}
_ORDER = {ast.Lt: "lt", ast.LtE: "le", ast.Gt: "gt", ast.GtE: "ge", ast.Eq: "eq", ast.NotEq: "ne"}
_HEAD = """
declare double @llvm.ceil.f64(double)
declare double @llvm.fabs.f64(double)
declare i64 @llvm.abs.i64(i64, i1)
declare double @llvm.pow.f64(double, double)
declare double @exp(double)
declare double @log(double)
declare noalias ptr @calloc(i64, i64) allockind("alloc,zeroed") allocsize(0,1) "alloc-family"="malloc"
declare void @free(ptr) allockind("free") "alloc-family"="malloc"
"""


@dataclass(frozen=True)
class _Value:
    """A value: its name or number in LLVM code, its kind, and the sizes of an array."""

    text: str
    kind: Kind
    sizes: tuple[str, ...] = ()


def llvm_text(tree: ast.Module) -> str:
    """Return the checked source of a kernel as LLVM assembly; its function `ENTRY` is the entry.

    The entry takes the address of 64-bit words: each argument's number, or an array's address and `AXES` sizes.

    Raises
    ------
    twin.kernel.generated_code.GeneratedCodeError
        The source holds a construct that has no translation: a defect of a generator.
    """
    module = ModuleKinds(tree)
    parts = [_HEAD]
    parts += [_Function(module, node).text() for node in tree.body if isinstance(node, ast.FunctionDef)]
    return "\n".join([*parts, _entry(module)])


def _entry(module: ModuleKinds) -> str:
    """Return the function that takes the arguments of `ENTRY` from memory."""
    lines, arguments, word = [], [], 0
    for kind in module.functions[ENTRY].parameters:
        for type_ in ("ptr", *["i64"] * AXES) if kind.axes else ("i64" if kind.whole else "double",):
            lines += [f"%a{word} = getelementptr i64, ptr %words, i64 {word}", f"%w{word} = load {type_}, ptr %a{word}"]
            arguments.append(f"{type_} %w{word}")
            word += 1
    lines.append(f"call void @k_{ENTRY}({', '.join(arguments)})")
    return "\n".join([f"define void @{ENTRY}(ptr %words) {{", *lines, "ret void", "}", ""])


def _type(kind: Kind) -> str:
    return "ptr" if kind.axes else "i64" if kind.whole else "double"


class _Function:
    """Translation of one function."""

    def __init__(self, module: ModuleKinds, node: ast.FunctionDef) -> None:
        self.module, self.node = module, node
        self.kinds = FunctionKinds(module, node)
        self.signature = module.functions[node.name]
        self._code: list[str] = []
        self._places: list[str] = []
        self._made: list[str] = []
        """Places of the addresses of arrays that the function has made."""
        self._count = 0
        self._open = True
        """False after a jump, until a block begins."""
        self._ends: list[str] = []
        """Labels behind the loops around the present statement."""

    def text(self) -> str:
        """Return the function."""
        for name, kind in self.kinds.names.items():
            self._places.append(f"%n.{name} = alloca {_type(kind)}")
            if kind.axes:
                self._places += [f"%n.{name}.{axis} = alloca i64" for axis in range(AXES)]
        arguments = []
        for name in self.kinds.parameters:
            kind = self.kinds.names[name]
            arguments.append(f"{_type(kind)} %a.{name}")
            self._emit(f"store {_type(kind)} %a.{name}, ptr %n.{name}")
            for axis in range(AXES if kind.axes else 0):
                arguments.append(f"i64 %a.{name}.{axis}")
                self._emit(f"store i64 %a.{name}.{axis}, ptr %n.{name}.{axis}")
        self._block(self.node.body)
        self._return(None)
        result = _type(self.signature.result) if self.signature.result else "void"
        inline = " alwaysinline" if self.signature.inline else ""
        head = f"define internal {result} @k_{self.node.name}({', '.join(arguments)}) nounwind{inline} {{"
        return "\n".join([head, *self._places, *self._code, "}", ""])

    def _emit(self, line: str) -> None:
        if self._open:
            self._code.append(line)

    def _new(self, line: str) -> str:
        """Write an instruction and return the name of its result."""
        self._count += 1
        name = f"%v{self._count}"
        self._emit(f"{name} = {line}")
        return name

    def _label(self) -> str:
        self._count += 1
        return f"b{self._count}"

    def _begin(self, label: str) -> None:
        self._open = True
        self._code.append(f"{label}:")

    def _jump(self, line: str) -> None:
        """End a block."""
        self._emit(line)
        self._open = False

    def _return(self, value: _Value | None) -> None:
        for place in self._made:
            self._emit(f"call void @free(ptr {self._new(f'load ptr, ptr {place}')})")
        if value is None:
            result = self.signature.result  # only where the end cannot be reached is there a result but no value
            self._jump("ret void" if result is None else "unreachable")
        else:
            self._jump(f"ret {_type(value.kind)} {value.text}")

    def _block(self, body: Sequence[ast.stmt]) -> None:
        for statement in body:
            self._statement(statement)

    def _statement(self, node: ast.stmt) -> None:
        """Write one statement."""
        if isinstance(node, ast.Expr):
            if not isinstance(node.value, ast.Constant):
                self._expression(node.value)
        elif isinstance(node, ast.Assign):
            self._assign(node.targets[0], node.value)
        elif isinstance(node, ast.AugAssign):
            here = ast.copy_location(ast.BinOp(_loaded(node.target), node.op, node.value), node)
            self._assign(node.target, here)
        elif isinstance(node, ast.If):
            self._if(node)
        elif isinstance(node, ast.While):
            self._loop(lambda: self._condition(node.test), node.body, lambda: None)
        elif isinstance(node, ast.For):
            self._for(node)
        elif isinstance(node, ast.Break):
            self._jump(f"br label %{self._ends[-1]}")
        elif isinstance(node, ast.Return) and node.value is not None:
            assert self.signature.result is not None
            self._return(self._as(self._expression(node.value), self.signature.result))
        else:
            raise untranslatable(node)

    def _if(self, node: ast.If) -> None:
        yes, no, end = self._label(), self._label(), self._label()
        self._jump(f"br i1 {self._condition(node.test)}, label %{yes}, label %{no}")
        for label, body in ((yes, node.body), (no, node.orelse)):
            self._begin(label)
            self._block(body)
            self._jump(f"br label %{end}")
        self._begin(end)

    def _for(self, node: ast.For) -> None:
        """Write a loop over a range."""
        call = node.iter
        if not (isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "range"):
            raise untranslatable(node)
        ends = [self._as(self._expression(argument), INT).text for argument in call.args]
        first, last = ("0", ends[0]) if len(ends) == 1 else (ends[0], ends[1])
        assert isinstance(node.target, ast.Name)
        name = node.target.id
        # A counter of its own: the variable keeps its last value after the loop, as in Python.
        self._count += 1
        counter = f"%c{self._count}"
        self._places.append(f"{counter} = alloca i64")
        self._emit(f"store i64 {first}, ptr {counter}")

        def more() -> str:
            now = self._new(f"load i64, ptr {counter}")
            return self._new(f"icmp slt i64 {now}, {last}")

        def advance() -> None:
            now = self._new(f"load i64, ptr {counter}")
            self._emit(f"store i64 {self._new(f'add nsw i64 {now}, 1')}, ptr {counter}")

        self._loop(more, node.body, advance, (name, counter))

    def _loop(
        self,
        condition: Callable[[], str],
        body: Sequence[ast.stmt],
        advance: Callable[[], None],
        counted: tuple[str, str] | None = None,
    ) -> None:
        """Write a loop: its variable, its test, its body and its step."""
        head, inside, end = self._label(), self._label(), self._label()
        self._jump(f"br label %{head}")
        self._begin(head)
        self._jump(f"br i1 {condition()}, label %{inside}, label %{end}")
        self._begin(inside)
        if counted:
            self._emit(f"store i64 {self._new(f'load i64, ptr {counted[1]}')}, ptr %n.{counted[0]}")
        self._ends.append(end)
        self._block(body)
        self._ends.pop()
        advance()
        self._jump(f"br label %{head}")
        self._begin(end)

    def _assign(self, target: ast.expr, value: ast.expr) -> None:
        if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
            values = [self._expression(part) for part in value.elts]
            for place, each in zip(target.elts, values, strict=True):
                self._store(place, each)
        else:
            made = allocation(value) is not None and not is_view(value)
            if made:
                assert isinstance(target, ast.Name)
                self._made.append(f"%n.{target.id}")
            self._store(target, self._expression(value))

    def _store(self, target: ast.expr, value: _Value) -> None:
        if isinstance(target, ast.Name):
            kind = self.kinds.names[target.id]
            value = self._as(value, kind)
            self._emit(f"store {_type(kind)} {value.text}, ptr %n.{target.id}")
            for axis, size in enumerate(value.sizes):
                self._emit(f"store i64 {size}, ptr %n.{target.id}.{axis}")
        elif isinstance(target, ast.Subscript):
            place = self._entry_of(target)
            value = self._as(value, Kind(place.kind.whole))
            self._emit(f"store {_type(value.kind)} {value.text}, ptr {place.text}")
        else:
            raise untranslatable(target)

    def _as(self, value: _Value, kind: Kind) -> _Value:
        """Return a value as one of another kind."""
        if value.kind == kind:
            return value
        if value.kind.axes or kind.axes:
            raise untranslatable(self.node)
        if kind == FLOAT:
            if value.text.lstrip("-").isdigit():
                return _number(float(int(value.text)))
            return _Value(self._new(f"sitofp i64 {value.text} to double"), FLOAT)
        return _Value(self._new(f"fptosi double {value.text} to i64"), INT)

    def _condition(self, node: ast.expr) -> str:
        """Return an expression as a truth value of one bit."""
        if isinstance(node, ast.Compare) and len(node.ops) == 1:
            left, right = self._expression(node.left), self._expression(node.comparators[0])
            order = _ORDER[type(node.ops[0])]
            if left.kind == right.kind == INT:
                signed = "" if order in ("eq", "ne") else "s"
                return self._new(f"icmp {signed}{order} i64 {left.text}, {right.text}")
            one, other = self._as(left, FLOAT).text, self._as(right, FLOAT).text
            return self._new(f"fcmp {'u' if order == 'ne' else 'o'}{order} double {one}, {other}")
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            return self._new(f"xor i1 {self._condition(node.operand)}, true")
        if isinstance(node, ast.BoolOp):
            return self._either(node.values, isinstance(node.op, ast.Or))
        value = self._expression(node)
        if value.kind == INT:
            return self._new(f"icmp ne i64 {value.text}, 0")
        return self._new(f"fcmp une double {value.text}, 0.0")

    def _either(self, nodes: Sequence[ast.expr], is_or: bool) -> str:
        """Return a chain of "or" or "and": a part is evaluated only where those before it do not decide."""
        self._count += 1
        place = f"%c{self._count}"
        self._places.append(f"{place} = alloca i1")
        end = self._label()
        for node in nodes[:-1]:
            truth, rest = self._condition(node), self._label()
            self._emit(f"store i1 {truth}, ptr {place}")
            ways = f"label %{end}, label %{rest}" if is_or else f"label %{rest}, label %{end}"
            self._jump(f"br i1 {truth}, {ways}")
            self._begin(rest)
        self._emit(f"store i1 {self._condition(nodes[-1])}, ptr {place}")
        self._jump(f"br label %{end}")
        self._begin(end)
        return self._new(f"load i1, ptr {place}")

    def _expression(self, node: ast.expr) -> _Value:
        """Write an expression and return its value."""
        if isinstance(node, ast.Constant) and isinstance(node.value, bool | int | float):
            return _number(node.value)
        if isinstance(node, ast.Name):
            return self._name(node)
        if isinstance(node, ast.BinOp):
            return self._binary(node)
        if isinstance(node, ast.UnaryOp) and not isinstance(node.op, ast.Not):
            value = self._expression(node.operand)
            if isinstance(node.op, ast.UAdd):
                return value
            negative = f"sub nsw i64 0, {value.text}" if value.kind == INT else f"fneg {FREEDOM} double {value.text}"
            return _Value(self._new(negative), value.kind)
        if isinstance(node, ast.UnaryOp | ast.BoolOp | ast.Compare):
            return _Value(self._new(f"zext i1 {self._condition(node)} to i64"), INT)
        if isinstance(node, ast.IfExp):
            return self._choice(node)
        if isinstance(node, ast.Subscript):
            return self._subscript(node)
        if isinstance(node, ast.Call):
            return self._call(node)
        raise untranslatable(node)

    def _name(self, node: ast.Name) -> _Value:
        if node.id in self.kinds.names:
            kind = self.kinds.names[node.id]
            sizes = [self._new(f"load i64, ptr %n.{node.id}.{axis}") for axis in range(AXES if kind.axes else 0)]
            return _Value(self._new(f"load {_type(kind)}, ptr %n.{node.id}"), kind, tuple(sizes))
        if node.id in self.module.constants:
            return _number(self.module.constants[node.id])
        raise untranslatable(node)

    def _choice(self, node: ast.IfExp) -> _Value:
        kind = self.kinds.of(node)
        self._count += 1
        place = f"%c{self._count}"
        self._places.append(f"{place} = alloca {_type(kind)}")
        yes, no, end = self._label(), self._label(), self._label()
        self._jump(f"br i1 {self._condition(node.test)}, label %{yes}, label %{no}")
        for label, part in ((yes, node.body), (no, node.orelse)):
            self._begin(label)
            self._emit(f"store {_type(kind)} {self._as(self._expression(part), kind).text}, ptr {place}")
            self._jump(f"br label %{end}")
        self._begin(end)
        return _Value(self._new(f"load {_type(kind)}, ptr {place}"), kind)

    def _binary(self, node: ast.BinOp) -> _Value:
        if isinstance(node.op, ast.Pow):
            return self._power(node)
        left, right = self._expression(node.left), self._expression(node.right)
        whole = left.kind == right.kind == INT
        if whole and type(node.op) in _WHOLE:
            return _Value(self._new(f"{_WHOLE[type(node.op)]} i64 {left.text}, {right.text}"), INT)
        one, other = self._as(left, FLOAT).text, self._as(right, FLOAT).text
        if isinstance(node.op, ast.Mod):
            return self._modulo(one, other)
        if type(node.op) not in _FLOATS:
            raise untranslatable(node)
        return _Value(self._new(f"{_FLOATS[type(node.op)]} {FREEDOM} double {one}, {other}"), FLOAT)

    def _modulo(self, one: str, other: str) -> _Value:
        """Return a remainder with the sign of the divisor, as Python's."""
        rest = self._new(f"frem double {one}, {other}")
        signs = [self._new(f"fcmp olt double {number}, 0.0") for number in (rest, other)]
        apart = self._new(f"xor i1 {signs[0]}, {signs[1]}")
        some = self._new(f"fcmp une double {rest}, 0.0")
        wrong = self._new(f"and i1 {some}, {apart}")
        moved = self._new(f"fadd double {rest}, {other}")
        return _Value(self._new(f"select i1 {wrong}, double {moved}, double {rest}"), FLOAT)

    def _power(self, node: ast.BinOp) -> _Value:
        base = self._as(self._expression(node.left), FLOAT).text
        given = node.right.value if isinstance(node.right, ast.Constant) else None
        if isinstance(given, int | float) and given in range(1, _LARGEST_POWER + 1):
            product = base
            for _ in range(int(given) - 1):
                product = self._new(f"fmul {FREEDOM} double {product}, {base}")
            return _Value(product, FLOAT)
        exponent = self._as(self._expression(node.right), FLOAT).text
        return _Value(self._new(f"call {FREEDOM} double @llvm.pow.f64(double {base}, double {exponent})"), FLOAT)

    def _entry_of(self, node: ast.Subscript) -> _Value:
        """Return the address of an entry, or of a part with fewer axes and its sizes."""
        if not isinstance(node.value, ast.Name):
            raise untranslatable(node)
        array = self._name(node.value)
        given = [self._as(self._expression(index), INT).text for index in indices(node)]
        place = given[0]
        for axis in range(1, array.kind.axes):
            place = self._new(f"mul nsw i64 {place}, {array.sizes[axis]}")
            if axis < len(given):
                place = self._new(f"add nsw i64 {place}, {given[axis]}")
        element = "i64" if array.kind.whole else "double"
        address = self._new(f"getelementptr inbounds {element}, ptr {array.text}, i64 {place}")
        left = array.kind.axes - len(given)
        sizes = (*array.sizes[len(given) :], *["1"] * len(given)) if left else ()
        return _Value(address, Kind(array.kind.whole, left), sizes)

    def _subscript(self, node: ast.Subscript) -> _Value:
        if isinstance(node.value, ast.Attribute):  # a shape
            assert isinstance(node.value.value, ast.Name) and isinstance(node.slice, ast.Constant)
            return _Value(self._new(f"load i64, ptr %n.{node.value.value.id}.{node.slice.value!r}"), INT)
        entry = self._entry_of(node)
        if entry.kind.axes:
            return entry
        return _Value(self._new(f"load {_type(entry.kind)}, ptr {entry.text}"), entry.kind)

    def _allocate(self, node: ast.Call, shape: Sequence[ast.expr]) -> _Value:
        """Return a new array of zeros, or another view of one."""
        assert isinstance(node.func, ast.Attribute)
        if is_view(node):
            assert isinstance(node.func.value, ast.Name)
            whole = self._name(node.func.value)
            width = self._expression(shape[1]).text
            rows = self._new(f"sdiv i64 {whole.sizes[0]}, {width}")
            return _Value(whole.text, Kind(False, 2), (rows, width, "1", "1"))
        sizes = [self._as(self._expression(size), INT).text for size in shape]
        total = sizes[0]
        for size in sizes[1:]:
            total = self._new(f"mul nsw i64 {total}, {size}")
        address = self._new(f"call noalias ptr @calloc(i64 {total}, i64 8)")
        return _Value(address, Kind(False, len(sizes)), (*sizes, *["1"] * (AXES - len(sizes))))

    def _call(self, node: ast.Call) -> _Value:
        """Write a call of the module, of LLVM or of `MATH`, and return its value."""
        if (shape := allocation(node)) is not None:
            return self._allocate(node, shape)
        values = [self._expression(argument) for argument in node.args]
        if isinstance(node.func, ast.Attribute) and node.func.attr == "ceil":
            return self._called("llvm.ceil.f64", values[0])
        name = node.func.id if isinstance(node.func, ast.Name) else ""
        if name in self.module.functions:
            return self._own(name, values)
        if name in ("min", "max"):
            return self._extreme("lt" if name == "min" else "gt", values)
        if name == "int":
            return self._as(values[0], INT)
        if name == "abs":
            if values[0].kind == INT:
                return _Value(self._new(f"call i64 @llvm.abs.i64(i64 {values[0].text}, i1 false)"), INT)
            return self._called("llvm.fabs.f64", values[0])
        if name in MATH:
            return self._called(name, values[0])
        raise untranslatable(node)

    def _called(self, name: str, value: _Value) -> _Value:
        return _Value(self._new(f"call {FREEDOM} double @{name}(double {self._as(value, FLOAT).text})"), FLOAT)

    def _own(self, name: str, values: Sequence[_Value]) -> _Value:
        signature = self.module.functions[name]
        given = []
        for value, kind in zip(values, signature.parameters, strict=True):
            value = self._as(value, kind)
            given.append(f"{_type(kind)} {value.text}")
            given += [f"i64 {size}" for size in value.sizes]
        call = f"@k_{name}({', '.join(given)})"
        if signature.result is None:
            self._emit(f"call void {call}")
            return _Value("", INT)
        return _Value(self._new(f"call {_type(signature.result)} {call}"), signature.result)

    def _extreme(self, order: str, values: Sequence[_Value]) -> _Value:
        kind = INT if all(value.kind == INT for value in values) else FLOAT
        compare = f"icmp s{order} i64" if kind == INT else f"fcmp o{order} double"
        best, *others = (self._as(value, kind).text for value in values)
        for other in others:
            better = self._new(f"{compare} {other}, {best}")
            nsz = "" if kind == INT else " nsz"
            best = self._new(f"select{nsz} i1 {better}, {_type(kind)} {other}, {_type(kind)} {best}")
        return _Value(best, kind)


def _number(value: bool | int | float) -> _Value:
    if isinstance(value, float):
        return _Value(f"0x{struct.unpack('<Q', struct.pack('<d', value))[0]:016X}", FLOAT)
    return _Value(str(int(value)), INT)


def _loaded(node: ast.expr) -> ast.expr:
    """Return the place of an assignment as an expression."""
    if isinstance(node, ast.Name):
        return ast.copy_location(ast.Name(node.id, ast.Load()), node)
    assert isinstance(node, ast.Subscript)
    return ast.copy_location(ast.Subscript(node.value, node.slice, ast.Load()), node)


__all__ = ["AXES", "ENTRY", "llvm_text"]
