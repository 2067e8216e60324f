"""Names in twin files are data: odd ones are refused by the reader, and the generator would be safe without that."""

from __future__ import annotations

import ast
import math
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.elements.symbols import Names, Symbols
from twin.kernel.codegen import MODES, kernel_source
from twin.kernel.generated_code import (
    KERNEL_NAMES,
    MATH,
    GeneratedCodeError,
    check_source,
    define_functions,
    evaluate_formula,
)
from twin.network import Network, TwinFileError
from twin.network.assembly import NetworkEquations
from twin.network.reference_source import python_source, stateful_source
from twin.twinfile import parse

ODD = {
    "closes a placeholder": "pump_pct> + 0.0*int(__import__('os').getpid()) + 0.0*<U:pump_pct",
    "is an expression": "(lambda: 0)()",
    "has a space": "fan speed_pct",
    "has a line break": "fan\n_pct",
    "starts with a digit": "1_pct",
    "is empty": "",
    "is not ASCII": "Lüfter_pct",
    "looks like ASCII": "fan_speed_pct".replace("a", "\N{CYRILLIC SMALL LETTER A}"),
    "is a keyword": "lambda",
    "is a dunder": "__import__",
    "is a format field": "{0.__class__}_pct",
}


def quoted(name: str) -> str:
    return '"' + name.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n") + '"'


@pytest.mark.parametrize("name", ODD.values(), ids=ODD.keys())
@pytest.mark.parametrize("where", ["input", "element", "column", "set"])
def test_a_name_that_is_no_identifier_is_refused_with_line_and_remedy(loop_text: str, name: str, where: str) -> None:
    key = quoted(name)
    if where == "input":
        text = loop_text.replace("[inputs]\n", f"[inputs]\n{key} = {{ nominal = 1.0 }}\n", 1)
    elif where == "element":
        text = loop_text + f'\n[elements.{key}]\nkind = "node"\ncapacitance = 100.0\n'
    elif where == "column":
        text = loop_text + f'\n[elements.more]\nkind = "sensor"\nnode = "tank"\ncolumns = [{key}]\n'
    else:
        text = loop_text + f'\n[sets.{key}]\nmembers = ["tank.capacitance"]\n'
    with pytest.raises(TwinFileError, match=r"^my\.toml, line \d+: .*; rename it") as caught:
        parse(text, "my.toml")
    message = str(caught.value)
    at = int(message.split("line ")[1].split(":")[0])
    assert key in text.splitlines()[at - 1]
    assert "\n" not in message


@pytest.mark.parametrize("name", ["fan_2_speed_pct", "_hidden_pct", "T2_C", "print_W", "max_pct", "p1", "L_tank__q"])
def test_plain_identifiers_are_names(loop_text: str, name: str) -> None:
    network = parse(loop_text.replace("[inputs]\n", f"[inputs]\n{name} = {{ nominal = 1.0 }}\n", 1))
    assert name in network.input_columns


def renamed(network: Network, old: str, new: str) -> Network:
    """A network with another input name, made past the reader."""
    inputs = {new if c == old else c: replace(s, column=new if c == old else c) for c, s in network.inputs.items()}
    elements = []
    for e in network.elements:
        fields = {f.name: new for f in e.places().values() if getattr(e, f.name) == old}
        elements.append(replace(e, **fields))
    return replace(network, inputs=MappingProxyType(inputs), elements=tuple(elements))


@pytest.mark.parametrize("name", ODD.values(), ids=ODD.keys())
def test_no_name_is_part_of_generated_source_even_past_the_reader(loop: Network, name: str) -> None:
    odd = renamed(loop, loop.input_columns[1], name)
    assert name in odd.input_columns
    assert python_source(odd) == python_source(loop)
    assert stateful_source(NetworkEquations(odd, odd.ids)) == stateful_source(NetworkEquations(loop, loop.ids))
    for mode in MODES:
        assert kernel_source(odd, mode, odd.tunables()) == kernel_source(loop, mode, loop.tunables())


@given(st.text(max_size=30), st.text(max_size=30), st.text(max_size=30), st.text(max_size=30))
def test_locals_are_identifiers_and_never_shared(element: str, name: str, other: str, another: str) -> None:
    symbols = Symbols()
    first, second = Names(element, symbols=symbols).local(name), Names(other, symbols=symbols).local(another)
    assert first.isascii() and first.isidentifier()
    assert second.isascii() and second.isidentifier()
    assert (first == second) == ((element, name) == (other, another))
    assert Names(element, symbols=symbols).local(name) == first


def test_an_element_that_uses_what_it_does_not_declare_is_a_defect() -> None:
    symbols = Symbols(nodes=("tank",))
    names = Names("pipe", symbols=symbols)
    assert (names.state("wall"), names.state("foam")) == ("x1", "x2")
    with pytest.raises(ValueError, match=r"pipe\.foam"):
        symbols.settle({"x": ("pipe.wall",)})


FORBIDDEN = {
    "import": "import os",
    "import inside": "def f(x):\n    import os\n    return x",
    "builtin": "def f(x):\n    return __import__('os')",
    "open": "def f(x):\n    return open(x)",
    "eval": "def f(x):\n    return eval(x)",
    "attribute": "def f(x):\n    return x.__class__",
    "method": "def f(x):\n    return x.tofile(x)",
    "another of numpy's": "def f(x):\n    return np.fromfile(x)",
    "module of numpy": "def f(x):\n    return np.ctypeslib.ctypes",
    "string": "def f(x):\n    return 'text'",
    "lambda": "def f(x):\n    return (lambda: x)()",
    "call of an argument": "def f(x):\n    return x(1.0)",
    "call of a result": "def f(x):\n    return max(x)(1.0)",
    "subscript call": "def f(x):\n    return x[0](1.0)",
    "comprehension": "def f(x):\n    return [y for y in x]",
    "default": "def f(x=open):\n    return x",
    "decorator": "@np.vectorize\ndef f(x):\n    return x",
    "option of a decorator": "@typed('f8(f8)', cache=1)\ndef f(x):\n    return x",
    "call in a decorator": "@typed(open('a'))\ndef f(x):\n    return x",
    "text that is no type": "@typed('f8(f8), open')\ndef f(x):\n    return x",
    "class": "class A:\n    pass",
    "try": "try:\n    x = 1.0\nexcept ValueError:\n    x = 2.0",
    "global": "def f(x):\n    global y\n    return x",
    "f-string": "def f(x):\n    return f'{x}'",
    "keyword": "def f(x):\n    return max(x, key=x)",
    "walrus": "def f(x):\n    return (y := x)",
    "complex": "def f(x):\n    return 1j * x",
    "unknown name": "def f(x):\n    return x * stray",
    "dunder": "def f(__x):\n    return __x",
    "no Python": "def f(x:\n",
}


@pytest.mark.parametrize("source", FORBIDDEN.values(), ids=FORBIDDEN.keys())
def test_whatever_is_no_arithmetic_is_refused_before_it_runs(source: str) -> None:
    with pytest.raises(GeneratedCodeError, match="generated source"):
        check_source(source, KERNEL_NAMES)


def test_generated_functions_run_without_builtins() -> None:
    scope = define_functions("def f(x):\n    return exp(max(x, 0.0)) + abs(x)\n", "<test>", MATH)
    assert scope["f"](1.0) == math.e + 1.0
    assert "open" not in scope["__builtins__"] and "__import__" not in scope["__builtins__"]
    assert evaluate_formula("2.0 * p3", {"p3": 4.0}) == 8.0


@pytest.mark.parametrize("twin", ["loop_six", "virtual", "heated_pipe", "wet_tower_constant"])
def test_all_that_the_generators_write_passes_the_check(twin: str) -> None:
    from twin.twinfile import load

    network = load(Path(__file__).resolve().parents[2] / "profiles" / "twins" / f"{twin}.toml")
    for mode in MODES:
        tree = check_source(kernel_source(network, mode, network.ids), KERNEL_NAMES)
        assert any(isinstance(n, ast.FunctionDef) and n.name == "kernel" for n in tree.body)
