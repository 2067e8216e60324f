"""Escaped HTML: only this module turns text into markup, the type `Html`.

Run folders, records and diagnoses may come from anywhere. A page is therefore composed by `element` and `joined`, which
take plain text and `Html`; they admit no ready markup. A page loads nothing, and runs nothing but a script of this
project where it has plots: its Content-Security-Policy admits its own style, embedded pictures, and this script by its
hash only.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
from collections.abc import Iterable
from typing import Any

POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'"
"""Content-Security-Policy: no script, no frame, no form, and nothing from anywhere else."""
PRINTED = """
@page { size: A4; margin: 14mm 12mm }
@media print {
body { max-width: none; margin: 0; padding: 0; font-size: 9pt }
table { display: table; width: auto; max-width: 100%; overflow: visible; font-size: 8pt }
td, th { min-width: 0 !important; padding: 1mm 1.2mm }
td:first-child, td.text, td:last-child { white-space: normal; overflow-wrap: break-word }
td.text { overflow-wrap: anywhere }
img { width: auto; max-width: 100%; max-height: 240mm }
tr, img, figure, canvas { break-inside: avoid } h1, h2, h3, tr:first-child { break-after: avoid }
.screen { display: none }
}
"""
"""Style of every page on paper: no table is cut, no heading stands alone, and parts of class `screen` are left out."""
DARK = """
@media screen and (prefers-color-scheme: dark) {
html { background: #15181c; color-scheme: dark } body { color: #d9dee4 }
td, th { border-color: #3a4149 } p.note { color: #9aa4ae } a { color: #8ab4f8 }
.ERROR { color: #ff8a80 } .WARN { color: #f0b429 } .PASS { color: #6fcf97 }
img { filter: invert(1) hue-rotate(180deg) }
}
"""
"""Style of every page where the reader's system is dark: a picture on white becomes one on black with the same hues."""
_NAME = re.compile(r"[a-z][a-z0-9-]*")
_VOID = frozenset(("img", "br", "hr", "meta"))
_ACTIVE = frozenset(("script", "iframe", "object", "embed", "link", "style", "base", "form", "meta"))
_ATTRIBUTES = frozenset(("id", "class", "alt", "lang", "title"))
_SECRET = object()


class Html:
    """Escaped markup. It is no str, so that it cannot be mixed with text by accident."""

    __slots__ = ("_markup",)

    def __init__(self, markup: str, made_here: object = None) -> None:
        if made_here is not _SECRET:
            raise TypeError("Html is made by element, joined and image only; hand in plain text")
        self._markup = markup

    def __str__(self) -> str:
        raise TypeError("Html is no text; put it together with element and joined, and write it with document")

    def __bool__(self) -> bool:
        return bool(self._markup)


HtmlPart = Html | str
"""Part of a page: markup from this module, or any text, which is escaped."""


def joined(parts: Iterable[HtmlPart]) -> Html:
    """Return parts one after the other, text escaped."""
    return Html("".join(_markup(part) for part in parts), _SECRET)


def element(name: str, *content: HtmlPart, **attributes: str) -> Html:
    """Return an element with its content and attributes, all text escaped.

    Parameters
    ----------
    name
        A tag that can run nothing.
    attributes
        Id, class (as ``class_``), alt, lang or title; those of an empty value are left out.

    Raises
    ------
    ValueError
        `name` or an attribute is not admitted.
    """
    if not _NAME.fullmatch(name) or name in _ACTIVE:
        raise ValueError(f"no page has an element {name!r}")
    head = name + "".join(_attribute(key.rstrip("_"), value) for key, value in attributes.items() if value)
    inner = "".join(_markup(part) for part in content)
    return Html(f"<{head}>" if name in _VOID else f"<{head}>{inner}</{name}>", _SECRET)


def image(kind: str, data: bytes, alt: str = "", id: str = "") -> Html:
    """Return a picture embedded in the page; `kind` is png or svg+xml, else ValueError is raised.

    A browser runs no script of an SVG in an `img`.
    """
    if kind not in ("png", "svg+xml"):
        raise ValueError(f"no page has a picture of kind {kind!r}")
    source = f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"
    head = _attribute("id", id) if id else ""
    return Html(f'<img{head}{_attribute("alt", alt)} src="{source}">', _SECRET)


def table(head: Iterable[HtmlPart], rows: Iterable[Iterable[HtmlPart]], **attributes: str) -> Html:
    """Return a table of one header row and further rows of cells."""
    top = element("tr", *(element("th", cell) for cell in head))
    lines = (element("tr", *(element("td", cell) for cell in row)) for row in rows)
    return element("table", top, *lines, **attributes)


def plot_data(data: Any) -> Html:
    """Return a block of data for the script of a page; no browser runs it.

    Raises
    ------
    ValueError
        The data hold a number that is not finite.
    """
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    for mark in "<>&":  # so that no text of it can end the element
        text = text.replace(mark, f"\\u{ord(mark):04x}")
    return Html(f'<script type="application/json" class="plot">{text}</script>', _SECRET)


def document(title: str, style: str, body: Iterable[HtmlPart], script: str = "") -> str:
    """Return a whole page.

    Parameters
    ----------
    title
        Any text.
    style
        CSS of this project.
    body
        Parts of the page.
    script
        JavaScript of this project, never text from a file; the policy of the page admits no other.

    Raises
    ------
    ValueError
        The style or the script holds a `<`, which could end its element.
    """
    if "<" in style or "<" in script:
        raise ValueError("a style or script with < in it could end its own element")
    digest = base64.b64encode(hashlib.sha256(script.encode("utf-8")).digest()).decode("ascii")
    policy = POLICY + (f"; script-src 'sha256-{digest}'" if script else "")
    head = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{_escaped(title)}</title><style>{style}{DARK}{PRINTED}</style></head><body>"
    )
    end = f"<script>{script}</script>" if script else ""
    return head + "\n".join(_markup(part) for part in body if part) + f"{end}</body></html>\n"


def _attribute(name: str, value: str) -> str:
    if name not in _ATTRIBUTES:
        raise ValueError(f"no element of a page has the attribute {name!r}")
    return f' {name}="{_escaped(value)}"'


def _markup(part: HtmlPart) -> str:
    return part._markup if isinstance(part, Html) else _escaped(part)


def _escaped(text: object) -> str:
    """Return text without markup that UTF-8 can hold; another type in a forged file is converted by `str`."""
    return html.escape(str(text)).encode("utf-8", "replace").decode("utf-8").replace("\0", "\N{REPLACEMENT CHARACTER}")
