"""Affine forms of expressions: the part that is linear in the temperatures, and its coefficients.

Coefficients are text again, in names that do not depend on temperature. The kernel computes them when an input
changes, so its innermost loop is left with sums of products.
"""

from __future__ import annotations

import ast
import threading
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache

ONE, ZERO = "1.0", "0.0"
PARSER_LOCK = threading.Lock()
"""Lock for `ast.parse`: CPython counts the depth of a tree in a place that all threads share."""


def parse_expression(text: str) -> ast.expr:
    """Return the syntax tree of an expression.

    One thread parses at a time. Where a finalizer interrupts one, the depth count of another is wrong ("AST constructor
    recursion depth mismatch").
    """
    with PARSER_LOCK:
        return ast.parse(text, mode="eval").body


class NotAffineError(Exception):
    """An expression that is not affine in the temperatures."""


@dataclass(frozen=True)
class AffineForm:
    """An affine form: ``slopes[v] * v`` summed over the variables v, plus `offset`; all of it text."""

    slopes: Mapping[str, str] = field(default_factory=dict)
    offset: str = ZERO

    def __add__(self, other: AffineForm) -> AffineForm:
        slopes = dict(self.slopes)
        for name, text in other.slopes.items():
            slopes[name] = add(slopes.get(name, ZERO), text)
        return AffineForm({name: text for name, text in slopes.items() if text != ZERO}, add(self.offset, other.offset))

    def scaled(self, factor: str) -> AffineForm:
        """Return the form times a factor that does not depend on temperature."""
        slopes = {name: multiply(text, factor) for name, text in self.slopes.items()}
        return AffineForm({name: text for name, text in slopes.items() if text != ZERO}, multiply(self.offset, factor))

    def text(self) -> str:
        """Return the form as one expression, a chain of multiply-adds."""
        total = self.offset
        for name, slope in self.slopes.items():
            total = add(total, multiply(slope, name))
        return total


def affine_form(text: str, variables: Iterable[str], known: Mapping[str, AffineForm]) -> AffineForm:
    """Return the affine form of an expression in `variables`; names in `known` stand for forms of their own.

    Raises
    ------
    NotAffineError
        A variable occurs other than linearly.
    """
    return _form(parse_expression(text), frozenset(variables), known)


@lru_cache(maxsize=20_000)  # networks that differ in one element share nearly all of their text
def names_in(text: str) -> frozenset[str]:
    """Return the names that occur in an expression."""
    return frozenset(node.id for node in ast.walk(parse_expression(text)) if isinstance(node, ast.Name))


def lane_free_call(text: str, apart: Collection[str]) -> str | None:
    """Return the first function call, outermost first, that uses none of the names `apart`, or None."""
    queue: list[ast.AST] = [parse_expression(text)]
    while queue:
        node = queue.pop(0)
        if isinstance(node, ast.Call) and not {n.id for n in ast.walk(node) if isinstance(n, ast.Name)} & set(apart):
            return ast.get_source_segment(text, node)
        queue += ast.iter_child_nodes(node)
    return None


def add(a: str, b: str) -> str:
    """Return the text of a sum; a term of 0 is left out."""
    if a == ZERO:
        return b
    if b == ZERO:
        return a
    return f"{a} + {b}"


def multiply(a: str, b: str) -> str:
    """Return the text of a product; factors of 0, 1 and -1 are resolved."""
    if ZERO in (a, b):
        return ZERO
    if a == ONE:
        return b
    if b == ONE:
        return a
    if a == "-1.0":
        return negate(b)
    if b == "-1.0":
        return negate(a)
    return f"{_factor(a)} * {_factor(b)}"


def negate(a: str) -> str:
    """Return the text of the negative of an expression."""
    return ZERO if a == ZERO else f"-{_factor(a)}" if a != ONE else "-1.0"


def _factor(a: str) -> str:
    return a if a.replace("_", "").replace(".", "").isalnum() else f"({a})"


def _form(node: ast.expr, variables: frozenset[str], known: Mapping[str, AffineForm]) -> AffineForm:
    touched = {n.id for n in ast.walk(node) if isinstance(n, ast.Name)}
    if not touched & variables and not touched & known.keys():
        return AffineForm(offset=_constant(node))
    if isinstance(node, ast.Name):
        return known[node.id] if node.id in known else AffineForm({node.id: ONE})
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        inner = _form(node.operand, variables, known)
        return inner.scaled("-1.0") if isinstance(node.op, ast.USub) else inner
    if isinstance(node, ast.BinOp):
        left, right = _form(node.left, variables, known), _form(node.right, variables, known)
        if isinstance(node.op, ast.Add):
            return left + right
        if isinstance(node.op, ast.Sub):
            return left + right.scaled("-1.0")
        if isinstance(node.op, ast.Mult) and not (left.slopes and right.slopes):
            return right.scaled(left.offset) if right.slopes else left.scaled(right.offset)
        if isinstance(node.op, ast.Div) and not right.slopes:
            return left.scaled(f"1.0 / {_factor(right.offset)}")
    raise NotAffineError(ast.unparse(node))


def _constant(node: ast.expr) -> str:
    """Return an expression without variables as text; products by 0 and 1 and sums with 0 are left out."""
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        return negate(_constant(node.operand))
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub | ast.Mult):
        left, right = _constant(node.left), _constant(node.right)
        if isinstance(node.op, ast.Mult):
            return multiply(left, right)
        return add(left, right if isinstance(node.op, ast.Add) else negate(right))
    return ast.unparse(node)
