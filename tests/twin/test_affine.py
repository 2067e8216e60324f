"""Expressions are taken apart by several threads at once, as hypotheses are fitted side by side."""

from __future__ import annotations

import ast
import sys
from concurrent.futures import ThreadPoolExecutor

from twin.network.affine import parse_expression

TEXT = "+".join(f"(a{i}*exp(b{i}/{i + 1}.5))" for i in range(60))


class Cycle:
    """Collected only as garbage, in whichever thread happens to make some, and slow enough for another to go on."""

    def __init__(self) -> None:
        self.me = self

    def __del__(self) -> None:
        for _ in range(2000):
            pass


def test_threads_may_parse_at_once() -> None:
    """Without a lock one in some fifty of these fails on CPython 3.11."""
    before = sys.getswitchinterval()
    expected = ast.dump(ast.parse(TEXT, mode="eval").body)

    def parse(_: int) -> str:
        Cycle()
        return ast.dump(parse_expression(TEXT))

    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(6) as pool:
            found = set(pool.map(parse, range(400)))
    finally:
        sys.setswitchinterval(before)
    assert found == {expected}
