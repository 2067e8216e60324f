"""Judgement of limits on the data of a run: pass, fail, or inconclusive where values are missing.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.testing.judgement.judging import Judgement, holds_always, is_above, judge, judge_all
    from hil.testing.judgement.verdicts import ORDER, Verdict, overall, shown


__all__ = [
    "ORDER",
    "Judgement",
    "Verdict",
    "holds_always",
    "is_above",
    "judge",
    "judge_all",
    "overall",
    "shown",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "judging": ("Judgement", "holds_always", "is_above", "judge", "judge_all"),
        "verdicts": ("ORDER", "Verdict", "overall", "shown"),
    },
)
