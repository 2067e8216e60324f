"""Relative links of Markdown pages: each names a file that is there, and a heading that it has.

Anchors of headings are those of the documentation site (GitHub's, three levels deep) for pages in `docs`, and those
of a code host, of every level, elsewhere.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from urllib.parse import unquote

from tests.language.markdown import text_lines

PLACES = ("*.md", "docs", "hil", "drivers", "twin", "tests", "profiles")
"""Pages by pattern, and folders with all pages below them."""
BUILT = "docs/_build"
SITE = "docs"
SITE_LEVELS = 3
"""Levels of headings that get an anchor on the site: `myst_heading_anchors` of `docs/conf.py`."""
_LEVELS = 6
_CODE = re.compile(r"(`+)(?:(?!`).|(?!\1)`)*?\1(?!`)")
_MATHS = re.compile(r"\$[^$]*\$")
_DIRECTIVE = re.compile(r"^(`{3,}|:{3,})\{(?:figure|image|note|tip|important|warning|caution)\}\s*(\S*)")
_LINK = re.compile(r"\]\(\s*<?([^)\s>]+)>?(?:\s+\"[^\"]*\")?\s*\)")
_DEFINITION = re.compile(r"^ {0,3}\[[^\]^]+\]:\s+<?(\S+?)>?(?:\s+\"[^\"]*\")?$")
_HEADING = re.compile(r"^ {0,3}(#{1,6})\s+(.*?)(?:\s+#+)?\s*$")
_LABEL = re.compile(r"^\(([\w-]+)\)=\s*$")
_SCHEME = re.compile(r"^(?:[a-zA-Z][\w+.-]*:|//)")
_GENERATES = re.compile(r"^`{3,}\{(?:command-pages|eval-rst)\}", re.MULTILINE)


def pages(root: Path) -> list[Path]:
    """Return the Markdown pages of the project below `root`."""
    found: set[Path] = set()
    for place in PLACES:
        found.update(root.glob(place) if "*" in place else (root / place).rglob("*.md"))
    return sorted(path for path in found if not path.relative_to(root).as_posix().startswith(BUILT))


def broken_links(root: Path, page: Path) -> Iterator[tuple[int, str]]:
    """Yield line and problem of each relative link of a page without a file or a heading behind it."""
    for number, target in links(page.read_text(encoding="utf-8")):
        if _SCHEME.match(target):
            continue
        name, _, anchor = unquote(target).partition("#")
        path = (page.parent / name).resolve() if name else page.resolve()
        if not path.exists():
            yield number, f"the link {target!r} leads to no file"
        elif not path.is_relative_to(root.resolve()):
            yield number, f"the link {target!r} leads out of the repository"
        elif anchor and path.suffix == ".md" and anchor not in _anchors(path, _levels(root, path)):
            yield number, f"the link {target!r} leads to no heading of {path.name}"


def links(page: str) -> Iterator[tuple[int, str]]:
    """Yield line and target of each link and picture of a page, outside of code."""
    for number, line in text_lines(_without_directives(page)):
        plain = _MATHS.sub("", _CODE.sub("`", line))
        for match in _LINK.finditer(plain):
            yield number, match[1]
        definition = _DEFINITION.match(plain)
        if definition:
            yield number, definition[1]


def _without_directives(page: str) -> str:
    """Return a page with the text of its notes and figures as plain text, line by line."""
    lines, fence = page.splitlines(), ""
    for k, line in enumerate(lines):
        opened = _DIRECTIVE.match(line)
        if opened:
            fence = opened[1]
            lines[k] = f"![]({opened[2]})" if opened[2] else ""
        elif fence and line.strip() == fence:
            fence = lines[k] = ""
    return "\n".join(lines)


def anchors(page: str, levels: int = SITE_LEVELS) -> set[str]:
    """Return the anchors of a page: those of its headings down to `levels`, and its labels.

    A repeated heading gets a number. Parts of a page that are generated have anchors that are not found here.
    """
    found: set[str] = set()
    for _, line in text_lines(page):
        label = _LABEL.match(line)
        if label:
            found.add(label[1])
        heading = _HEADING.match(line)
        if heading is None or len(heading[1]) > levels:
            continue
        slug = base = slug_of(heading[2])
        count = 0
        while slug in found:
            count += 1
            slug = f"{base}-{count}"
        found.add(slug)
    return found


def slug_of(heading: str) -> str:
    """Return the anchor of a heading as GitHub makes it: small letters, digits, hyphens."""
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", heading)
    text = re.sub(r"\\(\W)", r"\1", text.replace("**", "").replace("`", ""))
    return re.sub(r"[^\w\- ]", "", text.strip().lower()).replace(" ", "-")


def _levels(root: Path, path: Path) -> int:
    return SITE_LEVELS if path.is_relative_to((root / SITE).resolve()) else _LEVELS


class _Any(set[str]):
    """Anchors of a page that is generated."""

    def __contains__(self, anchor: object) -> bool:
        return True


@cache
def _anchors(path: Path, levels: int) -> set[str]:
    text = path.read_text(encoding="utf-8")
    return _Any() if _GENERATES.search(text) else anchors(text, levels)
