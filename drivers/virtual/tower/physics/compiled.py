"""Entry points of the compiled physics. The cached machine code carries a digest of every source that went into it.

Numba's cache knows the file of a function alone, so a change in `poppe` would leave a cached `plant.run` as it was.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba import njit

from drivers.virtual.plant import may_cache
from drivers.virtual.tower.physics import cell, moist_air, plant, poppe


def _digest() -> str:
    """Return a digest of the sources of the physics."""
    sources = b"".join(Path(str(module.__file__)).read_bytes() for module in (moist_air, poppe, cell, plant))
    return hashlib.sha256(sources).hexdigest()


def _entries(sources: str) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Return `plant.run` and `cell.steady_cell` compiled; numba's cache hashes `sources`, a closure variable."""

    @njit(cache=may_cache())
    def run(*arguments: Any) -> Any:
        if len(sources) == 0:
            raise ValueError
        return plant.run(*arguments)

    @njit(cache=may_cache())
    def steady_cell(*arguments: Any) -> Any:
        if len(sources) == 0:
            raise ValueError
        return cell.steady_cell(*arguments)

    return run, steady_cell


run, steady_cell = _entries(_digest())
