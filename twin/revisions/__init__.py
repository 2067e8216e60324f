"""Revisions of a twin: the chain of its files, differences, and the adoption of a law.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin.lazy_names import lazy_names

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

__getattr__, __dir__ = lazy_names(
    __name__,
    {
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
        "undone": ("UndoneRevision", "revisions_made_of", "undone_revisions"),
    },
)
