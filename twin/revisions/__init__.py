"""Revisions of a twin: the chain of its files, differences, and the adoption of a law.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twin.revisions.revision_chain import (
        ChainEntry,
        ElementDiff,
        TwinDiff,
        chain,
        diff,
        next_path,
        parent_of,
        revert,
        save_revision,
        with_elements,
    )
    from twin.revisions.undone import UndoneRevision, revisions_made_of, undone_revisions

_MODULES = {
    "revision_chain": (
        "ChainEntry",
        "ElementDiff",
        "TwinDiff",
        "chain",
        "diff",
        "next_path",
        "parent_of",
        "revert",
        "save_revision",
        "with_elements",
    ),
    "undone": (
        "UndoneRevision",
        "revisions_made_of",
        "undone_revisions",
    ),
}
_HOME = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}

__all__ = [
    "ChainEntry",
    "ElementDiff",
    "TwinDiff",
    "UndoneRevision",
    "chain",
    "diff",
    "next_path",
    "parent_of",
    "revert",
    "revisions_made_of",
    "save_revision",
    "undone_revisions",
    "with_elements",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
