"""Names in the letters a to z, as points, columns and identifiers of other programs need them."""

from __future__ import annotations

import unicodedata

_WRITTEN = {
    "ä": "ae",
    "ö": "oe",
    "ü": "ue",
    "Ä": "Ae",
    "Ö": "Oe",
    "Ü": "Ue",
    "ß": "ss",
    "ẞ": "SS",
    "æ": "ae",
    "Æ": "Ae",
    "œ": "oe",
    "Œ": "Oe",
    "ø": "o",
    "Ø": "O",
    "ł": "l",
    "Ł": "L",
    "đ": "d",
    "Đ": "D",
    "ı": "i",
    "þ": "th",
    "Þ": "Th",
    "ð": "d",
    "Ð": "D",
}
"""Letters that are no letter of a to z with an accent, as they are written without them in their languages."""


def in_ascii(text: str) -> str:
    """Return a text with its Latin letters in a to z (`Rücklauf` as `Ruecklauf`); other scripts stay as they are."""
    if text.isascii():
        return text
    letters = (_WRITTEN.get(letter) or _without_accent(letter) for letter in unicodedata.normalize("NFC", text))
    return "".join(letters)


def _without_accent(letter: str) -> str:
    base = "".join(part for part in unicodedata.normalize("NFD", letter) if not unicodedata.combining(part))
    return base if base.isascii() and base.isalpha() else letter
