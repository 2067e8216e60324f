"""Acceptance rows A1 to A28 of the tower paper: its figure, our gate, our figure, and whether the gate is reached.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.bench.acceptance.rows import assemble

__all__ = ["assemble"]

__getattr__, __dir__ = lazy_names(__name__, {"rows": ("assemble",)})
