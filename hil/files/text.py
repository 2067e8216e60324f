"""Plain text: input from people, files and devices as text that can be stored and shown anywhere."""

from __future__ import annotations

import re
import unicodedata

LONGEST = 2000
"""Most characters of a text, such as an event of a journal."""
_EMPTY = frozenset("\u034f\u115f\u1160\u17b4\u17b5\u2800\u3164\uffa0")
"""Letters and symbols that show nothing: fillers, the empty Braille pattern."""
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]")


def plain(text: str, longest: int = LONGEST) -> str:
    """Return `text` as valid Unicode without control characters, `longest` characters at most.

    Bytes in the form of lone surrogates, such as those of a Latin-1 terminal, are shown as `\\xfc`.
    """
    shown = _CONTROL.sub(" ", _escaped(text[: longest + 1]))
    return shown if len(shown) <= longest else shown[: longest - 1] + "…"


def is_blank(text: str) -> bool:
    """Return True for a text that shows nothing: spaces, control and format characters, marks without a letter."""
    return not any(unicodedata.category(letter)[0] in "LNPS" and letter not in _EMPTY for letter in text)


def _escaped(text: str) -> str:
    """Return `text` with each lone surrogate as its byte, else as its code."""
    try:
        return text.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")
    except UnicodeEncodeError:
        return text.encode("utf-8", "backslashreplace").decode("utf-8")
