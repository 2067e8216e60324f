"""Encodings of a record's text: UTF-16, which Excel and Windows loggers write, converted to UTF-8."""

from __future__ import annotations

import re

_WRAPPED = re.compile(r'"(?:[^"]|"")*[,;\t](?:[^"]|"")*"')
"""Line of one quoted cell that holds a delimiter."""
_LINES = 5
"""Lines that show the quotes around each line."""
_BOMS = {b"\xff\xfe": "utf-16-le", b"\xfe\xff": "utf-16-be"}
_SAMPLE = 512
"""Bytes from the beginning that show UTF-16 without a byte order mark."""
_MOST = 0.8
"""Share of zero bytes on one side from which text of mostly Latin letters is UTF-16."""


class EncodingError(ValueError):
    """Error of damaged text; the message lacks only the file."""


def utf8(content: bytes) -> bytes:
    """Return the bytes of a UTF-16 text as UTF-8, and any other content unchanged.

    Raises
    ------
    EncodingError
        The text begins as UTF-16 and is none.
    """
    encoding = _BOMS.get(content[:2]) or _by_zeros(content[:_SAMPLE])
    if encoding is None:
        return content
    text = content[2:] if content[:2] in _BOMS else content
    if len(text) % 2:  # Cut off within a character.
        text = text[:-1]
    try:
        return text.decode(encoding).encode()
    except UnicodeError as error:
        raise EncodingError("begins as UTF-16 text and is damaged; save it as CSV in UTF-8") from error


def beginning_of(content: bytes) -> str:
    """Return the text of a file's first bytes, which may end within a letter, for a look at its layout."""
    try:
        return unwrapped(utf8(content).decode("utf-8-sig", "replace").replace("\r\n", "\n"))
    except EncodingError:
        return ""


def unwrapped(text: str) -> str:
    """Return a table whose lines are each one quoted cell without these quotes; any other text unchanged.

    A spreadsheet that opens a CSV in one column and saves it writes such lines.
    """
    lines = text.split("\n")
    full = [line.rstrip("\r") for line in lines if line.strip()][:_LINES]
    if not full or not all(_WRAPPED.fullmatch(line) for line in full):
        return text
    return "\n".join(line.strip().removeprefix('"').removesuffix('"').replace('""', '"') for line in lines)


def _by_zeros(sample: bytes) -> str | None:
    """Return the kind of UTF-16 whose every second byte is zero, or None."""
    half = len(sample) // 2
    if half < 2:
        return None
    for odd, encoding in ((1, "utf-16-le"), (0, "utf-16-be")):
        zeros = sample[odd::2].count(0)
        if zeros >= _MOST * half and sample[1 - odd :: 2].count(0) == 0:
            return encoding
    return None


_NOT_LATIN = frozenset((0x81, 0x8D, 0x8F, 0x90, 0x9D))
"""Bytes that are no character of Windows' Latin code page 1252; 0x81 begins `℃` in Shift-JIS."""


def shift_jis(content: bytes) -> str | None:
    """Return Japanese text in Shift-JIS, which is no text in a Latin encoding; None for any other text."""
    if not _NOT_LATIN & set(content):
        return None
    try:
        return content.decode("cp932")
    except UnicodeDecodeError:
        return None
