"""Sentences of a Markdown page: prose without code, tables, headings, links' targets and directives."""

from __future__ import annotations

import re
from dataclasses import dataclass

_FENCE = re.compile(r"^\s*(`{3,}|:{3,}|~{3,})")
_END = re.compile(r"(?<=[.!?])[)\"”]?\s+(?=[A-Z`*\"“(\[])")
_ABBREVIATIONS = ("e.g.", "i.e.", "eq.", "sec.", "ch.", "vs.", "Fig.", "cf.", "approx.")


@dataclass(frozen=True)
class Sentence:
    """A sentence and the line of the page on which its paragraph begins."""

    line: int
    text: str

    @property
    def length(self) -> int:
        """Return the number of words."""
        return len([word for word in self.text.split() if re.search(r"\w", word)])


def text_lines(page: str) -> list[tuple[int, str]]:
    """Return number and text of the lines that are no code and no maths."""
    found: list[tuple[int, str]] = []
    fence = ""
    in_maths = False
    for number, line in enumerate(page.splitlines(), 1):
        opened = _FENCE.match(line)
        if fence:
            if line.strip().startswith(fence) and set(line.strip()) == {fence[0]}:
                fence = ""
            continue
        if opened:
            fence = opened[1]
            continue
        if line.strip().startswith("$$"):
            in_maths = not in_maths and line.strip().count("$$") == 1
            continue
        if not in_maths:
            found.append((number, line))
    return found


def sentences(page: str) -> list[Sentence]:
    """Return the sentences of the prose of a page in order; each list item begins a sentence of its own."""
    found: list[Sentence] = []
    start, gathered = 0, ""

    def finish() -> None:
        nonlocal gathered
        found.extend(Sentence(start, sentence) for sentence in _split(gathered))
        gathered = ""

    for number, line in [*text_lines(page), (0, "")]:
        stripped = line.strip()
        is_item = re.match(r"(?:[-*]|\d+\.)\s", stripped) is not None
        if not stripped or stripped[0] in "|#" or is_item or stripped.startswith(("![", "---", "(", "```")):
            finish()
        if not stripped or stripped[0] in "|#" or stripped.startswith(("![", "---")):
            continue
        if not gathered:
            start = number
        gathered += " " + re.sub(r"^(?:[-*>]|\d+\.)\s+", "", stripped)
    finish()
    return found


def _split(paragraph: str) -> list[str]:
    plain = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", paragraph).strip()
    plain = re.sub(r"`[^`]*`", lambda match: match[0].replace(" ", "_").replace(".", "_"), plain)
    plain = re.sub(r"\$[^$]*\$", "x", plain)
    for short in _ABBREVIATIONS:
        plain = plain.replace(short, short.replace(".", "_"))
    return [sentence for sentence in _END.split(plain) if sentence]
