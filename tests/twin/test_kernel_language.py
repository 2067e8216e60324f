"""Compiled kernels do what Python does with the same source."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.kernel import compile_kernel
from twin.kernel.generated_code import GeneratedCodeError

HELPERS = """
FEW = 3
HALF = 0.5


@inlined
def double(x):
    return x + x


@typed('i8(f8[:,::1], i8)')
def first_above(a, row):
    for i in range(a.shape[1]):
        if a[row, i] > HALF:
            return i
    return FEW


@typed('f8(f8[:,::1])')
def total(a):
    found = 0.0
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            found += a[i, j]
    return found
"""
HEAD = "@typed('void(f8[:,:,::1], i8[::1], i8, f8, f8[::1])')\ndef kernel(cube, whole, n, x, out):\n"
BODIES = {
    "whole and floating": """
out[0] = n / 2
out[1] = n // 2
out[2] = n & 3
out[3] = (n + 1) * 2 - n
out[4] = -n
""",
    "a variable that becomes floating": """
k = 0
for i in range(n):
    k += 1
    k = k * 1.5
out[0] = k
""",
    "powers": """
out[0] = x**2
out[1] = x**3
out[2] = abs(x)**0.5
out[3] = abs(x)**1.7
out[4] = n**2
""",
    "remainders": """
out[0] = x % 1.5
out[1] = -x % 1.5
out[2] = x % -1.5
out[3] = 7.0 % 3.0
out[4] = 6.0 % 3.0
""",
    "functions": """
out[0] = exp(x)
out[1] = log(abs(x) + 1.0)
out[2] = np.ceil(x)
out[3] = int(x)
out[4] = abs(-n)
""",
    "least and most": """
out[0] = min(x, 1.0, 0.5)
out[1] = max(n, 2)
out[2] = max(n, x)
out[3] = min(whole[0], n)
""",
    "choices": """
out[0] = 1.0 if x > 0.0 else 2
out[1] = cube[9, 9, 9] if n < 0 else -1.0
out[2] = x if x == x else 0.0
""",
    "truth": """
new = n == 3 or x > 1.0
out[0] = new
out[1] = int(x < 0.0) + int(not new)
if not new:
    out[2] = 5.0
""",
    "a guard that decides": """
i = 0
if i == 0 or cube[i - 9, 0, 0] > 0.0:
    out[0] = 1.0
if i > 0 and cube[999, 0, 0] > 0.0:
    out[1] = 1.0
""",
    "loops": """
for i in range(2, n):
    if i == 5:
        break
    out[0] += i
k = 0
while k < n:
    k += 2
out[1] = k
out[2] = i if n > 2 else 0
""",
    "loops in loops": """
for i in range(n):
    for j in range(4):
        if j > i:
            break
        out[j] += 1.0
""",
    "an end that changes": """
k = n
for i in range(k):
    k = 0
    out[0] += 1.0
""",
    "two at once": """
a, b = 1.0, x
a, b = b, a
out[0], out[1] = a, b
""",
    "arrays": """
W = np.zeros(6)
W[2] = x
V = W.reshape(-1, 3)
V[1, 0] = 4.0
out[0] = W[3] + V[0, 2]
out[1] = V.shape[0]
out[2] = total(V)
""",
    "parts of arrays": """
part = cube[1]
out[0] = part[1, 2]
out[1] = part.shape[0] * 10 + part.shape[1]
out[2] = total(cube[0])
part = cube[0]
out[3] = part[0, 0]
""",
    "own functions": """
out[0] = double(x)
out[1] = first_above(cube[1], 1)
out[2] = first_above(cube[0], 0)
""",
}


def plain(source: str) -> Callable[..., None]:
    """Return the kernel of a source as Python runs it."""
    scope: dict[str, Any] = {
        "np": np,
        "exp": math.exp,
        "log": math.log,
        "typed": lambda types: lambda function: function,
        "inlined": lambda function: function,
    }
    exec(source, scope)
    kernel: Callable[..., None] = scope["kernel"]
    return kernel


@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES.keys())
@pytest.mark.parametrize(("n", "x"), [(0, -2.25), (3, 0.75), (7, 3.5)])
def test_a_statement_does_what_it_does_in_python(body: str, n: int, x: float) -> None:
    source = HELPERS + "\n\n" + HEAD + "\n".join(f"    {line}" for line in body.strip().splitlines()) + "\n"
    if n <= 2 and "out[2] = i if" in body:
        source = source.replace("    k = 0\n", "    i = 0\n    k = 0\n")  # Python knows no variable of an empty loop
    cube = np.arange(24.0).reshape(2, 3, 4) / 8.0
    answers = []
    for kernel in (plain(source), compile_kernel(source)):
        out = np.zeros(5)
        kernel(np.pad(cube, ((0, 8), (0, 7), (0, 6)))[:2, :3, :4].copy(), np.array([4, 5]), n, x, out)
        answers.append(out)
    np.testing.assert_allclose(answers[1], answers[0], rtol=1e-14)


NUMBER = st.floats(-50.0, 50.0).map(lambda value: round(value, 6))
EXPRESSION = st.recursive(
    NUMBER.map(lambda value: f"({value!r})") | st.sampled_from(["x", "y", "n"]),
    lambda part: (
        st.tuples(part, st.sampled_from("+-*"), part).map(lambda t: f"({t[0]} {t[1]} {t[2]})")
        | st.tuples(part, part).map(lambda t: f"({t[0]} / (abs({t[1]}) + 0.25))")
        | st.tuples(st.sampled_from(["min", "max"]), part, part).map(lambda t: f"{t[0]}({t[1]}, {t[2]})")
        | st.tuples(part, part, part).map(lambda t: f"({t[0]} if {t[1]} < {t[2]} else {t[1]})")
        | part.map(lambda inner: f"(-{inner})")
    ),
    max_leaves=12,
)


@settings(max_examples=60, deadline=None)
@given(st.lists(EXPRESSION, min_size=4, max_size=4), NUMBER, NUMBER, st.integers(-9, 9))
def test_formulas_give_pythons_numbers(formulas: list[str], x: float, y: float, n: int) -> None:
    lines = "".join(f"    out[{i}] = {formula}\n" for i, formula in enumerate(formulas))
    source = f"@typed('void(f8, f8, i8, f8[::1])')\ndef kernel(x, y, n, out):\n{lines}"
    wanted, out = np.zeros(4), np.zeros(4)
    plain(source)(x, y, n, wanted)
    compile_kernel(source)(x, y, n, out)
    scale = np.maximum(np.abs(wanted), 1.0)  # a fused product keeps digits that Python loses in a difference
    assert np.all((np.abs(out - wanted) <= 1e-9 * scale) | (np.abs(wanted) > 1e12))


def test_lanes_are_vectorised_and_have_the_numbers_of_single_ones() -> None:
    source = (
        "@typed('void(f8[::1], f8[::1])')\ndef kernel(W, out):\n"
        "    for l in range(32):\n        a = W[0 + l]\n        b = W[32 + l]\n"
        "        W[64 + l] = a * b + a / (b + 2.0)\n        out[l] = max(W[64 + l], 0.5)\n"
    )
    rows = np.concatenate([np.linspace(0.0, 3.0, 64), np.zeros(32)])
    wanted, out = np.zeros(32), np.zeros(32)
    plain(source)(rows.copy(), wanted)
    compile_kernel(source)(rows.copy(), out)
    np.testing.assert_allclose(out, wanted, rtol=1e-14)


def test_a_kernel_runs_while_python_goes_on() -> None:
    body = "    for i in range(n):\n        out[0] = exp(out[0] * 1e-3)\n"
    source = f"@typed('void(i8, f8[::1])')\ndef kernel(n, out):\n{body}"
    kernel, out, ticks = compile_kernel(source), np.zeros(1), 0
    thread = threading.Thread(target=kernel, args=(20_000_000, out))
    thread.start()
    while thread.is_alive():
        ticks += 1
        thread.join(0.001)
    assert ticks > 3


@pytest.mark.parametrize(
    "line", ["out[0] = x ^ 1", "x.fill(0.0)", "out[0] = cube", "for i in cube:\n        out[0] = i"]
)
def test_what_has_no_translation_is_refused(line: str) -> None:
    with pytest.raises(GeneratedCodeError, match="generated source"):
        compile_kernel(HEAD + f"    {line}\n")
