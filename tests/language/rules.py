"""Rules of language that a program can check without guessing.

Each pattern stands for a private expression, and names the standard term to use instead. A word with an everyday
meaning ("tell", "late", "wins") is left to the reader's judgement.
"""

from __future__ import annotations

import re

OPENINGS = ("What", "Whether", "Where", "How", "Of", "That")
"""First words of a sentence or docstring that hide who does what."""
LONGEST = 30
"""Words of a sentence in the documentation, at most."""
MEDIAN = 25
"""Words of the median sentence of a page, at most."""

_TERMS = {
    r"foret(?:ell|old)\w*": "predict, prediction",
    r"spells?": "transient (intermittent) effect",
    r"what is (?:the matter|lacking)": "fault, effect",
    r"came and went|comes? and goes?": "transient effect, intermittent fault",
    r"thermometers? (?:that|which|who) (?:lies?|errs?)": "sensor fault, sensor bias",
    r"(?:can(?:not)?|could not|can't) (?:be )?(?:told|tell) apart": "indistinguishable, ambiguity group",
    r"(?:records?|windows?|data) (?:can(?:not)?|could not|does not|do not) tell": "identifiable, not identifiable",
    r"what (?:could|can) be seen": "detectability, isolability",
    r"(?:no fit|fit never|fit has not) (?:has )?(?:saw|seen)": "held-out segment, validation segment",
    r"what (?:the|a|its) (?:twin|structure)(?:'s structure)? (?:errs by|leaves)": "model error, model discrepancy",
    r"blocks? (?:of time )?(?:that were |was )?left out": "cross-validation fold",
    r"how sure": "posterior probability, credible interval",
    r"chance of noise": "p-value",
    r"what is known before": "prior",
    r"soak(?:s|ed|ing)?|leads? back|leading back|led back": "thermal restore, warm-up",
    r"stretch(?:es)?": "segment, gap",
    r"the twin as it was": "baseline twin, commissioned twin",
    r"what is usual": "healthy (reference) record",
}
TERMS = tuple((re.compile(rf"\b(?:{pattern})\b", re.IGNORECASE), instead) for pattern, instead in _TERMS.items())
_OPENING = re.compile(rf"^\W*(?:{'|'.join(OPENINGS)})\b(?!-)")


def words_to_replace(text: str) -> list[tuple[int, str, str]]:
    """Return offset, private expression and standard term, for each one in `text`."""
    return [(match.start(), match[0], instead) for pattern, instead in TERMS for match in pattern.finditer(text)]


def has_weak_opening(text: str) -> bool:
    """Return True for a text that begins with one of `OPENINGS`, also behind quotes or marks."""
    return _OPENING.match(text) is not None
