"""Sphinx maths renderer that writes MathML, so that the pages need no script and no network.

The conversion is docutils' own (`docutils.utils.math.latex2mathml`). A formula that it cannot convert is a warning with
its place, and so fails `make docs`.
"""

from __future__ import annotations

import html
import re
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError, latex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging

_ALIASES = ((re.compile(r"\\dots[bcmio]?(?![A-Za-z])"), r"\\ldots"), (re.compile(r"\\[bB]igg?[lrm]?(?![A-Za-z])"), ""))
"""Commands that docutils lacks, and their nearest equals: dots, and delimiters that stretch by themselves."""

log = logging.getLogger(__name__)


def _convert(node: nodes.Element, block: bool) -> str:
    text = node.astext()
    for pattern, instead in _ALIASES:
        text = pattern.sub(instead, text)
    try:
        return str(latex2mathml.tex2mathml(text, as_block=block))
    except MathError as error:
        log.warning("formula cannot be shown as MathML: %s", error, location=node)
        return f"<code>{html.escape(text)}</code>"


def _inline(self: Any, node: nodes.math) -> None:
    self.body.append(_convert(node, block=False))
    raise nodes.SkipNode


def _block(self: Any, node: nodes.math_block) -> None:
    number = node.get("number")
    identity = f' id="{node["ids"][0]}"' if node.get("ids") else ""
    self.body.append(f'<div class="math-block"{identity}>{_convert(node, block=True)}')
    if number:
        self.body.append(f'<span class="eqno">({number})</span>')
    self.body.append("</div>\n")
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_html_math_renderer("mathml", inline_renderers=(_inline, None), block_renderers=(_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
