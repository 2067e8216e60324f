"""Text of files that other people's tools saved: UTF-8 where it is, else the encoding of older Windows programs."""

from __future__ import annotations

FALLBACK = "cp1252"
"""Most DBC editors and spreadsheets of Western Europe save in it where they do not save UTF-8."""


def decoded(raw: bytes, encoding: str | None = None) -> tuple[str, str]:
    """Return text and encoding of a file's bytes; raise ValueError with the mistake and the remedy.

    Without `encoding` (or with `utf-8`, which says no more than the default) a byte order mark decides, then UTF-8 and
    then cp1252 are tried. Any other encoding is used as given.
    """
    if encoding is not None and encoding.lower().replace("_", "-") not in ("utf-8", "utf8"):
        tries: tuple[str, ...] = (encoding,)
    elif raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        tries = ("utf-16",)
    else:
        tries = ("utf-8-sig", FALLBACK)
    line = 1
    for tried in tries:
        try:
            return raw.decode(tried), tried.removesuffix("-sig")
        except UnicodeDecodeError as error:
            line = raw.count(b"\n", 0, error.start) + 1
        except (LookupError, ValueError, TypeError):
            raise ValueError(f"encoding {tried!r} is not known; use utf-8 or {FALLBACK}") from None
    names = " nor ".join(name.removesuffix("-sig") for name in tries)
    neither = "neither " if len(tries) > 1 else "no "
    raise ValueError(f"is {neither}{names} text (line {line}); save it as UTF-8, or give its encoding")
