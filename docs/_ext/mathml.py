"""Sphinx maths renderer that writes MathML, so that the pages need no script and no network.

The conversion is that of the package latex2mathml. A formula that it cannot convert is a warning with its place, and so
fails `make docs`.
"""

from __future__ import annotations

import html
import re
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.util import logging

log = logging.getLogger(__name__)


def _converted(node: nodes.Element, display: str) -> str:
    text = node.astext().strip()
    if display == "block" and re.search(r"\\\\|&", text) and r"\begin{" not in text:
        text = rf"\begin{{aligned}}{text}\end{{aligned}}"
    try:
        made = convert(text, display=display)
    except Exception as error:  # whatever its parser raises, the author needs the place
        log.warning("formula cannot be shown as MathML: %r", error, location=node)
        return f"<code>{html.escape(text)}</code>"
    unknown = re.search(r"\\\w+", re.sub(r"<[^>]*>", "", made))
    if unknown:
        log.warning("formula cannot be shown as MathML: unknown command %s", unknown[0], location=node)
    return made


def _inline(self: Any, node: nodes.math) -> None:
    self.body.append(_converted(node, "inline"))
    raise nodes.SkipNode


def _block(self: Any, node: nodes.math_block) -> None:
    number = node.get("number")
    identity = f' id="{node["ids"][0]}"' if node.get("ids") else ""
    self.body.append(f'<div class="math-block"{identity}>{_converted(node, "block")}')
    if number:
        self.body.append(f'<span class="eqno">({number})</span>')
    self.body.append("</div>\n")
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_html_math_renderer("mathml", inline_renderers=(_inline, None), block_renderers=(_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
