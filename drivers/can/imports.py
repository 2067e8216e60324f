"""Imports of libraries without an optional one that they load and that no code here uses.

python-can loads its reader of MF4 logs, and with it asammdf, pandas and sympy, where these are installed: 0.7 s of
processor time and 120 MB at the start of every process that receives frames.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def without(library: str) -> Iterator[None]:
    """Have imports in the block find `library` not installed, unless it is loaded already."""
    if library in sys.modules:
        yield
        return
    sys.modules[library] = None  # type: ignore[assignment]
    try:
        yield
    finally:
        del sys.modules[library]
