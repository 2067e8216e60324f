"""Findings in the repository: the language rules, and links that lead nowhere."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from tests.language.links import broken_links, pages
from tests.language.markdown import sentences, text_lines
from tests.language.rules import LONGEST, MEDIAN, has_weak_opening, words_to_replace
from tests.language.source import texts

PROJECT = Path(__file__).resolve().parents[2]
PACKAGES = ("hil", "drivers", "twin")
PAGES = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs")
GENERATED = ("docs/_build", "docs/results")
"""Results are written by `hil bench`, so their words are those of the code."""


@dataclass(frozen=True)
class Finding:
    """One sentence, text or link that breaks a rule."""

    path: str
    line: int
    problem: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.problem}"


def findings(root: Path = PROJECT) -> list[Finding]:
    """Return all findings below `root`."""
    found: list[Finding] = []
    for top in PAGES:
        for path in _files(root / top, ".md"):
            name = str(path.relative_to(root))
            if not name.startswith(GENERATED):
                found += page_findings(name, path.read_text(encoding="utf-8"))
    for package in PACKAGES:
        for path in _files(root / package, ".py"):
            found += module_findings(str(path.relative_to(root)), path.read_text(encoding="utf-8"))
    for path in pages(root):
        name = str(path.relative_to(root))
        found += [Finding(name, line, problem) for line, problem in broken_links(root, path)]
    return found


def page_findings(name: str, text: str) -> Iterator[Finding]:
    """Yield the findings of a Markdown page: words, openings, and lengths of sentences."""
    for number, line in text_lines(text):
        for _, word, instead in words_to_replace(line):
            yield Finding(name, number, f"{word!r}: use {instead}")
    lengths = []
    for sentence in sentences(text):
        lengths.append(sentence.length)
        if has_weak_opening(sentence.text):
            yield Finding(name, sentence.line, f"name the agent and the action: {sentence.text[:60]!r}")
        if sentence.length > LONGEST:
            yield Finding(name, sentence.line, f"{sentence.length} words, at most {LONGEST}: {sentence.text[:60]!r}")
    if lengths and median(lengths) > MEDIAN:
        yield Finding(name, 1, f"the median sentence has {median(lengths):g} words, at most {MEDIAN}")


def module_findings(name: str, source: str) -> Iterator[Finding]:
    """Yield the findings of a Python module: words in docstrings and messages, openings of docstrings."""
    for text in texts(source):
        if text.is_docstring and has_weak_opening(text.text):
            yield Finding(name, text.line, f"begin with a verb or a noun phrase: {text.text.strip()[:60]!r}")
        for offset, word, instead in words_to_replace(text.text):
            line = text.line + text.text.count("\n", 0, offset)
            yield Finding(name, line, f"{word!r}: use {instead}")


def _files(top: Path, suffix: str) -> list[Path]:
    if top.is_file():
        return [top]
    return sorted(path for path in top.rglob(f"*{suffix}") if "__pycache__" not in path.parts)
